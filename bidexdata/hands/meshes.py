"""Triangles to draw a hand with, in body frames."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.hands.geometry import body_shapes
from bidexdata.hands.model import Hand


class TriangleSoup(NamedTuple):
    """Vertices (V, 3) [m] and faces (F, 3) int32, wound so that normals point out."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]


class HandMesh(NamedTuple):
    """One visual shape of a hand."""

    body: int
    """Index of the body that carries it."""
    mesh: TriangleSoup
    """In the body's frame."""
    rgba: tuple[float, float, float, float]
    """Colour of the source, 0 to 1."""


def visual_meshes(hand: Hand) -> list[HandMesh]:
    """List the shapes to draw; place each with the pose of its body (`forward_kinematics`).

    The visual geoms of the source where it has any, else its collision geoms.
    """
    found = []
    for body, shapes in enumerate(body_shapes(hand.make_spec().compile(), visual=True)):
        for shape in shapes:
            vertices = shape.vertices @ shape.R.T + shape.pos
            found.append(HandMesh(body, TriangleSoup(vertices, shape.faces), shape.rgba))
    return found
