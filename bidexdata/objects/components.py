"""Components of a triangle mesh: split along shared edges, wound consistently and outward."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .prepared import TriangleMesh


def without_double_faces(mesh: TriangleMesh) -> TriangleMesh:
    """Keep one of the faces that have the same three corners, whichever way they are wound."""
    corners = np.sort(mesh.faces, axis=1).astype(np.int64)
    order = np.lexsort(corners.T)  # stable: the first of equals stays first
    new = np.any(np.diff(corners[order], axis=0, prepend=-1), axis=1)
    return TriangleMesh(mesh.vertices, mesh.faces[np.sort(order[new])])


def oriented(mesh: TriangleMesh) -> TriangleMesh:
    """Wind neighbours the same way, component by component; the first face of each decides.

    A surface with one side, such as a Moebius strip, keeps a line along which they differ.
    """
    from scipy.sparse.csgraph import breadth_first_order

    pairs, same = _neighbours(mesh.faces)
    count = len(mesh.faces)
    firsts = np.unique(_labels(_symmetric(pairs, np.ones(len(pairs)), count)), return_index=True)[1]
    # One search from a root beside all first faces. 1: wound alike, 2: one has to be turned.
    ends = np.stack([np.full(len(firsts), count), firsts], axis=1)
    weights = np.concatenate([np.where(same, 1, 2), np.ones(len(firsts))])
    links = _symmetric(np.concatenate([pairs, ends]), weights, count + 1)
    order, before = breadth_first_order(links, count, directed=False)
    step = np.asarray(links[before[order[1:]], order[1:]]).reshape(-1) == 2
    turned = _carried(order, before, step)[:count]
    return TriangleMesh(
        mesh.vertices, np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces).astype(np.int32)
    )


def components(mesh: TriangleMesh) -> list[TriangleMesh]:
    """Parts that hang together by edges of exactly two faces."""
    pairs, _ = _neighbours(mesh.faces)
    label = _labels(_symmetric(pairs, np.ones(len(pairs)), len(mesh.faces)))
    order = np.argsort(label, kind="stable")
    cuts = np.flatnonzero(np.diff(label[order])) + 1
    return [compact(TriangleMesh(mesh.vertices, mesh.faces[k])) for k in np.split(order, cuts)]


def joined(parts: list[TriangleMesh]) -> TriangleMesh:
    """All triangles of several meshes as one."""
    offsets = np.cumsum([0] + [len(p.vertices) for p in parts])
    faces = [p.faces + offset for p, offset in zip(parts, offsets, strict=False)]
    return TriangleMesh(
        np.concatenate([np.zeros((0, 3)), *(p.vertices for p in parts)]),
        np.concatenate([np.zeros((0, 3), np.int32), *faces]).astype(np.int32),
    )


def compact(mesh: TriangleMesh) -> TriangleMesh:
    """Drop vertices without faces."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return TriangleMesh(mesh.vertices[used], faces.reshape(-1, 3).astype(np.int32))


def _neighbours(faces: NDArray[np.int32]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Pairs of faces (E, 2) at edges that have just two, and whether these are wound alike (E,)."""
    a = faces.astype(np.int64).reshape(-1)
    b = np.roll(faces, -1, axis=1).astype(np.int64).reshape(-1)
    key = np.minimum(a, b) * (int(faces.max(initial=0)) + 1) + np.maximum(a, b)
    order = np.argsort(key, kind="stable")
    start = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(start, append=len(key))
    first = start[count == 2]
    one, two = order[first], order[first + 1]
    return np.stack([one // 3, two // 3], axis=1), a[one] == b[two]


def _symmetric(pairs: NDArray[np.intp], weights: NDArray[np.generic], count: int) -> Any:
    from scipy.sparse import csr_matrix

    # Two faces that share two edges would add up: the first edge counts.
    key, first = np.unique(pairs.min(axis=1) * count + pairs.max(axis=1), return_index=True)
    rows, columns = key // count, key % count
    weight = np.asarray(weights, np.float64)[first]
    return csr_matrix(
        (
            np.concatenate([weight, weight]),
            (np.concatenate([rows, columns]), np.concatenate([columns, rows])),
        ),
        shape=(count, count),
    )


def _labels(links: Any) -> NDArray[np.int32]:
    from scipy.sparse.csgraph import connected_components

    return connected_components(links, directed=False)[1]


def _carried(
    order: NDArray[np.int32], before: NDArray[np.int32], step: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Parity of the turns on the way from the root to each node."""
    parity = [False] * len(before)
    ahead = before[order[1:]].tolist()
    for node, last, turn in zip(order[1:].tolist(), ahead, step.tolist(), strict=True):
        parity[node] = parity[last] ^ turn
    return np.array(parity)
