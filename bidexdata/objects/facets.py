"""Facets of a convex body: its triangles, grouped where they lie in one plane."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .prepared import TriangleMesh


class Facets(NamedTuple):
    """The facets of a convex triangle mesh."""

    of_face: NDArray[np.int32]
    """Facet of every triangle, (F,)."""
    normals: NDArray[np.float64]
    """Outward unit normal of every facet, (K, 3)."""
    offsets: NDArray[np.float64]
    """Support of the body along the normals: n . x <= offset, (K,)."""


class Adjacency(NamedTuple):
    """Pairs of triangles that share an edge."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    edges: NDArray[np.int32]
    """The shared edge as it runs in the first triangle, (E, 2)."""


def facets(body: TriangleMesh, angle: float) -> Facets:
    """Group adjacent triangles whose normals differ by less than `angle` [rad]."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    a, b, c = (body.vertices[body.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    unit = cross / np.maximum(area, 1e-300)[:, None]
    first, second, _ = adjacency(body.faces)
    # Slivers have no reliable normal: they follow any neighbour.
    sliver = area < 1e-9
    flat = np.einsum("ni,ni->n", unit[first], unit[second]) > np.cos(angle)
    flat |= sliver[first] | sliver[second]
    links = coo_matrix(
        (np.ones(int(flat.sum())), (first[flat], second[flat])), shape=(len(area), len(area))
    )
    count, of_face = connected_components(links, directed=False)
    normals = np.zeros((count, 3))
    np.add.at(normals, of_face, cross)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return Facets(of_face, normals, np.max(normals @ body.vertices.T, axis=1))


def adjacency(faces: NDArray[np.int32]) -> Adjacency:
    """List the pairs of triangles (F, 3) that share an edge."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    owner = np.repeat(np.arange(len(faces)), 3)
    key = np.sort(edges, axis=1).astype(np.int64)
    order = np.lexsort((owner, key[:, 1], key[:, 0]))
    same = np.all(key[order[1:]] == key[order[:-1]], axis=1)
    first, second = owner[order[:-1][same]], owner[order[1:][same]]
    return Adjacency(first, second, edges[order[:-1][same]])
