"""Motions of arms as joint trajectories: CSV text, and messages of ROS's `trajectory_msgs`.

Both say where every joint is commanded at the knots of the stored motion (`arm_path`, `arm_time`).
Arms, and the wrists that they carry, pass the knots in straight lines in joint space. The fingers stay
at the pre-grasp until the phase `close`, go to the grasp in it and on to the squeeze in `squeeze`, and
stay there: as test a plays a motion. Angles are in rad and times in s since home.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.arms.fingers import fingers_at, key_places
from bidexdata.record import GraspBatch
from bidexdata.record.fields import PHASES

HOME = "home"
"""What the first knot is called in the place of the phase that led to the others."""
FRAME = "world"
"""`header.frame_id` of the messages."""
_SECOND = 1_000_000_000


class JointGroup(NamedTuple):
    """Joints that one controller drives: an arm with its wrist, or the fingers of a hand."""

    side: str
    kind: str
    """`arm` or `hand`."""
    joint_names: tuple[str, ...]
    """As the models name them."""
    path: Float[np.ndarray, "W j"]
    """[rad]."""


def joint_groups(batch: GraspBatch, row: int) -> list[JointGroup]:
    """The groups of one grasp's motion: left arm, right arm, left hand, right hand.

    Args:
        batch: Rows with arm columns.
        row: One with a motion.
    """
    header = batch.header
    knots = header.arms[0].knots
    arms = [
        JointGroup(arm.side, "arm", arm.joint_names, path[:, : len(arm.joint_names)])
        for arm, path in zip(header.arms, batch["arm_path"][row], strict=True)
    ]
    fingers = finger_path(batch["joints"][row], knots)
    hands = [
        JointGroup(hand.side, "hand", hand.joint_names, path[:, : len(hand.joint_names)])
        for hand, path in zip(header.hands, fingers, strict=True)
    ]
    return [*arms, *hands]


def finger_path(
    joints: Float[np.ndarray, "H 3 J"], knots: Sequence[int]
) -> Float[np.ndarray, "H W J"]:
    """Angles of the fingers at the knots of a motion [rad].

    Args:
        joints: At pre-grasp, grasp and squeeze [rad].
        knots: Of each phase of `PHASES`.
    """
    return fingers_at(joints, key_places(knots)).swapaxes(0, 1).astype(joints.dtype)


def phase_of_knots(knots: Sequence[int]) -> list[str]:
    """The phase that leads to each knot.

    >>> phase_of_knots((2, 1, 1, 1, 1))
    ['home', 'approach', 'approach', 'reach', 'close', 'squeeze', 'lift']
    """
    return [HOME, *(p for p, count in zip(PHASES, knots, strict=True) for _ in range(count))]


def csv_text(batch: GraspBatch, row: int) -> str:
    """One grasp's motion as CSV: `time`, `phase`, then `<side>/<joint>` for arms and fingers."""
    groups = joint_groups(batch, row)
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    names = [f"{g.side}/{name}" for g in groups for name in g.joint_names]
    table.writerow(["time", "phase", *names])
    angles = np.concatenate([g.path for g in groups], axis=1)
    phases = phase_of_knots(batch.header.arms[0].knots)
    for time, phase, q in zip(batch["arm_time"][row], phases, angles, strict=True):
        table.writerow([_number(time), phase, *map(_number, q)])
    return out.getvalue()


def ros_messages(batch: GraspBatch, row: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """One grasp's motion as `trajectory_msgs/JointTrajectory`, one message per controller.

    Points have positions alone: between such points the joint trajectory controller of ros2_control
    goes in straight lines, as the motion does, and by cubic splines where speeds are given too.

    Returns:
        `left_arm`, `right_arm`, `left_hand`, `right_hand`, each with its message as plain data.

    Source:
        ros2_controllers, joint_trajectory_controller/doc, "Trajectory representation".
    """
    time = batch["arm_time"][row]
    stamps = [divmod(round(float(t) * _SECOND), _SECOND) for t in time]
    for group in joint_groups(batch, row):
        points = [
            {
                "positions": [float(_number(q)) for q in angles],
                "velocities": [],
                "accelerations": [],
                "effort": [],
                "time_from_start": {"sec": sec, "nanosec": nanosec},
            }
            for (sec, nanosec), angles in zip(stamps, group.path, strict=True)
        ]
        header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": FRAME}
        message = {"header": header, "joint_names": list(group.joint_names), "points": points}
        yield f"{group.side}_{group.kind}", message


def _number(value: np.floating) -> str:
    # Nine digits give a float32 back to the bit.
    return f"{float(value) + 0.0:.9g}"
