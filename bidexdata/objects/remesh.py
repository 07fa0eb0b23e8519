"""A closed surface around triangles that are not closed, from their winding number.

The winding number says for every point how often the surface goes around it; where it exceeds one
half is inside, holes and overlaps notwithstanding. Walls that enclose nothing, or are thinner than
a grid cell, get lost; those parts of the surface, and only those, are given a thickness.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.devices import start_warp
from bidexdata.objects.closed import as_manifold, as_mesh, union
from bidexdata.objects.config import RepairConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.mesh_queries import distances, winding_distances
from bidexdata.objects.physics import mass_properties, solid_angles
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.weld import weld
from bidexdata.record.status import Status

_PADDING = 3
"""Empty cells around the mesh, so that the level set closes."""
_LOST_SHARE = 0.005
"""Share of the area that may be lost before sheets are thickened."""


def remesh(mesh: TriangleMesh, config: RepairConfig) -> tuple[TriangleMesh, str, tuple[str, ...]]:
    """Return a closed surface around a mesh of unit diagonal, the method and warnings."""
    cell = 1.0 / config.remesh_cells
    low = mesh.vertices.min(axis=0) - _PADDING * cell
    nodes = np.ceil(np.ptp(mesh.vertices, axis=0) / cell).astype(int) + 2 * _PADDING + 1
    grid = low + cell * np.stack(np.meshgrid(*map(np.arange, nodes), indexing="ij"), axis=-1)
    points = grid.reshape(-1, 3)
    field = winding_distances(mesh, points).reshape(nodes)
    solid = _level_set(field, low, cell)

    fine = _subdivided(mesh, 2 * cell)
    if _lid_share(solid, mesh, 2 * cell) > config.lid_share:
        # An open shell: its winding number would fill it up to its rim.
        field = np.full_like(field, np.inf)
        lost = np.ones(len(fine.faces), bool)
    else:
        lost = _lost_faces(fine, solid, field, low, cell, config.lost_cells * cell)
    area = _areas(fine)
    share = float(area[lost].sum() / area.sum())
    method, warnings = "remesh", (f"remeshed at 1/{config.remesh_cells} of the diagonal",)
    if share > _LOST_SHARE:
        sheet = TriangleMesh(fine.vertices, fine.faces[lost])
        half = config.shell_cells * cell
        _, away = distances(sheet, points)
        solid = _level_set(np.minimum(field, away.reshape(nodes) - half), low, cell)
        method = "remesh_shell"
        warnings += (
            f"{share:.0%} of the surface enclosed no volume at this resolution and was made "
            f"{2 * half:.3f} of the diagonal thick",
        )
    if len(solid.faces) == 0:
        raise PrepareFailure(Status.NO_VOLUME, "the remeshed surface is empty")
    return _simplified(solid, config.simplify_cells * cell), method, warnings


def winding_number(mesh: TriangleMesh, point: NDArray[np.float64]) -> float:
    """How often a surface goes around a point: 1 inside a closed outward mesh, 0 outside."""
    shifted = TriangleMesh(mesh.vertices - point, mesh.faces)
    return float(solid_angles(shifted).sum() / (4 * np.pi))


def _level_set(field: NDArray[np.float32], low: NDArray[np.float64], cell: float) -> TriangleMesh:
    """Surface where the field is zero, faces towards positive values."""
    import warp as wp
    from warp.geometry import IsoSurfaceMarchingCubes

    start_warp()
    if not (field < 0).any():
        return TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    # A node exactly on the surface would give triangles without area.
    field = np.where(np.abs(field) < 1e-4 * cell, np.float32(1e-4 * cell), field)
    grid: Any = wp.array(np.ascontiguousarray(field, np.float32), dtype=wp.float32, device="cpu")
    vertices, indices = IsoSurfaceMarchingCubes.extract(grid)
    faces = np.asarray(indices.numpy(), np.int32).reshape(-1, 3)
    mesh = TriangleMesh(low + cell * np.asarray(vertices.numpy(), np.float64), faces)
    mesh = weld(mesh, 1e-6 * cell)
    if mass_properties(mesh).volume < 0:
        mesh = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])
    return mesh


def _lid_share(solid: TriangleMesh, mesh: TriangleMesh, limit: float) -> float:
    """Share of the remeshed area that is farther than `limit` from the mesh: lids over holes."""
    if len(solid.faces) == 0:
        return 0.0
    area = _areas(solid)
    _, away = distances(mesh, solid.vertices[solid.faces].mean(axis=1))
    return float(area[away > limit].sum() / area.sum())


def _lost_faces(
    fine: TriangleMesh,
    solid: TriangleMesh,
    field: NDArray[np.float32],
    low: NDArray[np.float64],
    cell: float,
    limit: float,
) -> NDArray[np.bool_]:
    """Faces farther than `limit` from the level set that do not lie inside it."""
    middle = fine.vertices[fine.faces].mean(axis=1)
    node = np.rint((middle - low) / cell).astype(int)
    outside = field[tuple(node.T)] > 0
    if len(solid.faces) == 0:
        return outside
    _, away = distances(solid, middle)
    return outside & (away > limit)


def _subdivided(mesh: TriangleMesh, longest: float) -> TriangleMesh:
    """Split faces until no edge is longer than `longest`."""
    import trimesh

    split = trimesh.remesh.subdivide_to_size(
        mesh.vertices, mesh.faces, max_edge=longest, max_iter=20
    )
    return TriangleMesh(np.asarray(split[0], np.float64), np.asarray(split[1], np.int32))


def _areas(mesh: TriangleMesh) -> NDArray[np.float64]:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def _simplified(mesh: TriangleMesh, tolerance: float) -> TriangleMesh:
    """Simplify, and drop what lies inside another part or is wound inward."""
    solid = as_manifold(mesh)
    if solid is None:
        raise PrepareFailure(Status.NO_VOLUME, "the remeshed surface is not closed")
    outer = [p for p in solid.decompose() if p.volume() > 0]
    if not outer:
        raise PrepareFailure(Status.NO_VOLUME, "the remeshed surface encloses nothing")
    return as_mesh(union(outer).simplify(tolerance))
