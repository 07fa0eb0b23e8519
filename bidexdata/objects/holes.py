"""Holes of a surface: closed by flat lids between the edges that have a face on one side only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .physics import surface_area
from .polygons import triangulated
from .prepared import TriangleMesh


class Filled(NamedTuple):
    """A surface whose holes are closed."""

    mesh: TriangleMesh
    holes: int
    """Number of lids."""
    share: float
    """Share of the area that the lids have."""


def filled(mesh: TriangleMesh) -> Filled | None:
    """Close every hole of a consistently wound surface by a lid that uses its edges as they are.

    The vertices of the surface stay where they are and keep their numbers.

    A crack, whose edges lie on each other, gets triangles without area: it closes too. None where
    faces are wound both ways, so that there is no telling on which side a hole is.
    """
    edges = _open_edges(mesh)
    if edges is None:
        return None
    loops = _loops(edges)
    if loops is None:
        return None
    vertices, lids = _lids(mesh, loops)
    whole = TriangleMesh(vertices, np.concatenate([mesh.faces, lids]))
    area = surface_area(whole)
    share = surface_area(TriangleMesh(vertices, lids)) / area if area > 0 else 1.0
    return Filled(whole, len(loops), share)


def is_closed(mesh: TriangleMesh) -> bool:
    """Tell whether every edge is used as often one way as the other; cheaper than any repair."""
    edges = _open_edges(mesh)
    return edges is not None and len(edges) == 0


def _lids(
    mesh: TriangleMesh, loops: list[list[int]]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices, and triangles of lids: flat ones, or fans around the middle of the loop.

    A flat lid may not use an edge that the surface has elsewhere: four faces would meet there.
    """
    counts = np.array([len(loop) for loop in loops], np.int64)
    corners = np.array([k for loop in loops for k in loop], np.int64)
    flat = triangulated(mesh.vertices, corners, counts)
    owner = np.repeat(np.arange(len(loops)), np.maximum(counts - 2, 0))
    taken = _keys(np.concatenate([mesh.faces, flat]), len(mesh.vertices))
    key, number = np.unique(taken, return_counts=True)
    twice = np.isin(taken[3 * len(mesh.faces) :], key[number > 1]).reshape(-1, 3).any(axis=1)
    pointed = np.unique(owner[twice])
    flat = flat[~np.isin(owner, pointed)]
    vertices, fans = [mesh.vertices], [flat]
    for k in pointed.tolist():
        loop = np.array(loops[k])
        middle = len(mesh.vertices) + len(vertices) - 1
        vertices.append(mesh.vertices[loop].mean(axis=0)[None])
        fans.append(np.stack([loop, np.roll(loop, -1), np.full_like(loop, middle)], axis=1))
    return np.concatenate(vertices), np.concatenate(fans).astype(np.int32)


def _keys(faces: NDArray[np.integer], count: int) -> NDArray[np.int64]:
    """A number for each directed edge of faces, (3 F,)."""
    a = faces.astype(np.int64).reshape(-1)
    return a * count + np.roll(faces, -1, axis=1).astype(np.int64).reshape(-1)


def _open_edges(mesh: TriangleMesh) -> NDArray[np.int64] | None:
    """Edges (E, 2) that lids have to use, in their direction."""
    count = len(mesh.vertices)
    key, number = np.unique(_keys(mesh.faces, count), return_counts=True)
    back = (key % count) * count + key // count
    place = np.minimum(np.searchsorted(key, back), len(key) - 1)
    surplus = number - np.where(key[place] == back, number[place], 0)
    if (surplus > 1).any():
        return None
    missing = back[surplus == 1]
    return np.stack([missing // count, missing % count], axis=1)


def _loops(edges: NDArray[np.int64]) -> list[list[int]] | None:
    """Simple loops of directed edges; None where they do not close.

    Where a loop touches itself at a vertex it is cut there into two.
    """
    following: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        following.setdefault(a, []).append(b)
    loops: list[list[int]] = []
    for start in list(following):
        while following.get(start):
            walk, place = [start], {start: 0}
            while True:
                ahead = following.get(walk[-1])
                if not ahead:
                    return None
                node = ahead.pop()
                if node in place:
                    loop = walk[place[node] :]
                    loops.append(loop)
                    for gone in loop[1:]:
                        del place[gone]
                    del walk[place[node] + 1 :]
                    if len(walk) == 1 and node == start:
                        break
                    continue
                place[node] = len(walk)
                walk.append(node)
    return loops
