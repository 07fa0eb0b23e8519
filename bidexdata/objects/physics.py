"""Mass properties of closed triangle meshes, and the solid angles of their faces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .prepared import TriangleMesh


class MassProperties(NamedTuple):
    """Volume, centre of mass (3,) and inertia (3, 3) about it at unit density."""

    volume: float
    centre: NDArray[np.float64]
    inertia: NDArray[np.float64]


def mass_properties(mesh: TriangleMesh) -> MassProperties:
    """Integrate volume, centre of mass and inertia of a closed mesh, exactly for its triangles.

    Each face spans a tetrahedron with the origin whose moments are known in closed form; signed
    sums over the surface leave the moments of the inside. Inward faces give a negative volume.
    """
    # Moments about a point near the mesh: far from the origin the signed sums cancel badly.
    shift = mesh.vertices.mean(axis=0) if len(mesh.vertices) else np.zeros(3)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] - shift for k in range(3))
    det = np.einsum("ni,ni->n", a, np.cross(b, c))
    volume = float(det.sum() / 6)
    if volume == 0:
        return MassProperties(0.0, shift, np.zeros((3, 3)))
    corners = a + b + c
    centre = (det[:, None] * corners).sum(axis=0) / 24 / volume
    second = np.einsum("n,ni,nj->ij", det, corners, corners)
    for corner in (a, b, c):
        second += np.einsum("n,ni,nj->ij", det, corner, corner)
    second = second / 120 - volume * np.outer(centre, centre)
    inertia = np.trace(second) * np.eye(3) - (second + second.T) / 2
    return MassProperties(volume, centre + shift, inertia)


def face_areas(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Area of every face, (F,)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def surface_area(mesh: TriangleMesh) -> float:
    """Sum of the areas of all faces."""
    return float(face_areas(mesh).sum())


def thickness(mesh: TriangleMesh) -> float:
    """Mean thickness of the walls of a closed mesh: twice its volume over its area."""
    return 2 * abs(mass_properties(mesh).volume) / surface_area(mesh)


def solid_angles(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Solid angle [sr] of every face seen from the origin (Van Oosterom and Strackee, 1983)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    det = np.einsum("ni,ni->n", a, np.cross(b, c))
    dot = np.einsum
    below = la * lb * lc + dot("ni,ni->n", a, b) * lc
    below = below + dot("ni,ni->n", b, c) * la + dot("ni,ni->n", c, a) * lb
    return 2 * np.arctan2(det, below)
