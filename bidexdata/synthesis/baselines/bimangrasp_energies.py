"""BimanGrasp's energy terms, float64 on plain arrays: the readable reference of its kernels.

One function per term, unweighted. Axes lead with the batch; C contacts of both hands, P points, K
spheres; object frame, metres, torques about its origin without a scale.

Source: BimanGrasp (arXiv 2411.15903) in its released form, Tsunami-kun/BimanGrasp-Generation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

LEAST_SINGULAR = 1e-6
"""Singular values count as at least this [-]: the released code adds noise of this size to G."""


class Terms(NamedTuple):
    """Unweighted energies of N grasps."""

    fc: Float[np.ndarray, "*b"]
    dis: Float[np.ndarray, "*b"]
    """[m]."""
    pen: Float[np.ndarray, "*b"]
    """[m]."""
    spen: Float[np.ndarray, "*b"]
    """[m]."""
    joints: Float[np.ndarray, "*b"]
    """[rad]."""
    vew: Float[np.ndarray, "*b"]


def normal_wrenches(
    points: Float[np.ndarray, "*b C 3"], normals_in: Float[np.ndarray, "*b C 3"]
) -> Float[np.ndarray, "*b 6 C"]:
    """Give G whose columns are the wrenches (n, p x n) of unit normal forces."""
    columns = np.concatenate([normals_in, np.cross(points, normals_in)], axis=-1)
    return np.swapaxes(columns, -1, -2)


def closure_energy(G: Float[np.ndarray, "*b 6 C"]) -> Float[np.ndarray, "*b"]:
    """Give E_fc = log(cond(G) + 1) / 10; the sign of a normal does not matter."""
    s = np.maximum(np.linalg.svd(G, compute_uv=False), LEAST_SINGULAR)
    return np.asarray(np.log(s[..., 0] / s[..., -1] + 1.0) / 10.0)


def wrench_volume_energy(G: Float[np.ndarray, "*b 6 C"]) -> Float[np.ndarray, "*b"]:
    """Give E_vew = exp(-(sum of the logarithms of G's singular values) / 10)."""
    s = np.maximum(np.linalg.svd(G, compute_uv=False), LEAST_SINGULAR)
    return np.asarray(np.exp(-np.sum(np.log(s), axis=-1) / 10.0))


def distance_energy(distance: Float[np.ndarray, "*b C"]) -> Float[np.ndarray, "*b"]:
    """Sum the absolute distances of the contacts from the surface, E_dis [m]."""
    return np.asarray(np.sum(np.abs(distance), axis=-1))


def depth_in_spheres(
    points: Float[np.ndarray, "*b P 3"],
    centres: Float[np.ndarray, "*b K 3"],
    radius: Float[np.ndarray, " K"],
) -> Float[np.ndarray, "*b P"]:
    """How deep points lie in the deepest of a hand's spheres [m], negative outside."""
    away = np.linalg.norm(points[..., :, None, :] - centres[..., None, :, :], axis=-1)
    return np.asarray(np.max(radius - away, axis=-1))


def penetration_energy(depth: Float[np.ndarray, "*b P"]) -> Float[np.ndarray, "*b"]:
    """Sum the depths of points inside a hand: E_pen, and the part of E_spen between hands [m]."""
    return np.asarray(np.sum(np.maximum(depth, 0.0), axis=-1))


def keypoint_energy(
    keypoints: Float[np.ndarray, "*b K 3"], pairs: Int[np.ndarray, "Q 2"], reach: float
) -> Float[np.ndarray, "*b"]:
    """Sum how much nearer than `reach` the pairs are, both ways round: E_spen in a hand [m].

    A pair counts twice, as in the released code, whose sum runs over ordered pairs.
    """
    offset = keypoints[..., pairs[:, 0], :] - keypoints[..., pairs[:, 1], :]
    return np.asarray(
        2.0 * np.sum(np.maximum(reach - np.linalg.norm(offset, axis=-1), 0.0), axis=-1)
    )


def joint_energy(
    joints: Float[np.ndarray, "*b J"],
    lower: Float[np.ndarray, " J"],
    upper: Float[np.ndarray, " J"],
) -> Float[np.ndarray, "*b"]:
    """Sum how far joints are beyond their limits, E_joints [rad]."""
    return np.asarray(
        np.sum(np.maximum(joints - upper, 0.0) + np.maximum(lower - joints, 0.0), axis=-1)
    )
