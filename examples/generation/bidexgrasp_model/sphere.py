"""The minimum bounding sphere of a cloud, exact, and as weights of at most four of its points."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

_ROUNDS = 1000
"""More than any cloud needs: the sphere grows with every round."""
_INSIDE = 1e-9
"""Share of the radius by which a point may lie outside: float64 and solving 3 x 3 systems."""


class Support(NamedTuple):
    """The points that a sphere is held by. They stay so when the cloud is moved or scaled."""

    point: Int[np.ndarray, 4]
    """Of points; repeated where fewer than four hold the sphere."""
    weight: Float[np.ndarray, 4]
    """The centre is the sum of weight times point; 0 for repeated points."""


def minimum_sphere(points: Float[np.ndarray, "P 3"]) -> Support:
    """Find the smallest sphere that holds all points.

    Starting from one point, the farthest point outside joins those that hold the sphere, and of
    them the smallest sphere is kept; its radius grows with every round, so it ends.

    Args:
        points: [m], at least one.
    """
    points = np.asarray(points, np.float64)
    chosen: tuple[int, ...] = (0,)
    for _ in range(_ROUNDS):
        weight = _weights(points[list(chosen)])
        centre = weight @ points[list(chosen)]
        radius = np.linalg.norm(points[chosen[0]] - centre)
        distance = np.linalg.norm(points - centre, axis=1)
        far = int(distance.argmax())
        if far in chosen or distance[far] <= radius * (1 + _INSIDE):
            break
        chosen = _smallest_of(points, (*chosen, far))
    weight = _weights(points[list(chosen)])
    index = np.full(4, chosen[0], np.int64)
    index[: len(chosen)] = chosen
    full = np.zeros(4)
    full[: len(chosen)] = weight
    return Support(index, full)


def _smallest_of(points: np.ndarray, numbers: tuple[int, ...]) -> tuple[int, ...]:
    """Of at most five points, those that hold their smallest sphere."""
    best, best_radius = numbers[:1], np.inf
    every = points[list(numbers)]
    for size in range(1, 5):
        for subset in combinations(numbers, size):
            weight = _weights(points[list(subset)])
            if weight is None or (weight < -1e-12).any():
                continue
            centre = weight @ points[list(subset)]
            radius = np.linalg.norm(points[subset[0]] - centre)
            holds = np.linalg.norm(every - centre, axis=1).max() <= radius * (1 + _INSIDE) + 1e-15
            if holds and radius < best_radius:
                best, best_radius = subset, radius
    return best


def _weights(corner: np.ndarray) -> np.ndarray | None:
    """Weights of the centre of the sphere through 1 to 4 points, in the plane that they span."""
    edges = corner[1:] - corner[0]
    if not len(edges):
        return np.ones(1)
    gram = edges @ edges.T
    half = 0.5 * np.diag(gram)
    try:
        along = np.linalg.solve(gram, half)
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(along).all():
        return None
    return np.concatenate([[1 - along.sum()], along])
