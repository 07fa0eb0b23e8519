"""Points on a surface: area-weighted draw, farthest-point order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .config import SurfaceConfig
from .mesh_queries import faces_wall
from .physics import face_areas
from .prepared import TriangleMesh

_LIFT = 1e-5
"""How far a ray starts off the surface, so that it does not hit its own face."""


def surface_points(
    solid: TriangleMesh, config: SurfaceConfig
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Draw points (P, 3) on a solid with outward unit normals (P, 3), in farthest-point order.

    The first k points of the result are a farthest-point sample of all of them, so a smaller set
    is a prefix. Points in the cracks between convex pieces are left out.
    """
    rng = np.random.default_rng(config.seed)
    points, normals = _draw(solid, config.points, rng)
    open_ = ~_in_crack(solid, points, normals, config.crack)
    # Redraw what the cracks took; a solid that is all cracks keeps its points.
    for _ in range(4):
        missing = config.points - int(open_.sum())
        if missing <= 0 or not open_.any():
            break
        more_points, more_normals = _draw(solid, 2 * missing + 16, rng)
        more_open = ~_in_crack(solid, more_points, more_normals, config.crack)
        points = np.concatenate([points, more_points])
        normals = np.concatenate([normals, more_normals])
        open_ = np.concatenate([open_, more_open])
    if open_.sum() >= config.points:
        points, normals = points[open_][: config.points], normals[open_][: config.points]
    else:
        points, normals = points[: config.points], normals[: config.points]
    points = points.astype(np.float32)
    order = farthest_point_order(points)
    return points[order], normals[order].astype(np.float32)


def sample_surface(
    mesh: TriangleMesh, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Draw points (count, 3) uniformly by area, with the face each lies on (count,)."""
    corners = mesh.vertices[mesh.faces]
    cumulative = np.cumsum(face_areas(mesh))
    draw = rng.random((count, 3))
    face = np.searchsorted(cumulative, draw[:, 0] * cumulative[-1], side="right")
    face = np.minimum(face, len(corners) - 1)
    root, v = np.sqrt(draw[:, 1]), draw[:, 2]
    weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    return np.einsum("pk,pkx->px", weights, corners[face]), face


def farthest_point_order(
    points: NDArray[np.float32], count: int | None = None
) -> NDArray[np.int64]:
    """Order points (P, 3): each next one is farthest from all before it; the first comes first.

    Ties go to the lower index, so the order is a function of the points alone. `count` stops after
    so many of them, (count,); all P when omitted.
    """
    count = len(points) if count is None else min(count, len(points))
    order = np.zeros(count, np.int64)
    if count == 0:
        return order
    x, y, z = (np.ascontiguousarray(points[:, k]) for k in range(3))
    nearest = np.full(len(points), np.inf, np.float32)
    current = 0
    for k in range(count):
        order[k] = current
        square = np.square(x - x[current])
        square += np.square(y - y[current])
        square += np.square(z - z[current])
        np.minimum(nearest, square, out=nearest)
        # Below every distance: a chosen point is never chosen again, even among copies.
        nearest[current] = -1.0
        current = int(np.argmax(nearest))
    return order


def _draw(
    mesh: TriangleMesh, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points, face = sample_surface(mesh, count, rng)
    corners = mesh.vertices[mesh.faces[face]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return points, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _in_crack(
    mesh: TriangleMesh,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    depth: float,
) -> NDArray[np.bool_]:
    return faces_wall(mesh, points + _LIFT * normals, normals, depth)
