"""Points on the surface of a hand's collision spheres, which a release carries without its meshes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.hands.model import FloatArray, Hand, IntArray

_PER_SPHERE = 256
"""Candidates on each sphere, from which the surface is drawn."""
_GOLDEN = (1 + 5**0.5) / 2


class SphereSurface(NamedTuple):
    """Points in the frames of the bodies that carry them."""

    body: IntArray
    """(P,)."""
    points: FloatArray
    """[m], (P, 3)."""
    normals: FloatArray
    """Outward unit normals, (P, 3)."""


def sphere_surface(hand: Hand, count: int) -> SphereSurface:
    """Spread points over the union of the spheres of each body, by area and always the same.

    Args:
        hand: The hand.
        count: Points over all bodies.
    """
    directions = spiral(_PER_SPHERE)
    body, points, normals, areas = [], [], [], []
    for k, radius in enumerate(hand.sphere_radius):
        mine = hand.sphere_pos[k] + radius * directions
        others = np.flatnonzero(hand.sphere_body == hand.sphere_body[k])
        others = others[others != k]
        gap = np.linalg.norm(mine[:, None] - hand.sphere_pos[others], axis=-1)
        free = np.all(gap >= hand.sphere_radius[others], axis=1)
        body.append(np.full(free.sum(), hand.sphere_body[k], np.int32))
        points.append(mine[free])
        normals.append(directions[free])
        areas.append(np.full(free.sum(), radius**2))
    area = np.concatenate([np.zeros(0), *areas])
    # Even steps along the summed area: as many points on a patch as its share of it.
    steps = (np.arange(count) + 0.5) / max(count, 1) * area.sum()
    chosen = np.minimum(np.searchsorted(np.cumsum(area), steps), max(len(area) - 1, 0))
    if not len(area):
        chosen = np.zeros(0, np.int64)
    return SphereSurface(
        np.concatenate([np.zeros(0, np.int32), *body])[chosen],
        np.concatenate([np.zeros((0, 3)), *points])[chosen],
        np.concatenate([np.zeros((0, 3)), *normals])[chosen],
    )


def spiral(count: int) -> Float[np.ndarray, "n 3"]:
    """Unit vectors spread evenly over the sphere, along a spiral (Fibonacci lattice)."""
    k = np.arange(count)
    z = 1 - (2 * k + 1) / count
    angle = 2 * np.pi * k / _GOLDEN
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
