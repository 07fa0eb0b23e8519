"""Poses of the hands along a grasp: stand-off, lines between key poses, lift.

Frames: poses are those of the record's `hand` frame in the world. A line moves the origin straight
and turns at constant speed along the shorter way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.frames import matrix_from_quat, quat_slerp


class Poses(NamedTuple):
    """Poses of a hand."""

    pos: Float[np.ndarray, "*b 3"]
    """[m]."""
    quat_wxyz: Float[np.ndarray, "*b 4"]

    @property
    def rot(self) -> np.ndarray:
        """Rotation matrices, (*b, 3, 3)."""
        return matrix_from_quat(self.quat_wxyz)


def stand_off(
    pregrasp: Poses,
    away: Float[np.ndarray, "*b 3"],
    below: Float[np.ndarray, "*b"],
    lowest: float,
) -> Poses:
    """Move hands back, and up where they would come too low.

    Args:
        pregrasp: Where the hands are before they close.
        away: The way back, world frame [m].
        below: How far each hand, as it is turned, reaches down below the hand frame's origin [m].
        lowest: Least height of a hand's lowest point over the table [m].
    """
    pos = pregrasp.pos + away
    pos[..., 2] = np.maximum(pos[..., 2], lowest + below)
    return Poses(pos, pregrasp.quat_wxyz)


def line(start: Poses, end: Poses, count: int) -> Poses:
    """Waypoints from one pose to another, without the first and with the last, (*b, count).

    Args:
        start: Where it begins.
        end: Where it ends.
        count: Waypoints.
    """
    share = np.arange(1, count + 1) / count
    pos = start.pos[..., None, :] + share[:, None] * (end.pos - start.pos)[..., None, :]
    quat = quat_slerp(start.quat_wxyz[..., None, :], end.quat_wxyz[..., None, :], share)
    return Poses(pos, quat)


def lifted(pose: Poses, height: float) -> Poses:
    """The same pose higher up by `height` [m]."""
    return Poses(pose.pos + np.array([0.0, 0.0, height]), pose.quat_wxyz)
