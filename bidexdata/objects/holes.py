"""Holes of a surface: closed by flat lids between the edges that have a face on one side only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.physics import surface_area
from bidexdata.objects.polygons import triangulated
from bidexdata.objects.prepared import TriangleMesh


class Filled(NamedTuple):
    """A surface whose holes are closed."""

    mesh: TriangleMesh
    holes: int
    """Number of lids."""
    share: float
    """Share of the area that the lids have."""


def filled(mesh: TriangleMesh) -> Filled | None:
    """Close every hole of a consistently wound surface by a lid that uses its edges as they are.

    A crack, whose edges lie on each other, gets triangles without area: it closes too. None where
    faces are wound both ways, so that there is no telling on which side a hole is.
    """
    edges = _open_edges(mesh)
    if edges is None:
        return None
    loops = _loops(edges)
    if loops is None:
        return None
    counts = np.array([len(loop) for loop in loops], np.int64)
    corners = np.array([k for loop in loops for k in loop], np.int64)
    lids = triangulated(mesh.vertices, corners, counts).astype(np.int32)
    whole = TriangleMesh(mesh.vertices, np.concatenate([mesh.faces, lids]))
    area = surface_area(whole)
    share = surface_area(TriangleMesh(mesh.vertices, lids)) / area if area > 0 else 1.0
    return Filled(whole, len(loops), share)


def _open_edges(mesh: TriangleMesh) -> NDArray[np.int64] | None:
    """Edges (E, 2) that lids have to use, in their direction."""
    a = mesh.faces.astype(np.int64).reshape(-1)
    b = np.roll(mesh.faces, -1, axis=1).astype(np.int64).reshape(-1)
    count = len(mesh.vertices)
    key, number = np.unique(a * count + b, return_counts=True)
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
