"""Hands on three slides and three hinges: what BimanDexGraspBench has in place of arms.

The root of a hand stands at base + (x, y, z) in the world and is turned about its own axes x, y, z in
this order, R = Rx Ry Rz.

Source: BimanDexGraspBench, assets/hand/dual_dummy_arm_shadow (order, axes, bases).
"""

from __future__ import annotations

import numpy as np

from bidexdata.formats.importers.format import FloatArray
from bidexdata.frames import matrix_from_quat, quat_multiply

_KINDS = ("TransXJ", "TransYJ", "TransZJ", "RotXJ", "RotYJ", "RotZJ")
ARM_JOINTS = {
    side: tuple(f"{prefix}_{kind}" for kind in _KINDS)
    for side, prefix in (("left", "la"), ("right", "ra"))
}
"""Names of a hand's slides and hinges, base to hand."""
ARM_BASE = {"left": np.array([0.0, 0.1, 0.0]), "right": np.array([0.0, -0.1, 0.0])}
"""Where the slides are zero [m]."""
_GRASP = 1


def arm_values(root: FloatArray, quat_wxyz: FloatArray, side: str) -> FloatArray:
    """Slides [m] and hinges [rad] that put a hand's root at a pose, (N, S, 6).

    The hinges of the other stages are those nearest to the grasp's, since the benchmark goes from
    stage to stage along their values.

    Args:
        root: Origin of the root, (N, S, 3) [m].
        quat_wxyz: Its orientation, unit, (N, S, 4).
        side: `left` or `right`.
    """
    hinges = _hinges(matrix_from_quat(quat_wxyz))
    grasp = hinges[:, _GRASP, None]
    return np.concatenate([root - ARM_BASE[side], _nearest(hinges, grasp)], axis=-1)


def arm_pose(values: FloatArray, side: str) -> tuple[FloatArray, FloatArray]:
    """Where slides and hinges put a hand's root: positions (..., 3) [m] and quaternions (..., 4)."""
    quat = np.broadcast_to(np.array([1.0, 0.0, 0.0, 0.0]), (*values.shape[:-1], 4))
    for axis in range(3):
        half = values[..., 3 + axis] / 2
        one = np.zeros_like(quat)
        one[..., 0], one[..., 1 + axis] = np.cos(half), np.sin(half)
        quat = quat_multiply(quat, one)
    return values[..., :3] + ARM_BASE[side], quat


def _hinges(R: FloatArray) -> FloatArray:
    """Angles (a, b, c) with R = Rx(a) Ry(b) Rz(c); exact where b is a quarter turn too."""
    a = np.arctan2(-R[..., 1, 2], R[..., 2, 2])
    cos, sin = np.cos(a), np.sin(a)
    # Rows 1 and 2 of Rx(-a) R, which is Ry(b) Rz(c).
    second = cos[..., None] * R[..., 1, :] + sin[..., None] * R[..., 2, :]
    third = cos[..., None] * R[..., 2, :] - sin[..., None] * R[..., 1, :]
    b = np.arctan2(R[..., 0, 2], third[..., 2])
    c = np.arctan2(second[..., 0], second[..., 1])
    return np.stack([a, b, c], axis=-1)


def _nearest(hinges: FloatArray, to: FloatArray) -> FloatArray:
    """The angles of the same turns that are nearest to others."""
    a, b, c = np.moveaxis(hinges, -1, 0)
    other = np.stack([a + np.pi, np.pi - b, c + np.pi], axis=-1)
    both = np.stack([hinges, other])
    both += 2 * np.pi * np.round((to - both) / (2 * np.pi))
    far = np.abs(both - to).sum(axis=-1)
    return np.where((far[0] <= far[1])[..., None], both[0], both[1])
