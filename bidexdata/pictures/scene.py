"""What a picture shows: coloured triangle parts, a camera, and the small shapes that mark things.

Everything is in the world frame, in metres. Colours are sRGB in [0, 1].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bidexdata.frames import rotation_with_z

FloatArray = NDArray[np.float64]
Colour = tuple[float, float, float]

CREASE_COSINE = float(np.cos(np.radians(40.0)))
"""Faces that meet at less than this angle are shaded as one smooth surface."""


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
    vertices: ArrayLike, faces: ArrayLike, colour: Colour, label: str, *, smooth: bool = True
) -> Part:
    """Make a part of a triangle mesh, smooth where its faces meet at a small angle."""
    v = np.asarray(vertices, np.float64).reshape(-1, 3)
    f = np.asarray(faces, np.int32).reshape(-1, 3)
    normals = corner_normals(v, f) if smooth else np.repeat(face_normals(v, f)[:, None], 3, axis=1)
    return Part(v, normals, f, colour, label)


def moved(part: Part, R: ArrayLike, p: ArrayLike) -> Part:
    """Turn a part by the rotation matrix R (3, 3), then shift it by p (3,) [m]."""
    R, p = np.asarray(R, np.float64), np.asarray(p, np.float64)
    return part._replace(vertices=part.vertices @ R.T + p, corner_normals=part.corner_normals @ R.T)


def face_normals(vertices: FloatArray, faces: NDArray[np.int32]) -> FloatArray:
    """Unit normals (F, 3); zero where a triangle has no area."""
    normals = _area_vectors(vertices, faces)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)


def corner_normals(vertices: FloatArray, faces: NDArray[np.int32]) -> FloatArray:
    """Shading normals (F, 3, 3): the vertex normal, or the face's own across a crease.

    Vertices at the same place count as one, so seams of a mesh file do not show.
    """
    if not len(faces):
        return np.zeros((0, 3, 3))
    area = _area_vectors(vertices, faces)
    _, welded = np.unique(vertices.round(7), axis=0, return_inverse=True)
    corner = welded.reshape(-1)[faces]
    summed = np.stack(
        [
            np.bincount(corner.ravel(), np.repeat(area[:, axis], 3), minlength=len(vertices))
            for axis in range(3)
        ],
        axis=1,
    )
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    unit = np.divide(summed, length, out=np.zeros_like(summed), where=length > 0)
    at_corner = unit[corner]
    own = np.repeat(face_normals(vertices, faces)[:, None], 3, axis=1)
    flat = np.einsum("fci,fci->fc", at_corner, own) < CREASE_COSINE
    return np.where(flat[..., None], own, at_corner)


def sphere(centre: ArrayLike, radius: float, colour: Colour, label: str) -> Part:
    """A ball of 320 triangles that touches the true sphere at its vertices [m]."""
    v, f = _ICOSPHERE
    at = np.asarray(centre, np.float64)
    return Part(v * radius + at, v[f], f, colour, label)


def arrow(
    start: ArrayLike, end: ArrayLike, radius: float, colour: Colour, label: str
) -> Part | None:
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


def disc(centre: ArrayLike, radius: float, colour: Colour, label: str = "ground") -> Part:
    """A flat round plate whose normal is world z [m]."""
    vertices, faces = _turned(np.array([[radius, 0.0], [0.0, 0.0]]), 64)
    return mesh_part(vertices + np.asarray(centre, np.float64), faces, colour, label, smooth=False)


def _area_vectors(vertices: FloatArray, faces: NDArray[np.int32]) -> FloatArray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


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
