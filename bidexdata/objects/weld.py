"""Welding: vertices at one place become one vertex, triangles that collapse by it go."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .prepared import TriangleMesh

_CROWDED = 4
"""Faces per vertex above which there must be copies: a closed mesh has about two."""


def weld(mesh: TriangleMesh, tolerance: float) -> TriangleMesh:
    """Merge vertices closer than `tolerance` and drop faces that lose a corner by it.

    A face that collapses to an edge leaves its two neighbours matching, so a closed mesh stays
    closed; faces without area but with three corners are kept for the same reason.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    vertices, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    number = number.reshape(-1)
    pairs = KDTree(vertices).query_pairs(tolerance, output_type="ndarray")
    if len(pairs):
        links = coo_matrix(
            (np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(vertices),) * 2
        )
        count, group = connected_components(links, directed=False)
        # Each group takes its first vertex: positions of the file, never averages.
        first = np.full(count, len(vertices))
        np.minimum.at(first, group, np.arange(len(vertices)))
        vertices, number = vertices[first], group[number]
    faces = number[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    if len(faces) > _CROWDED * len(vertices):
        faces = _without_copies(faces)
    used, faces = np.unique(faces, return_inverse=True)
    return TriangleMesh(vertices[used], faces.reshape(-1, 3).astype(np.int32))


def _without_copies(faces: NDArray[np.intp]) -> NDArray[np.intp]:
    """Keep one of each set of faces with the same corners in the same cyclic order."""
    first = np.argmin(faces, axis=1)[:, None]
    turned = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return np.unique(turned, axis=0)
