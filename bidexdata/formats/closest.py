"""Distance from points to triangles, in plain numpy: checks lean on nothing that made the data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BLOCK = 2_000_000
"""Point-triangle pairs per block: about 200 MB of intermediate arrays."""


def distance_to_triangles(
    points: NDArray[np.floating], triangles: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Unsigned distance from each point to the nearest of the triangles, (n,).

    Args:
        points: (n, 3).
        triangles: Corners, (f, 3, 3).
    """
    points, triangles = np.asarray(points, np.float64), np.asarray(triangles, np.float64)
    out = np.empty(len(points))
    step = max(1, BLOCK // max(len(triangles), 1))
    for at in range(0, len(points), step):
        block = points[at : at + step, None]
        out[at : at + step] = np.sqrt(_squared(block, triangles[None]).min(axis=1))
    return out


def _squared(p: NDArray[np.float64], tri: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared distances (n, f): to the plane where the foot lies inside, else to the edges."""
    a, b, c = tri[:, :, 0], tri[:, :, 1], tri[:, :, 2]
    edges = np.minimum(np.minimum(_to_segment(p, a, b), _to_segment(p, b, c)), _to_segment(p, c, a))
    normal = np.cross(b - a, c - a)
    length2 = np.einsum("...i,...i->...", normal, normal)
    # The foot of the perpendicular is inside when it lies left of all three edges.
    inside = np.ones(edges.shape, bool)
    for start, end in ((a, b), (b, c), (c, a)):
        side = np.einsum("...i,...i->...", np.cross(end - start, p - start), normal)
        inside &= side >= 0
    height = np.einsum("...i,...i->...", p - a, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = height**2 / length2
    return np.where(inside & (length2 > 0), plane, edges)


def _to_segment(
    p: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    along, offset = b - a, p - a
    length2 = np.einsum("...i,...i->...", along, along)
    t = np.einsum("...i,...i->...", offset, along) / np.where(length2 > 0, length2, 1.0)
    rest = offset - np.clip(t, 0, 1)[..., None] * along
    return np.einsum("...i,...i->...", rest, rest)
