"""What a picture shows: coloured triangle parts, a camera, and the small shapes that mark things.

Everything is in the world frame, in metres. Colours are sRGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import rotation_with_z

FloatArray = NDArray[np.float64]
Colour = tuple[float | int, float | int, float | int]
Vector = NDArray[Any] | Sequence[float | int]
"""Three numbers of a point or direction, or four of a quaternion."""

GROUND = "ground"
"""Label of what everything stands on."""
CREASE_COSINE = float(np.cos(np.radians(40.0)))
"""Faces that meet at less than this angle are shaded as one smooth surface."""


MEAN_COSINE = float(np.cos(np.radians(20.0)))
"""A corner whose face leans at most this from the mean of all faces there has no edge near."""


class Part(NamedTuple):
    """One coloured piece of a picture."""

    vertices: FloatArray
    """(V, 3) [m]."""
    corner_normals: FloatArray
    """Unit shading normal at each corner of each face, (F, 3, 3)."""
    faces: NDArray[np.int32]
    """(F, 3)."""
    colour: Colour
    label: str
    """What the part is: `object`, `left`, `right`, `contact`, `ground` ..."""


def mesh_part(
    vertices: NDArray[Any], faces: NDArray[Any], colour: Colour, label: str, *, smooth: bool = True
) -> Part:
    """Make a part of a triangle mesh, smooth where its faces meet at a small angle."""
    v = np.asarray(vertices, np.float64).reshape(-1, 3)
    f = np.asarray(faces, np.int32).reshape(-1, 3)
    normals = corner_normals(v, f) if smooth else np.repeat(face_normals(v, f)[:, None], 3, axis=1)
    return Part(v, normals, f, colour, label)


def moved(part: Part, R: NDArray[Any], p: Vector) -> Part:
    """Turn a part by the rotation matrix R (3, 3), then shift it by p (3,) [m]."""
    R, p = np.asarray(R, np.float64), np.asarray(p, np.float64)
    return part._replace(vertices=part.vertices @ R.T + p, corner_normals=part.corner_normals @ R.T)


def face_normals(vertices: FloatArray, faces: NDArray[np.int32]) -> FloatArray:
    """Unit normals (F, 3); zero where a triangle has no area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return _unit(np.asarray(np.cross(b - a, c - a), np.float64))


def corner_normals(vertices: FloatArray, faces: NDArray[np.int32]) -> FloatArray:
    """Shading normals (F, 3, 3): at each corner the mean over the faces that are smooth with it.

    Faces are weighted by their angle at the corner, so that how a side is cut into triangles does
    not show. Vertices at the same place count as one, so seams of a mesh file do not show either.
    """
    if not len(faces):
        return np.zeros((0, 3, 3))
    own = np.repeat(face_normals(vertices, faces), 3, axis=0)  # of each corner, (3 F, 3)
    weighted = _corner_angles(vertices, faces).reshape(-1, 1) * own
    _, welded = np.unique(vertices.round(7), axis=0, return_inverse=True)
    vertex = welded.reshape(-1)[faces].ravel()
    mean = _unit(_summed(vertex, weighted, len(vertices)))[vertex]
    # Where the mean over all faces leans away from a face, an edge passes: leave out what is
    # beyond it.
    creased = np.flatnonzero(np.einsum("ci,ci->c", mean, own) < MEAN_COSINE)
    around = np.argsort(vertex, kind="stable")  # corners, those of one vertex together
    degree = np.bincount(vertex, minlength=len(vertices))
    start = np.cumsum(degree) - degree
    times = degree[vertex[creased]]
    here = np.repeat(np.arange(len(creased)), times)
    step = np.arange(len(here)) - np.repeat(np.cumsum(times) - times, times)
    other = around[start[vertex[creased[here]]] + step]
    smooth = np.einsum("ci,ci->c", own[creased[here]], own[other]) >= CREASE_COSINE
    mean[creased] = _unit(_summed(here[smooth], weighted[other[smooth]], len(creased)))
    return mean.reshape(-1, 3, 3)


