"""Points on the hull of a dilated object: where peers' hands start."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.surface import farthest_point_order, sample_surface

if TYPE_CHECKING:
    from bidexdata.objects.prepared import PreparedObject

_DRAWN = 16
"""Points drawn by area for each that is kept in farthest-point order."""


class HullPoints(NamedTuple):
    """Points on a convex hull with the outward unit normals of their faces."""

    points: Float[np.ndarray, "n 3"]
    """[m]."""
    normals: Float[np.ndarray, "n 3"]


def along_normals(obj: PreparedObject, size: float, way: float) -> Float[np.ndarray, "P 3"]:
    """Move the surface points of an object of `size` [m] out along their normals by `way` [m]."""
    return size * obj.surface_points.astype(np.float64) + way * obj.surface_normals


def from_origin(obj: PreparedObject, size: float, way: float) -> Float[np.ndarray, "V 3"]:
    """Move the hull's vertices away from the origin by `way` [m]."""
    vertices = size * np.asarray(obj.hull.vertices, np.float64)
    length = np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices * (1.0 + way / np.maximum(length, 1e-9))


def hull_points(
    vertices: Float[np.ndarray, "V 3"], count: int, rng: np.random.Generator
) -> HullPoints:
    """Spread points evenly over the convex hull of vertices, in farthest-point order.

    Args:
        vertices: [m].
        count: At most so many points.
        rng: Draws the points to choose from.
    """
    from scipy.spatial import ConvexHull

    hull = ConvexHull(vertices)
    mesh = TriangleMesh(vertices, hull.simplices.astype(np.int32))
    drawn, face = sample_surface(mesh, _DRAWN * count, rng)
    kept = farthest_point_order(drawn.astype(np.float32), count)
    return HullPoints(drawn[kept], hull.equations[face[kept], :3])
