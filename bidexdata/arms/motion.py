"""Motion: a stored motion of two arms, read at any time: arms, fingers and the object that rises.

Between two knots joints move in straight lines. Fingers stay at the pre-grasp until the arms close, are at
the grasp when they have closed, and go on to the squeeze. World frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.arms.chain import chain_forward
from bidexdata.arms.fingers import fingers_at, key_places
from bidexdata.arms.robot import Robot
from bidexdata.frames import quat_from_matrix
from bidexdata.pictures.posing import HandPoses
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import KEY_FRAMES, PHASES


class Moment(NamedTuple):
    """A robot and an object at one time."""

    arms: Float[np.ndarray, "2 A"]
    """Angles of the arms, padded with NaN [rad]."""
    joints: Float[np.ndarray, "2 J"]
    """Of the hands [rad]."""
    object_pos: Float[np.ndarray, " 3"]
    """Origin of the object frame [m]."""


class Motion(NamedTuple):
    """The motion of one grasp, W knots."""

    robot: Robot
    time: Float[np.ndarray, " W"]
    """Of the knots, since home [s]."""
    arms: Float[np.ndarray, "2 W A"]
    """[rad]."""
    joints: Float[np.ndarray, "2 W J"]
    """[rad]."""
    object_pos: Float[np.ndarray, "W 3"]
    """[m]."""
    key_time: Float[np.ndarray, " K"]
    """When it is at the key frames [s]."""

    @property
    def seconds(self) -> float:
        """How long it takes [s]."""
        return float(self.time[-1])

    def at(self, time: float) -> Moment:
        """Read it at a time since home [s]; beyond its ends it stands still."""
        last = len(self.time) - 1
        k = int(np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, last - 1))
        t = float(np.clip((time - self.time[k]) / (self.time[k + 1] - self.time[k]), 0.0, 1.0))

        def between(values: np.ndarray, axis: int) -> np.ndarray:
            first, then = (values.take(n, axis=axis) for n in (k, k + 1))
            return first if t == 0.0 else then if t == 1.0 else (1 - t) * first + t * then

        return Moment(between(self.arms, 1), between(self.joints, 1), between(self.object_pos, 0))

    def phase_at(self, time: float) -> str:
        """Name of the phase that a time belongs to."""
        k = int(np.searchsorted(self.key_time, time, side="left")) - 1
        return PHASES[int(np.clip(k, 0, len(PHASES) - 1))]


def motion_of(robot: Robot, batch: GraspBatch, row: int) -> Motion | None:
    """Read the motion of a row; None where it has none.

    Args:
        robot: The rig with the hands of the rows.
        batch: Rows with the columns of arms.
        row: Which.
    """
    if int(batch["arm_status"][row]) != Status.OK:
        return None
    path = np.asarray(batch["arm_path"][row], np.float64)
    time = np.asarray(batch["arm_time"][row], np.float64)
    knots = batch.header.arms[0].knots
    ends = np.cumsum([0, *knots])
    joints = fingers_at(batch["joints"][row], key_places(knots)).swapaxes(0, 1)
    squeeze = int(ends[KEY_FRAMES.index("squeeze")])
    pos = np.repeat(np.asarray(batch["object_pos"][row], np.float64)[None], len(time), axis=0)
    height = np.mean([p.pos[:, 2] for p in hand_ways(robot, path)], axis=0)
    pos[squeeze:, 2] += height[squeeze:] - height[squeeze]  # it rises with the hands
    assert len(ends) == len(KEY_FRAMES)
    return Motion(robot, time, path, joints, pos, time[ends])


def at_home(robot: Robot, batch: GraspBatch, row: int) -> Moment:
    """The arms at home, with the fingers and the object of a row."""
    arms = np.full((2, robot.joints), np.nan)
    for h, arm in enumerate(robot.arms):
        arms[h, : arm.chain.joints] = arm.chain.rest
    joints = np.asarray(batch["joints"][row, :, 0], np.float64)
    return Moment(arms, joints, np.asarray(batch["object_pos"][row], np.float64))


class Way(NamedTuple):
    """Where one hand is at W moments."""

    pos: Float[np.ndarray, "W 3"]
    """Of the hand frame [m]."""
    quat_wxyz: Float[np.ndarray, "W 4"]


def hand_ways(robot: Robot, arms: Float[np.ndarray, "2 W A"]) -> tuple[Way, Way]:
    """Where the arms have the hands at some angles [rad], left first."""
    left, right = (
        chain_forward(arm.chain, arms[h, :, : arm.chain.joints]) for h, arm in enumerate(robot.arms)
    )
    return Way(left[0], quat_from_matrix(left[1])), Way(right[0], quat_from_matrix(right[1]))


def hand_poses(robot: Robot, moment: Moment) -> HandPoses:
    """Poses of both hands at a moment."""
    ways = hand_ways(robot, moment.arms[:, None])
    pos, quat = (np.stack([way[k][0] for way in ways]) for k in (0, 1))
    return HandPoses(pos, quat, moment.joints)