def sphere(centre: Vector, radius: float, colour: Colour, label: str) -> Part:
    """A ball of 320 triangles that touches the true sphere at its vertices [m]."""
    v, f = _ICOSPHERE
    at = np.asarray(centre, np.float64)
    return Part(v * radius + at, v[f], f, colour, label)


def arrow(start: Vector, end: Vector, radius: float, colour: Colour, label: str) -> Part | None:
    """A shaft with a conical head from `start` to `end` [m]; None when they coincide."""
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    length = float(np.linalg.norm(end - start))
    if length == 0:
        return None
    head = min(5 * radius, 0.6 * length)
    profile = np.array(
        [[0, 0], [radius, 0], [radius, length - head], [2.2 * radius, length - head], [0, length]]
    )
    vertices, faces = _turned(profile)
    return moved(
        mesh_part(vertices, faces, colour, label), rotation_with_z((end - start) / length), start
    )


def disc(centre: Vector, radius: float, colour: Colour, label: str = GROUND) -> Part:
    """A flat round plate whose normal is world z [m]."""
    vertices, faces = _turned(np.array([[radius, 0.0], [0.0, 0.0]]), 64)
    return mesh_part(vertices + np.asarray(centre, np.float64), faces, colour, label, smooth=False)


def _corner_angles(vertices: FloatArray, faces: NDArray[np.int32]) -> FloatArray:
    """Angle of each face at each of its corners [rad], (F, 3)."""
    p = vertices[faces]
    after = _unit(np.roll(p, -1, axis=1) - p)
    before = _unit(np.roll(p, 1, axis=1) - p)
    return np.arccos(np.clip(np.einsum("fci,fci->fc", after, before), -1, 1))


def _summed(index: NDArray[np.intp], values: FloatArray, n: int) -> FloatArray:
    """Add up the rows of `values` (m, 3) that have the same index, (n, 3)."""
    sums = [np.bincount(index, values[:, a], minlength=n) for a in range(3)]
    return np.stack(sums, axis=1).astype(np.float64)  # bincount of nothing counts in integers


def _unit(v: FloatArray) -> FloatArray:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.divide(v, length, out=np.zeros_like(v), where=length > 0)


def _turned(profile: FloatArray, n: int = 12) -> tuple[FloatArray, NDArray[np.int32]]:
    # A surface of revolution about z; each profile row is (radius, height).
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate(
        [np.column_stack([r * ring, np.full(n, z)]) for r, z in profile], axis=0
    )
    k = np.arange(n)
    after = (k + 1) % n
    faces = []
    for row in range(len(profile) - 1):
        low, high = row * n, (row + 1) * n
        faces += [
            np.stack([low + k, low + after, high + after], axis=1),
            np.stack([low + k, high + after, high + k], axis=1),
        ]
    return vertices, np.concatenate(faces).astype(np.int32)


def _icosphere(subdivisions: int) -> tuple[FloatArray, NDArray[np.int32]]:
    t = (1 + 5**0.5) / 2
    corners = np.array([[0, a, b * t] for a in (1, -1) for b in (1, -1)], np.float64)
    v = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)])
    v /= np.linalg.norm(v[0])
    edge = np.sort(np.linalg.norm(v[:, None] - v[None], axis=2).ravel())[12]
    near = np.linalg.norm(v[:, None] - v[None], axis=2) < 1.1 * edge
    f = np.array(
        [
            (i, j, k)
            for i in range(12)
            for j in range(i + 1, 12)
            for k in range(j + 1, 12)
            if near[i, j] and near[j, k] and near[i, k]
        ]
    )
    inward = (
        np.einsum(
            "fi,fi->f", np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]]), v[f[:, 0]]
        )
        < 0
    )
    f[inward] = f[inward][:, ::-1]
    for _ in range(subdivisions):
        edges = np.sort(f[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        middle = v[unique].sum(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        ab, bc, ca = (which.reshape(-1, 3) + len(v)).T
        a, b, c = f.T
        v = np.concatenate([v, middle])
        f = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    return v, f.astype(np.int32)


_ICOSPHERE = _icosphere(2)
