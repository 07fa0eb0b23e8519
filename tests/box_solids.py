"""Solids whose mass, inertia and faces are known by hand, for tests of several areas."""

from __future__ import annotations

import itertools

import numpy as np

from bidexdata.objects.prepared import Solid, TriangleMesh

_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    np.int32,
)  # fmt: skip


def box_mesh(lower, upper) -> TriangleMesh:
    corners = itertools.product(*zip(lower, upper, strict=True))
    return TriangleMesh(np.array(list(corners), np.float64), _FACES)


def box_solid(sides=(1.0, 1.0, 1.0), object_id="box") -> Solid:
    """A box of one convex piece, scaled to unit diagonal, its centre at the origin."""
    sides = np.asarray(sides, np.float64)
    sides = sides / np.linalg.norm(sides)
    mesh = box_mesh(-sides / 2, sides / 2)
    volume = float(sides.prod())
    squares = sides**2
    return Solid(
        object_id=object_id,
        mesh=mesh,
        pieces=(mesh,),
        volume=volume,
        inertia=np.diag(volume / 12 * (squares.sum() - squares)),
        rest_quats_wxyz=np.array([[1.0, 0.0, 0.0, 0.0]]),
        rest_heights=np.array([sides[2] / 2]),
        rest_probabilities=np.array([1.0]),
    )


def angle_solid(object_id="angle") -> Solid:
    """Two boxes that form an L: products of inertia are not zero."""
    boxes = [((0.0, 0.0, 0.0), (1.0, 0.2, 0.3)), ((0.0, 0.2, 0.0), (0.2, 0.8, 0.3))]
    lower, upper = (np.array(b, np.float64) for b in zip(*boxes, strict=True))
    diagonal = np.linalg.norm(upper.max(axis=0) - lower.min(axis=0))
    lower, upper = lower / diagonal, upper / diagonal
    sides = upper - lower
    volumes = sides.prod(axis=1)
    centre = (volumes[:, None] * (lower + upper) / 2).sum(axis=0) / volumes.sum()
    inertia = np.zeros((3, 3))
    for side, volume, middle in zip(sides, volumes, (lower + upper) / 2 - centre, strict=True):
        own = np.diag(volume / 12 * ((side**2).sum() - side**2))
        inertia += own + volume * (middle @ middle * np.eye(3) - np.outer(middle, middle))
    pieces = tuple(
        box_mesh(low - centre, high - centre) for low, high in zip(lower, upper, strict=True)
    )
    return Solid(
        object_id=object_id,
        mesh=pieces[0],
        pieces=pieces,
        volume=float(volumes.sum()),
        inertia=inertia,
        rest_quats_wxyz=np.zeros((0, 4)),
        rest_heights=np.zeros(0),
        rest_probabilities=np.zeros(0),
    )
