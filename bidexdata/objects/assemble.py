"""From convex pieces to a prepared object: the frame, and all that is computed on the solid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.record.status import Status

from .closed import as_manifold, as_mesh, convex_hull, union
from .config import PrepareConfig
from .drops import Body
from .failure import PrepareFailure
from .physics import MassProperties, mass_properties
from .prepared import PreparedObject, TriangleMesh
from .rest import rest_poses
from .sdf import grid_warnings, signed_distance_grid
from .simulated import check_simulated
from .surface import surface_points
from .traits import descriptor

_SLIVERS = (1e-5, 1e-6)
"""Tolerances at which the needles that a union leaves are collapsed; searches are in float32."""
_VOLUME_KEPT = 1e-4
"""Share of the volume that collapsing may change. Measured on a mug of DexGraspNet, whose 27 pieces
touch with gaps of about a millionth: at 1e-5 it loses 1.6 %, at 1e-6 a share of 5e-7."""


class UnitSolid(NamedTuple):
    """Convex pieces and their union in the object frame, and how to get there."""

    pieces: tuple[TriangleMesh, ...]
    mesh: TriangleMesh
    """Surface of the union."""
    volume: float
    inertia: NDArray[np.float64]
    centre: NDArray[np.float64]
    """The object frame's origin in the frame that the pieces came in, (3,)."""
    diagonal: float
    """Length of the object frame's unit there."""


def unit_solid(pieces: Sequence[TriangleMesh]) -> UnitSolid:
    """Unite the pieces, move the centre of mass to the origin, scale the box diagonal to 1.

    Positions are rounded to float32, which files and kernels use, before anything is computed
    from them: what is read back is what was computed with.

    Raises:
        PrepareFailure: The union is empty.
    """
    whole = _united(pieces)
    centre = mass_properties(whole).centre
    diagonal = float(np.linalg.norm(np.ptp(whole.vertices, axis=0)))
    moved, mesh = _moved(pieces, centre, diagonal)
    mass = mass_properties(mesh)
    return UnitSolid(moved, mesh, mass.volume, mass.inertia, centre, diagonal)


def unit_solid_of_sum(pieces: Sequence[TriangleMesh]) -> UnitSolid:
    """Do as `unit_solid`, with the masses of the pieces added up: overlaps count twice.

    That is how a simulator weighs a body of several shapes.

    Raises:
        PrepareFailure: A piece has no volume.
    """
    hulls = [as_mesh(convex_hull(p.vertices)) for p in pieces]
    flat = [k for k, h in enumerate(hulls) if mass_properties(h).volume <= 0]
    if flat or not hulls:
        what = f"convex piece {flat[0]} of {len(hulls)} is flat" if flat else "no convex piece"
        raise PrepareFailure(Status.NO_VOLUME, what)
    centre = summed_mass(hulls).centre
    corners = np.concatenate([h.vertices for h in hulls])
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    moved, mesh = _moved(hulls, centre, diagonal)
    mass = summed_mass(moved)
    return UnitSolid(moved, mesh, mass.volume, mass.inertia, centre, diagonal)


def summed_mass(meshes: Sequence[TriangleMesh]) -> MassProperties:
    """Add up the mass properties of closed meshes; the inertia is about the common centre."""
    parts = [mass_properties(m) for m in meshes]
    volume = sum(p.volume for p in parts)
    centre = np.sum([p.volume * p.centre for p in parts], axis=0) / volume
    inertia = np.zeros((3, 3))
    for p in parts:
        r = p.centre - centre
        inertia += p.inertia + p.volume * (r @ r * np.eye(3) - np.outer(r, r))
    return MassProperties(float(volume), centre, inertia)


def assembled(
    object_id: str,
    solid: UnitSolid,
    display: TriangleMesh,
    provenance: dict[str, Any],
    config: PrepareConfig,
) -> PreparedObject:
    """Compute what the stages need of a solid.

    Args:
        object_id: Its identity.
        solid: The solid at unit diagonal.
        display: The mesh to show, in the frame that the pieces came in.
        provenance: Where it is from.
        config: Bounds and resolutions.

    Raises:
        PrepareFailure: The simulator refuses a piece.
    """
    check_simulated(solid.pieces)
    hull = as_mesh(convex_hull(solid.mesh.vertices))
    rest = rest_poses(Body(hull, solid.volume, solid.inertia), config.rest, solid.pieces)
    warnings = [*provenance.get("warnings", ())]
    if not len(rest.heights):
        warnings.append("no rest pose: it comes to rest on a table in no orientation")
    sdf = signed_distance_grid(solid.mesh, solid.pieces, config.sdf)
    warnings += grid_warnings(solid.mesh, solid.pieces, sdf, config.sdf)
    points, normals = surface_points(solid.mesh, config.surface)
    shape = [round(float(x), 6) for x in descriptor(points, solid.mesh)]
    display = _fewer_faces(display, config.repair.display_faces)
    moved = _rounded((display.vertices - solid.centre) / solid.diagonal)
    return PreparedObject(
        object_id=object_id,
        mesh=TriangleMesh(moved, display.faces),
        pieces=solid.pieces,
        volume=solid.volume,
        inertia=solid.inertia,
        rest_quats_wxyz=rest.quats_wxyz,
        rest_heights=rest.heights,
        rest_probabilities=rest.probabilities,
        provenance={**provenance, "warnings": warnings, "descriptor": shape},
        solid=solid.mesh,
        hull=hull,
        surface_points=points,
        surface_normals=normals,
        sdf=sdf,
    )


def _moved(
    pieces: Sequence[TriangleMesh], centre: NDArray[np.float64], diagonal: float
) -> tuple[tuple[TriangleMesh, ...], TriangleMesh]:
    moved = tuple(as_mesh(convex_hull(_rounded((p.vertices - centre) / diagonal))) for p in pieces)
    mesh = _united(moved)
    return moved, TriangleMesh(_rounded(mesh.vertices), mesh.faces)


def _united(pieces: Sequence[TriangleMesh]) -> TriangleMesh:
    parts = [as_manifold(p) for p in pieces]
    whole = union([p for p in parts if p is not None])
    if whole.is_empty() or whole.volume() <= 0:
        raise PrepareFailure(Status.DECOMPOSITION_FAILED, "the union of the pieces is empty")
    for tolerance in _SLIVERS:
        simple = whole.simplify(tolerance)
        if abs(simple.volume() / whole.volume() - 1) < _VOLUME_KEPT:
            return as_mesh(simple)
    return as_mesh(whole)


def _fewer_faces(mesh: TriangleMesh, most: int) -> TriangleMesh:
    """Simplify a mesh until it has at most about `most` faces."""
    tolerance = 1e-4
    while len(mesh.faces) > most and tolerance < 0.02:
        solid = as_manifold(mesh)
        if solid is None:
            break
        mesh = as_mesh(solid.simplify(tolerance))
        tolerance *= 2
    return mesh


def _rounded(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points.astype(np.float32).astype(np.float64)
