"""PreparedObject: the one solid that every stage sees, stored at unit bounding-box diagonal.

The simulated solid is the union of the convex pieces. Surface points, signed distances, hull,
mass and rest poses are computed on it; the repaired mesh serves display only. Everything scales
in closed form: lengths with s, sdf(s x) = s sdf(x), volume with s^3, inertia with s^5.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class TriangleMesh(NamedTuple):
    """Vertices (V, 3) float64 and faces (F, 3) int32, wound so that normals point out."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class SignedDistanceGrid:
    """Samples of the signed distance (negative inside) on a regular grid, unit diagonal.

    Node (i, j, k) lies at `origin + cell * (i, j, k)`.
    """

    values: NDArray[np.float32]
    """(nx, ny, nz), unit diagonal."""
    origin: NDArray[np.float64]
    """Position of node (0, 0, 0) in the object frame, (3,)."""
    cell: float
    """Spacing of the nodes."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Solid:
    """What simulation, pictures and metrics need of an object; object frame, unit diagonal.

    The origin is the centre of mass of the solid, the axes are those of the source after y-up
    conversion, and the diagonal of the solid's axis-aligned bounding box is 1. A library and a
    release both give this.
    """

    object_id: str
    mesh: TriangleMesh
    """The repaired mesh: display and Hausdorff figure only."""
    pieces: tuple[TriangleMesh, ...]
    """Convex pieces; their union is the simulated solid."""
    volume: float
    """Volume of the solid at unit diagonal."""
    inertia: NDArray[np.float64]
    """Inertia tensor of the solid about its centre of mass at unit density and diagonal, (3, 3)."""
    rest_quats_wxyz: NDArray[np.float64]
    """Orientations in which the object rests on a table, most probable first, (K, 4)."""
    rest_heights: NDArray[np.float64]
    """Height of the object frame's origin over the table in those poses, unit diagonal, (K,)."""
    rest_probabilities: NDArray[np.float64]
    """(K,), summing to at most 1."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Source, licence, author, category, source_name, source_sha256, source_diagonal, steps of the
    repair, hausdorff (fraction of the diagonal), piece_method, warnings; `origin_in_file` and
    `unit_in_file`, x_file = origin_in_file + unit_in_file * x_object after the turn to z up."""

    @property
    def source_origin(self) -> NDArray[np.float64]:
        """Origin of the source file's frame in the object frame, unit diagonal, (3,).

        Zero where the provenance does not say.
        """
        origin = np.asarray(self.provenance.get("origin_in_file", (0.0, 0.0, 0.0)), np.float64)
        return -origin / float(self.provenance.get("unit_in_file", 1.0))

    @property
    def nominal_volume(self) -> float:
        """Volume at unit diagonal that a nominal mass of the source refers to.

        A body of nominal mass m weighs m * volume / nominal_volume here. It is the volume of the
        solid where the source names no other.
        """
        return float(self.provenance.get("nominal_volume", self.volume))

    def mass(self, size: float, density: float) -> float:
        """Mass [kg] at bounding-box diagonal `size` [m] and `density` [kg/m^3]."""
        return self.volume * size**3 * density

    def inertia_at(self, size: float, density: float) -> NDArray[np.float64]:
        """Inertia tensor [kg m^2] about the centre of mass, object frame, (3, 3)."""
        return self.inertia * size**5 * density


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PreparedObject(Solid):
    """A solid with what regions and optimisation need, all computed on the union of its pieces."""

    solid: TriangleMesh
    """Surface of the union of the pieces."""
    hull: TriangleMesh
    """Convex hull of the solid."""
    surface_points: NDArray[np.float32]
    """Points on the solid's surface in farthest-point order, (P, 3)."""
    surface_normals: NDArray[np.float32]
    """Outward unit normals at `surface_points`, (P, 3)."""
    sdf: SignedDistanceGrid

    @property
    def longest_side(self) -> float:
        """Longest side of the bounding box at unit diagonal."""
        return float(np.ptp(self.hull.vertices, axis=0).max())
