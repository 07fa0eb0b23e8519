"""Closing the cracks between convex pieces.

A decomposition cuts a solid along planes, and neighbours touch there without overlapping. Their
union would keep the cut as an inner surface: on a cow in 23 pieces 36 % of all surface samples lay
inside, where no fingertip can be and where the signed distance should be deep. So every facet with
material beyond it is pushed a little into that material.
"""

from __future__ import annotations

import numpy as np

from .closed import as_mesh, convex_hull
from .facets import facets
from .mesh_queries import winding_distances
from .prepared import TriangleMesh

_COPLANAR = 0.05
"""Triangles of a piece whose normals differ by less [rad] are one facet."""


def overlap_cuts(
    pieces: list[TriangleMesh], mesh: TriangleMesh, overlap: float
) -> list[TriangleMesh]:
    """Push facets that cut through a closed mesh outward by `overlap`.

    A facet is a cut when most of its area, moved out by `overlap`, still lies inside the mesh.
    """
    return [_pushed(piece, mesh, overlap) for piece in pieces]


def _pushed(piece: TriangleMesh, mesh: TriangleMesh, overlap: float) -> TriangleMesh:
    groups = facets(piece, _COPLANAR)
    corners = piece.vertices[piece.faces]
    normal = groups.normals[groups.of_face]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    inside = winding_distances(mesh, corners.mean(axis=1) + overlap * normal) < 0
    count = len(groups.normals)
    within = np.bincount(groups.of_face, weights=area * inside, minlength=count)
    cut = within > 0.5 * np.bincount(groups.of_face, weights=area, minlength=count)
    if not cut.any():
        return piece
    moved = corners + overlap * normal[:, None]
    added = moved[cut[groups.of_face]].reshape(-1, 3)
    return as_mesh(convex_hull(np.concatenate([piece.vertices, added])))
