"""Prepared objects whose surface, hull and distances are known in closed form; read only."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np

from bidexdata.objects.prepared import PreparedObject, SignedDistanceGrid, TriangleMesh
from bidexdata.objects.surface import farthest_point_order

_CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    np.int32,
)  # fmt: skip


@cache
def box_object(sides=(1.0, 0.8, 0.6), points=2500, seed=0) -> PreparedObject:
    """A box at unit diagonal with its centre at the origin."""
    sides = np.array(sides) / np.linalg.norm(sides)
    rng = np.random.default_rng(seed)
    areas = np.array([sides[(a + 1) % 3] * sides[(a + 2) % 3] for a in range(3)])
    axis = rng.choice(3, 2 * points, p=areas / areas.sum())
    sign = rng.choice([-1.0, 1.0], 2 * points)
    at = sides * (rng.random((2 * points, 3)) - 0.5)
    row = np.arange(2 * points)
    at[row, axis] = sign * sides[axis] / 2
    normals = np.zeros((2 * points, 3))
    normals[row, axis] = sign

    def distance(x):
        beyond = np.abs(x) - sides / 2
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        return outside + np.minimum(beyond.max(axis=-1), 0.0)

    return _made(TriangleMesh(_CORNERS * sides, _FACES), at, normals, points, distance)


@cache
def ball_object(points=2500, seed=0) -> PreparedObject:
    """A ball whose bounding box has unit diagonal; its hull is the hull of the points."""
    from scipy.spatial import ConvexHull

    rng = np.random.default_rng(seed)
    radius = 0.5 / np.sqrt(3)
    normals = rng.standard_normal((2 * points, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    hull = ConvexHull(radius * normals[:500])
    faces = hull.simplices.astype(np.int32)
    inward = np.einsum("ij,ij->i", hull.equations[:, :3], _face_normals(hull.points, faces)) < 0
    faces[inward] = faces[inward][:, ::-1]
    mesh = TriangleMesh(hull.points, faces)
    return _made(
        mesh, radius * normals, normals, points, lambda x: np.linalg.norm(x, axis=-1) - radius
    )


def _face_normals(vertices, faces):
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.cross(b - a, c - a)


def _made(mesh, at, normals, points, distance) -> PreparedObject:
    order = farthest_point_order(at.astype(np.float32))[:points]
    cell = 1.2 / 48
    axes = -0.6 + cell * np.arange(49)
    nodes = np.stack(np.meshgrid(axes, axes, axes, indexing="ij"), axis=-1)
    return PreparedObject(
        object_id="made-00000000",
        mesh=mesh,
        pieces=(mesh,),
        volume=0.1,
        inertia=np.eye(3) * 0.01,
        rest_quats_wxyz=np.array([[1.0, 0.0, 0.0, 0.0]]),
        rest_heights=np.array([-mesh.vertices[:, 2].min()]),
        rest_probabilities=np.array([1.0]),
        solid=mesh,
        hull=mesh,
        surface_points=at[order].astype(np.float32),
        surface_normals=normals[order].astype(np.float32),
        sdf=SignedDistanceGrid(distance(nodes).astype(np.float32), np.full(3, -0.6), cell),
    )
