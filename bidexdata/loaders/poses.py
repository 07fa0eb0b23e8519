"""Poses of hands and point clouds in the frame that a user asks for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import (
    matrix_from_quat,
    quat_canonical,
    quat_conjugate,
    quat_multiply,
)


def poses_in_object_frame(
    object_pos: NDArray[np.floating],
    object_quat_wxyz: NDArray[np.floating],
    pos: NDArray[np.floating],
    quat_wxyz: NDArray[np.floating],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Convert world poses to the object frame; NaN poses (failed attempts) stay NaN.

    Args:
        object_pos: (N, 3) [m].
        object_quat_wxyz: (N, 4).
        pos: (N, ..., 3) [m].
        quat_wxyz: (N, ..., 4).
    """
    axes = (slice(None), *[None] * (pos.ndim - 2))
    q_object_world = quat_conjugate(object_quat_wxyz)[axes]
    offset = pos.astype(np.float64) - np.asarray(object_pos, np.float64)[axes]
    R_object_world = matrix_from_quat(quat_conjugate(object_quat_wxyz))[axes]
    moved = np.einsum("...ij,...j->...i", R_object_world, offset)
    turned = np.full(quat_wxyz.shape, np.nan)
    known = np.isfinite(quat_wxyz).all(axis=-1)
    both = quat_multiply(q_object_world, quat_wxyz)
    if known.any():
        turned[known] = quat_canonical(both[known])
    return moved.astype(np.float32), turned.astype(np.float32)


def points_in_world(
    object_pos: NDArray[np.floating],
    object_quat_wxyz: NDArray[np.floating],
    points: NDArray[np.floating],
) -> NDArray[np.float32]:
    """Convert points (N, P, 3) in the object frame to the world [m]."""
    R_world_object = matrix_from_quat(object_quat_wxyz).astype(np.float32)
    shift = np.asarray(object_pos, np.float32)[:, None]
    moved = points @ np.swapaxes(R_world_object, 1, 2) + shift
    return moved.astype(np.float32, copy=False)
