"""How far a contact set's wrench space reaches: its support function and a sampled estimate.

W is the Minkowski sum over contacts of {G f : 0 <= f_n <= 1, |f_t| <= mu f_n}. In a direction
without torque the farthest point of W follows from the normals alone, in closed form; the sampled
estimates are those that the paper and its sources describe.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bidexdata.wrench.contact_model import contact_frames, grasp_matrix

_TINY = 1e-12

AXES: np.ndarray = np.repeat(np.eye(3), 2, axis=0) * np.tile([1.0, -1.0], 3)[:, None]
"""The six disturbance directions +-x, +-y, +-z of the paper, (6, 3)."""


def force_support(
    normals_in: Float[np.ndarray, "*b C 3"], directions: Float[np.ndarray, "D 3"], *, mu: float
) -> Float[np.ndarray, "*b D"]:
    """Give h_W(t) = sum_i max(0, t_n + mu |t_t|) for unit force directions t without torque.

    Support functions of Minkowski sums add, so the value of a pair of regions is the sum of the
    regions' values.

    Args:
        normals_in: Inward unit normals.
        directions: Unit vectors t.
        mu: Friction coefficient [-].

    Returns:
        Largest force along each direction, in units of one contact's cap.

    Source:
        Exact value of the inner maximum in BiDexGrasp 4.2, attained at f = 0 or on the cone's rim.
    """
    along = np.einsum("...ci,di->...cd", normals_in, directions)
    across = np.sqrt(np.maximum(1.0 - along * along, 0.0))
    return np.maximum(along + mu * across, 0.0).sum(axis=-2)


def sampled_boundary(
    points: Float[np.ndarray, "C 3"],
    normals_in: Float[np.ndarray, "C 3"],
    directions: Float[np.ndarray, "D 3"],
    *,
    mu: float,
    length: float,
    smooth: bool = True,
) -> Float[np.ndarray, "D 6"]:
    """Sample wrenches of W along force directions, one per direction.

    Args:
        points: Contact points relative to the torque reference [m].
        normals_in: Inward unit normals.
        directions: Random unit vectors u; the wrench direction is (u, 0).
        mu: Friction coefficient [-].
        length: Torque length [m].
        smooth: As the TDG estimator does, which keeps gradients alive: a contact in front gives
            the point where u meets its disc, a contact behind fades out although it no longer
            helps, so the sum stays well inside W. False: each contact's exact support point.

    Returns:
        Wrenches, torque over `length`, in units of one contact's cap.

    Source:
        Chen et al. 2023 (TDG), as BiDexGrasp 4.2 and BODex use it.
    """
    G = grasp_matrix(points / length, contact_frames(normals_in))
    local = np.einsum("cij,di->dcj", G[:, :3], directions)
    forward, side = local[..., 0], np.linalg.norm(local[..., 1:], axis=-1)
    unit = local[..., 1:] / np.maximum(side, _TINY)[..., None]
    if smooth:
        alpha = np.arctan(mu)
        ahead = side / np.maximum(forward, 0.5 * np.cos(alpha))
        reach = np.where(np.arccos(np.clip(forward, -1.0, 1.0)) <= alpha, ahead, mu)
        behind = side / np.maximum(side - 2.0 * mu * np.minimum(forward, 0.0), _TINY)
        share = np.where(forward >= 0.0, 1.0, behind)
    else:
        reach = np.full_like(side, mu)
        share = (forward + mu * side > 0.0).astype(np.float64)
    force = np.concatenate([np.ones_like(side)[..., None], reach[..., None] * unit], axis=-1)
    return np.einsum("cij,dcj->di", G, force * share[..., None])


def sampled_score(
    points: Float[np.ndarray, "C 3"],
    normals_in: Float[np.ndarray, "C 3"],
    directions: Float[np.ndarray, "D 3"],
    *,
    mu: float,
    length: float,
    smooth: bool = True,
) -> float:
    """Give the paper's score from boundary wrenches, the estimate it describes.

    Args:
        points: As in `sampled_boundary`, likewise the rest.
        normals_in: Inward unit normals.
        directions: The paper draws 1000.
        mu: Friction coefficient [-].
        length: Torque length [m].
        smooth: TDG's support points instead of exact ones.

    Source:
        BiDexGrasp 4.2: s = min over six axes of the max over M = 1000 wrenches of t . w.
    """
    w = sampled_boundary(points, normals_in, directions, mu=mu, length=length, smooth=smooth)
    return float((w[:, :3] @ AXES.T).max(axis=0).min())
