"""The quasi-static closing of `settling_kernels` in float64 numpy, all grasps and places at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bidexdata.frames import matrix_from_quat, quat_from_rotation_vector
from bidexdata.objects.distance_field import signed_distance

# What `settling_kernels` says of each.
TOUCH, HELD, HELD_ARM = 2e-4, 0.1, 0.01


class Rested(NamedTuple):
    """How N objects lie in the end, each from S places."""

    pressed: np.ndarray
    """Depths that each hand's contact points aim inside [m], (N, S, 2)."""
    touching: np.ndarray
    """(N, S)."""
    turned: np.ndarray
    """[rad], (N, S)."""


def rested(grid, size, places, centres, side, radius, config) -> Rested:
    """Close contact points on an object that goes at once to where their springs balance.

    Every sphere's distance is looked up at every move; the kernel remembers those that are far off.

    Args:
        grid: Signed distances at unit diagonal.
        size: Bounding-box diagonals [m], (N,).
        places: Where the object lies at first [m], (S, 3).
        centres: Spheres at pre-grasp, grasp and squeeze [m], (N, 3, M, 3).
        side: Hand of each sphere, (M,).
        radius: [m], (M,).
        config: A `SettlingConfig`.
    """
    R = np.tile(np.eye(3), (len(centres), len(places), 1, 1))
    t = np.tile(places, (len(centres), 1, 1))
    y = centres[:, None, 0] - t[:, :, None]
    gap, n = clearance(grid, size, y, radius)
    moves = config.closing_moves + config.pressing_moves + config.waiting_moves
    for k in range(moves * config.repeats):
        told = target(centres, k // config.repeats, config)[:, None]
        goal = np.einsum("nsji,nsmj->nsmi", R, told - t[:, :, None])
        _, slide, _ = contact(goal - y, gap, n, config.friction)
        y = y + at_most(slide, config.stride)
        gap, n = clearance(grid, size, y, radius)
        y = y + np.maximum(-gap, 0)[..., None] * n
        presses, slide, depth = contact(goal - y, gap, n, config.friction)
        # What friction does not let go by, and what pushes inwards, pulls at the object.
        pull = np.where(presses[..., None], goal - y - slide, 0.0)
        p = np.where(presses[..., None], y - radius[:, None] * n, 0.0)
        R, t = balanced(R, t, p, pull, presses, config.stride)
    depth = np.where(presses, depth, 0.0)
    pressed = np.stack([depth[..., side == h].sum(axis=-1) for h in (0, 1)], axis=-1)
    cosine = (np.trace(R, axis1=-2, axis2=-1) - 1) / 2
    return Rested(pressed, presses.sum(axis=-1), np.arccos(np.clip(cosine, -1, 1)))


def at_most(x, most):
    return x * np.minimum(1.0, most / np.maximum(np.linalg.norm(x, axis=-1), 1e-9))[..., None]


def clearance(grid, size, x, radius):
    """Gaps between spheres and object [m], and the outward unit normals under them."""
    s = size[:, None, None]
    d, slope = signed_distance(grid, 1.0, x / s[..., None])
    return s * d - radius, slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-12)


def target(centres, move, config):
    """Where the spheres are told to be after a move, (N, M, 3)."""
    if move < config.closing_moves:
        u = (move + 1) / config.closing_moves
        return (1 - u) * centres[:, 0] + u * centres[:, 1]
    u = min((move + 1 - config.closing_moves) / config.pressing_moves, 1.0)
    return (1 - u) * centres[:, 1] + u * centres[:, 2]


def contact(way, gap, n, friction):
    """Which spheres press, how far each still goes, and how deep each aims inside.

    One that presses slides along the surface by what exceeds its friction cone.
    """
    depth = -np.sum(way * n, axis=-1)
    presses = (gap < TOUCH) & (depth > 0)
    along = way + depth[..., None] * n
    held = friction * np.maximum(depth, 0.0)
    slide = (
        along
        * (1 - np.minimum(1, held / np.maximum(np.linalg.norm(along, axis=-1), 1e-9)))[..., None]
    )
    return presses, np.where(presses[..., None], slide, way), depth


def balanced(R, t, p, pull, presses, stride):
    """Pose of the object once the forces `pull` of its springs at `p` balance, within a stride."""
    touching = presses.sum(axis=-1)[..., None]
    middle = p.sum(axis=-2) / np.maximum(touching, 1)
    force, torque = pull.sum(axis=-2), np.cross(p, pull).sum(axis=-2)
    arm = np.where(presses[..., None], p - middle[..., None, :], 0.0)
    square = np.sum(arm * arm, axis=(-1, -2))[..., None, None] * np.eye(3)
    stiff = square - np.einsum("nsmi,nsmj->nsij", arm, arm) + HELD * HELD_ARM**2 * np.eye(3)
    turn = np.linalg.solve(stiff, (torque - np.cross(middle, force))[..., None])[..., 0]
    ahead = R @ matrix_from_quat(quat_from_rotation_vector(at_most(turn, 10 * stride)))
    shift = at_most(force / (touching + HELD), stride)
    moved = np.einsum("nsij,nsj->nsi", R, middle + shift)
    return ahead, t + moved - np.einsum("nsij,nsj->nsi", ahead, middle)
