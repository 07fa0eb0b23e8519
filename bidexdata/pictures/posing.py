"""Hand poses of one grasp at a stage, or in between two stages.

A moment is a number: 0 pregrasp, 1 grasp, 2 squeeze; in between, positions and joints are linear
and orientations turn at constant speed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import quat_slerp
from bidexdata.record import GraspBatch
from bidexdata.record.fields import STAGES

FloatArray = NDArray[np.float64]


class HandPoses(NamedTuple):
    """Poses of all hands of one grasp in the world frame."""

    pos: FloatArray
    """Origins of the hand frames [m], (H, 3)."""
    quat_wxyz: FloatArray
    """(H, 4)."""
    joints: FloatArray
    """[rad], padded with NaN for hands with fewer joints, (H, J)."""


def moment_of(stage: str | int | float) -> float:
    """Number of a stage's name; a number stays as it is.

    Raises:
        ValueError: Not a stage, or outside 0 to 2.
    """
    if isinstance(stage, str):
        return float(STAGES.index(stage))
    if not 0 <= stage <= len(STAGES) - 1:
        raise ValueError(f"a stage lies between 0 and {len(STAGES) - 1}, not at {stage}")
    return float(stage)


def has_pose(batch: GraspBatch, row: int) -> bool:
    """Whether every hand has a pose at every stage; failed attempts may have none."""
    pos, quat = batch["hand_pos"][row], batch["hand_quat_wxyz"][row]
    return bool(np.isfinite(pos).all() and np.isfinite(quat).all())


def poses_at(batch: GraspBatch, row: int, stage: str | int | float) -> HandPoses:
    """Give the hands' poses; at a stage they are the stored numbers exactly."""
    moment = moment_of(stage)
    first = min(int(moment), len(STAGES) - 2)
    t = moment - first
    pos, quat, joints = (
        np.asarray(batch[name][row], np.float64)
        for name in ("hand_pos", "hand_quat_wxyz", "joints")
    )
    if t in (0.0, 1.0):
        at = first + int(t)
        return HandPoses(pos[:, at], quat[:, at], joints[:, at])
    return HandPoses(
        (1 - t) * pos[:, first] + t * pos[:, first + 1],
        quat_slerp(quat[:, first], quat[:, first + 1], np.asarray(t)),
        (1 - t) * joints[:, first] + t * joints[:, first + 1],
    )
