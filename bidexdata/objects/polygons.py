"""Triangles of polygons that need be neither convex nor exactly flat."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def triangulated(
    vertices: NDArray[np.float64], corners: NDArray[np.int64], counts: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Split polygons into triangles (F, 3) of the same winding, in the order of the polygons.

    Convex ones become fans; others are cut along diagonals inside them.

    Args:
        vertices: (V, 3).
        corners: Vertex numbers of all polygons, one after the other, (sum of counts,); in range.
        counts: Corners of each polygon, (P,); polygons of fewer than three give nothing.
    """
    start = np.cumsum(counts) - counts
    pieces, owner = [], []
    for count in np.unique(counts[counts >= 3]):
        which = np.flatnonzero(counts == count)
        polygons = corners[start[which, None] + np.arange(count)]
        k = np.arange(1, count - 1)
        fan = np.stack([np.zeros_like(k), k, k + 1], axis=1)
        cut = np.broadcast_to(fan, (len(which), *fan.shape)).copy()
        for concave in np.flatnonzero(~_convex(vertices[polygons])) if count > 3 else ():
            cut[concave] = _ears(vertices[polygons[concave]], fan)
        pieces.append(np.take_along_axis(polygons[:, None, :], cut, axis=2).reshape(-1, 3))
        owner.append(np.repeat(which, count - 2))
    if not pieces:
        return np.zeros((0, 3), np.int64)
    return np.concatenate(pieces)[np.argsort(np.concatenate(owner), kind="stable")]


def _normals(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Newell's normals (P, 3) of polygons (P, n, 3): twice the area long."""
    first = points[:, :1]
    a = points - first
    return np.cross(a, np.roll(a, -1, axis=1)).sum(axis=1)


def _convex(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which polygons (P, n, 3) turn the same way at every corner and only once around."""
    edge = np.roll(points, -1, axis=1) - points
    turn = np.cross(edge, np.roll(edge, -1, axis=1))
    normal = _normals(points)
    along = np.einsum("pni,pi->pn", turn, normal)
    size = np.einsum("pi,pi->p", normal, normal)
    # Turning one way only, a polygon may still wind around twice: its fan then turns back.
    fan = points[:, 1:] - points[:, :1]
    fans = np.einsum("pni,pi->pn", np.cross(fan[:, :-1], fan[:, 1:]), normal)
    return (along >= -1e-9 * size[:, None]).all(1) & (fans >= -1e-9 * size[:, None]).all(1)


def _ears(points: NDArray[np.float64], fan: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cut one polygon (n, 3) in its plane; the fan where that fails."""
    import manifold3d

    normal = _normals(points[None])[0]
    length = float(np.linalg.norm(normal))
    if not np.isfinite(length) or length == 0:
        return fan
    normal = normal / length
    across = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(normal, across)
    u /= np.linalg.norm(u)
    flat = (points - points[0]) @ np.stack([u, np.cross(normal, u)], axis=1)
    # Duplicate corners are legal in files; an epsilon of the library's own choice copes.
    found = np.asarray(manifold3d.triangulate([flat / np.sqrt(length)]), np.int64)
    return found if found.shape == fan.shape else fan
