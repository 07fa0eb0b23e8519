"""Rotations and rigid transforms: quaternions wxyz, column vectors, float64.

`T_a_b` maps coordinates in frame b to frame a. Batch axes lead. Stored quaternions are unit with
w >= 0 (for w = 0 the first non-zero component is positive); q and -q are the same rotation.
scipy and Warp order quaternions xyzw: only `xyzw_from_wxyz` and `wxyz_from_xyzw` cross that line.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

IDENTITY_QUAT: Array = np.array([1.0, 0.0, 0.0, 0.0])
_TINY = 1e-12


def quat_canonical(q: ArrayLike) -> Array:
    """Return the unit quaternion of the same rotation in stored form, (..., 4).

    Raises:
        ValueError: A quaternion has zero length or is not finite.
    """
    parts: Array = np.asarray(q, np.float64)
    norm: Array = np.asarray(np.linalg.norm(parts, axis=-1, keepdims=True))
    if not np.all(np.isfinite(norm)) or np.any(norm < _TINY):
        raise ValueError("a quaternion of zero length or with non-finite parts has no rotation")
    unit: Array = np.asarray(parts / norm)
    # The sign of the first component that is not zero decides, w first.
    nonzero = np.abs(unit) > _TINY
    first = np.argmax(nonzero, axis=-1)[..., None]
    return np.asarray(unit * np.sign(np.take_along_axis(unit, first, axis=-1)), np.float64)


def quat_multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """Compose rotations: the result turns by `b` first, then by `a`; (..., 4)."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, np.float64), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, np.float64), -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def quat_conjugate(q: ArrayLike) -> Array:
    """Invert unit quaternions, (..., 4)."""
    return np.asarray(q, np.float64) * np.array([1.0, -1.0, -1.0, -1.0])


def quat_rotate(q: ArrayLike, v: ArrayLike) -> Array:
    """Rotate vectors (..., 3) by unit quaternions (..., 4)."""
    return np.einsum("...ij,...j->...i", matrix_from_quat(q), np.asarray(v, np.float64))


def matrix_from_quat(q: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(np.asarray(q, np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quat_from_matrix(R: ArrayLike) -> Array:
    """Canonical quaternions (..., 4) of rotation matrices (..., 3, 3), half turns included."""
    R = np.asarray(R, np.float64)
    m = R.reshape(-1, 3, 3)
    trace = np.einsum("nii->n", m)
    d = np.einsum("nii->ni", m)
    # Four times the squared component, largest first: never divides by a small number.
    squares = np.concatenate([(1 + trace)[:, None], 1 - trace[:, None] + 2 * d], axis=1)
    best = np.argmax(squares, axis=1)
    skew = np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], 1)
    sym = np.stack([m[:, 1, 0] + m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0], m[:, 2, 1] + m[:, 1, 2]], 1)
    xy, xz, yz = sym.T
    sx, sy, sz = skew.T
    table = np.stack(
        [
            np.stack([squares[:, 0], sx, sy, sz], 1),
            np.stack([sx, squares[:, 1], xy, xz], 1),
            np.stack([sy, xy, squares[:, 2], yz], 1),
            np.stack([sz, xz, yz, squares[:, 3]], 1),
        ],
        axis=1,
    )
    q = table[np.arange(len(m)), best]
    return quat_canonical(q).reshape(*R.shape[:-2], 4)


def quat_from_rotation_vector(v: ArrayLike) -> Array:
    """Canonical quaternions (..., 4) of rotation vectors (axis times angle [rad]), (..., 3)."""
    v = np.asarray(v, np.float64)
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    half = 0.5 * angle
    # sin(x)/x by numpy's sinc, which is exact at zero.
    return quat_canonical(np.concatenate([np.cos(half), 0.5 * v * np.sinc(half / np.pi)], axis=-1))


def rotation_vector_from_quat(q: ArrayLike) -> Array:
    """Rotation vectors (..., 3) with angle in [0, pi] [rad] of quaternions (..., 4)."""
    q = quat_canonical(q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., :1])
    scale = np.where(sine > _TINY, angle / np.maximum(sine, _TINY), 2.0)
    return q[..., 1:] * scale


def quat_angle(a: ArrayLike, b: ArrayLike) -> Array:
    """Angle [rad] in [0, pi] between two rotations given as unit quaternions, (...)."""
    d = quat_multiply(quat_conjugate(a), b)
    return 2 * np.arctan2(np.linalg.norm(d[..., 1:], axis=-1), np.abs(d[..., 0]))


def quat_slerp(a: ArrayLike, b: ArrayLike, t: ArrayLike) -> Array:
    """Turn from `a` (t = 0) to `b` (t = 1) at constant speed along the shorter arc, (..., 4)."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    step = rotation_vector_from_quat(quat_multiply(quat_conjugate(a), b))
    t = np.asarray(t, np.float64)[..., None]
    return quat_canonical(quat_multiply(a, quat_from_rotation_vector(step * t)))


def random_quat(rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Array:
    """Draw uniformly distributed canonical quaternions, (*shape, 4)."""
    return quat_canonical(rng.standard_normal((*shape, 4)))


def transform(pos: ArrayLike, quat: ArrayLike) -> Array:
    """Homogeneous matrices (..., 4, 4) of positions (..., 3) [m] and quaternions (..., 4)."""
    R = matrix_from_quat(quat)
    pos = np.asarray(pos, np.float64)
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, pos, 1.0
    return T


def pos_quat(T: ArrayLike) -> tuple[Array, Array]:
    """Positions (..., 3) [m] and canonical quaternions (..., 4) of matrices (..., 4, 4)."""
    T = np.asarray(T, np.float64)
    return T[..., :3, 3].copy(), quat_from_matrix(T[..., :3, :3])


def invert(T_a_b: ArrayLike) -> Array:
    """Return T_b_a for rigid T_a_b, (..., 4, 4)."""
    T = np.asarray(T_a_b, np.float64)
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    out = np.zeros_like(T)
    out[..., :3, :3] = R_t
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", R_t, T[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def apply(T_a_b: ArrayLike, points_b: ArrayLike) -> Array:
    """Map points (..., n, 3) in frame b to frame a by T_a_b (..., 4, 4) [m]."""
    T, p = np.asarray(T_a_b, np.float64), np.asarray(points_b, np.float64)
    return p @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def rotation_with_z(z: ArrayLike) -> Array:
    """Return some rotation matrix (..., 3, 3) whose third column is the unit vector z (..., 3).

    The other two columns follow the axis that is least aligned with z, so the result is defined
    for every z, the six axis directions included.
    """
    z = np.asarray(z, np.float64)
    helper = np.zeros_like(z)
    np.put_along_axis(helper, np.argmin(np.abs(z), axis=-1)[..., None], 1.0, axis=-1)
    x: Array = np.asarray(np.cross(helper, z), np.float64)
    x = np.asarray(x / np.linalg.norm(x, axis=-1, keepdims=True), np.float64)
    return np.stack([x, np.asarray(np.cross(z, x), np.float64), z], axis=-1)


def xyzw_from_wxyz(q: ArrayLike) -> Array:
    """Reorder quaternions for scipy and Warp, (..., 4)."""
    return np.roll(np.asarray(q, np.float64), -1, axis=-1)


def wxyz_from_xyzw(q: ArrayLike) -> Array:
    """Reorder quaternions that scipy or Warp returned, (..., 4)."""
    return np.roll(np.asarray(q, np.float64), 1, axis=-1)
