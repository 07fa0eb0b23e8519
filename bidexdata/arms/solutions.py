"""What goes into `solve_arms` and what comes out: grasps of one scene, and the arms' columns.

Frames: poses are those of the record's `hand` frame in the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.arms.config import ArmConfig
from bidexdata.arms.robot import Robot
from bidexdata.record.batch import ArmHeader, in_metres
from bidexdata.record.fields import FIELDS, KEY_FRAMES
from bidexdata.record.status import Status


class Targets(NamedTuple):
    """N grasps of one scene, float64; stages are pregrasp, grasp, squeeze."""

    object_pos: Float[np.ndarray, " 3"]
    """[m]."""
    object_quat_wxyz: Float[np.ndarray, " 4"]
    size: float
    """Diagonal of the object's bounding box [m]."""
    hand_pos: Float[np.ndarray, "N 2 3 3"]
    """Per side and stage [m]."""
    hand_quat_wxyz: Float[np.ndarray, "N 2 3 4"]
    joints: Float[np.ndarray, "N 2 3 J"]
    """Of the hands, in the order of the record [rad]."""


class Grasps(NamedTuple):
    """N grasps of one object at any sizes and places, float64; stages as in `Targets`."""

    object_pos: Float[np.ndarray, "N 3"]
    """[m]."""
    object_quat_wxyz: Float[np.ndarray, "N 4"]
    size: Float[np.ndarray, " N"]
    """[m]."""
    hand_pos: Float[np.ndarray, "N 2 3 3"]
    """[m]."""
    hand_quat_wxyz: Float[np.ndarray, "N 2 3 4"]
    joints: Float[np.ndarray, "N 2 3 J"]
    """[rad]."""

    def select(self, rows: np.ndarray) -> Grasps:
        """Some of the grasps, by index or mask."""
        return Grasps(*(column[rows] for column in self))


def stored_targets(
    object_pos: Float[np.ndarray, " 3"],
    object_quat_wxyz: Float[np.ndarray, " 4"],
    size: np.float32,
    hand_pos: Float[np.ndarray, "N 2 3 3"],
    hand_quat_wxyz: Float[np.ndarray, "N 2 3 4"],
    joints: Float[np.ndarray, "N 2 3 J"],
) -> Targets:
    """Targets of grasps as the record stores them, float32; quaternions are made exactly unit.

    Whoever asks about grasps that are not stored yet rounds them as the record will, and gets the
    answer that the stored ones get.
    """
    return Targets(
        object_pos.astype(np.float64),
        _unit(object_quat_wxyz),
        in_metres(size),
        hand_pos.astype(np.float64),
        _unit(hand_quat_wxyz),
        joints.astype(np.float64),
    )


def _unit(quat: np.ndarray) -> np.ndarray:
    quat64 = quat.astype(np.float64)
    return quat64 / np.linalg.norm(quat64, axis=-1, keepdims=True)


def join_targets(scenes: Sequence[Targets]) -> Grasps:
    """The grasps of several scenes of one object, one behind the other."""
    counts = [len(targets.hand_pos) for targets in scenes]
    hands = [np.concatenate(columns) for columns in zip(*(t[3:] for t in scenes), strict=True)]
    return Grasps(
        np.repeat([t.object_pos for t in scenes], counts, axis=0),
        np.repeat([t.object_quat_wxyz for t in scenes], counts, axis=0),
        np.repeat([float(t.size) for t in scenes], counts),
        *hands,
    )


class ArmSolutions(NamedTuple):
    """Motions of N grasps, by the names of the record's columns; NaN where there is none."""

    arm_status: Int[np.ndarray, " N"]
    """Numbers of `Status`."""
    arm_joints: Float[np.ndarray, "N 2 K A"]
    """[rad]."""
    arm_path: Float[np.ndarray, "N 2 W A"]
    """[rad]."""
    arm_time: Float[np.ndarray, "N W"]
    """[s]."""
    ik_error_pos: Float[np.ndarray, "N 2 K"]
    """[m]."""
    ik_error_rot: Float[np.ndarray, "N 2 K"]
    """[rad]."""
    arm_step: Float[np.ndarray, " N"]
    """[rad]."""
    clear_table: Float[np.ndarray, " N"]
    """[m]."""
    clear_object: Float[np.ndarray, " N"]
    """[m]."""
    clear_arms: Float[np.ndarray, " N"]
    """[m]."""
    clear_self: Float[np.ndarray, " N"]
    """[m]."""
    manipulability: Float[np.ndarray, "N 2"]
    arm_starts: Int[np.ndarray, "N 2"]
    arm_failed_side: Int[np.ndarray, " N"]
    """0 left, 1 right, -1 none or both."""

    @property
    def ok(self) -> np.ndarray:
        """Which grasps have a motion, (N,) bool."""
        return self.arm_status == Status.OK

    def select(self, rows: np.ndarray | slice) -> ArmSolutions:
        """Those of some grasps."""
        return ArmSolutions(*(column[rows] for column in self))

    def to_columns(self) -> dict[str, np.ndarray]:
        """The record's columns, in its dtypes."""
        return {
            name: np.ascontiguousarray(values, FIELDS[name].dtype)
            for name, values in self._asdict().items()
        }


def no_solutions(
    robot: Robot, config: ArmConfig, count: int, status: Status = Status.NO_GRASP
) -> ArmSolutions:
    """Solutions of `count` rows that have none: `status`, and NaN or 0 everywhere.

    The arrays are new, to be written to row by row.
    """
    knots, joints = 1 + sum(config.path.knots), robot.joints

    def nothing(*shape: int) -> np.ndarray:
        return np.full((count, *shape), np.nan)

    return ArmSolutions(
        arm_status=np.full(count, int(status)),
        arm_joints=nothing(2, len(KEY_FRAMES), joints),
        arm_path=nothing(2, knots, joints),
        arm_time=nothing(knots),
        ik_error_pos=nothing(2, len(KEY_FRAMES)),
        ik_error_rot=nothing(2, len(KEY_FRAMES)),
        arm_step=nothing(),
        clear_table=nothing(),
        clear_object=nothing(),
        clear_arms=nothing(),
        clear_self=nothing(),
        manipulability=nothing(2),
        arm_starts=np.zeros((count, 2), np.int64),
        arm_failed_side=np.full(count, -1),
    )


def arm_headers(robot: Robot, config: ArmConfig) -> tuple[ArmHeader, ArmHeader]:
    """What the header of rows with these columns says of the arms, left first."""
    left, right = (
        ArmHeader(
            rig=robot.rig.spec.name,
            rig_hash=robot.digest,
            side=arm.side,
            joint_names=arm.chain.joint_names,
            wrist_joints=arm.chain.wrist,
            knots=config.path.knots,
        )
        for arm in robot.arms
    )
    return left, right
