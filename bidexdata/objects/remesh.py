"""A closed surface around triangles that are not closed, from their winding number.

The winding number says for every point how often the surface goes around it; where it exceeds one
half is inside, holes and overlaps notwithstanding. Walls that enclose nothing, or are thinner than
a grid cell, get lost; those parts of the surface, and only those, are given a thickness.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.devices import start_warp

from .closed import as_manifold, as_mesh, union
from .config import RepairConfig
from .mesh_queries import distances, winding_distances
from .physics import face_areas, mass_properties
from .prepared import TriangleMesh
from .weld import weld

_MANY = 200_000
"""Faces above which a mesh is thinned out to what its finest grid can tell apart."""
_SAMPLES = 40_000
"""Triangles that are asked whether they are lost: the largest, and one of each face."""
_PADDING = 3
"""Empty cells around the mesh, so that the level set closes."""


class Remeshed(NamedTuple):
    """A closed surface around triangles."""

    mesh: TriangleMesh
    steps: tuple[str, ...]
    """`remesh`, and `remesh_shell` where something was given a thickness."""
    warnings: tuple[str, ...]


def remesh(mesh: TriangleMesh, config: RepairConfig) -> Remeshed | None:
    """Put a closed surface around triangles; None where nothing comes out.

    Walls that the grid cannot hold would be lost or become lace. A finer grid is taken where it
    keeps at least half of what the coarse one loses; what is lost all the same encloses nothing,
    and is given a thickness.
    """
    size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    if len(mesh.faces) > _MANY:
        mesh = _clustered(mesh, size / config.fine_cells / 2)
    grid = _Grid.around(mesh, size / config.remesh_cells)
    lost = _lost(mesh, grid, config)
    if lost.share > config.lost_share and not lost.open_shell:
        finer = _Grid.around(mesh, size / config.fine_cells)
        fewer = _lost(mesh, finer, config)
        if fewer.share < 0.5 * lost.share and not fewer.open_shell:
            grid, lost = finer, fewer
    steps: tuple[str, ...] = ("remesh",)
    warnings = (f"remeshed with cells of {grid.cell:.4f} of the diagonal",)
    solid = lost.solid
    if lost.share > config.lost_share:
        half = config.shell_cells * grid.cell
        _, away = distances(lost.sheet, grid.points)
        thick = away.reshape(grid.nodes) - half
        field = thick if lost.open_shell else np.minimum(grid.field, thick)
        solid = _level_set(field, grid.low, grid.cell)
        steps += ("remesh_shell",)
        warnings += (
            f"{lost.share:.0%} of the surface enclosed no volume at this resolution and was made "
            f"{2 * half:.3f} of the diagonal thick",
        )
    simple = _simplified(solid, config.simplify_cells * grid.cell)
    return simple and Remeshed(simple, steps, warnings)


def _clustered(mesh: TriangleMesh, cell: float) -> TriangleMesh:
    """Make one vertex of those in each cell of a grid, and drop the faces that collapse."""
    key = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / cell).astype(np.int64)
    side = key.max(axis=0) + 1
    _, first, number = np.unique(
        np.ravel_multi_index(tuple(key.T), tuple(side)), return_index=True, return_inverse=True
    )
    faces = number.reshape(-1)[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    return TriangleMesh(mesh.vertices[first], faces.astype(np.int32))


class _Grid(NamedTuple):
    """Signed distances to triangles on a regular grid, the sign from the winding number."""

    field: NDArray[np.float32]
    """(nx, ny, nz)."""
    points: NDArray[np.float64]
    """Positions of the nodes, (nx * ny * nz, 3)."""
    low: NDArray[np.float64]
    """Position of the first node."""
    cell: float

    @property
    def nodes(self) -> tuple[int, ...]:
        return self.field.shape

    @classmethod
    def around(cls, mesh: TriangleMesh, cell: float) -> _Grid:
        low = mesh.vertices.min(axis=0) - _PADDING * cell
        nodes = np.ceil(np.ptp(mesh.vertices, axis=0) / cell).astype(int) + 2 * _PADDING + 1
        steps = np.stack(np.meshgrid(*map(np.arange, nodes), indexing="ij"), axis=-1)
        points = (low + cell * steps).reshape(-1, 3)
        return cls(winding_distances(mesh, points).reshape(nodes), points, low, cell)


class _Lost(NamedTuple):
    """What of a surface the level set of its grid does not have."""

    solid: TriangleMesh
    """The level set."""
    sheet: TriangleMesh
    """The lost triangles."""
    share: float
    """Their share of the area."""
    open_shell: bool
    """Whether the level set fills an open shell up to its rim; all of it counts as lost then."""


def _lost(mesh: TriangleMesh, grid: _Grid, config: RepairConfig) -> _Lost:
    solid = _level_set(grid.field, grid.low, grid.cell)
    fine, parent = _subdivided(mesh, 2 * grid.cell)
    if _lid_share(solid, mesh, 2 * grid.cell) > config.lid_share:
        return _Lost(solid, fine, 1.0, True)
    area = face_areas(fine)
    order = np.argsort(-area, kind="stable")
    one_of_each = order[np.unique(parent[order], return_index=True)[1]]
    asked = np.union1d(order[:_SAMPLES], one_of_each)
    found = _lost_faces(mesh, fine._replace(faces=fine.faces[asked]), config.lost_cells * grid.cell)
    # Spikes have slivers by the hundred thousand: those go with the larger parts of their face.
    weight = np.where(found, area[asked], -area[asked])
    lost = np.bincount(parent[asked], weight, len(mesh.faces))[parent] > 0
    lost[asked] = found
    share = float(area[lost].sum() / area.sum())
    return _Lost(solid, TriangleMesh(fine.vertices, fine.faces[lost]), share, False)


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
    area = face_areas(solid)
    _, away = distances(mesh, solid.vertices[solid.faces].mean(axis=1))
    return float(area[away > limit].sum() / area.sum())


def _lost_faces(mesh: TriangleMesh, fine: TriangleMesh, depth: float) -> NDArray[np.bool_]:
    """Faces of a subdivision on neither side of which the inside of the mesh is `depth` deep.

    Sheets have no inside, and that of walls thinner than the grid is a matter of where its nodes
    happen to lie: what is left of them is lace.
    """
    corners = fine.vertices[fine.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    step = depth * np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    middle = corners.mean(axis=1)
    sides = winding_distances(mesh, np.concatenate([middle - step, middle + step]))
    inner, outer = np.split(sides, 2)
    return (inner > 0) & (outer > 0)


def _subdivided(mesh: TriangleMesh, longest: float) -> tuple[TriangleMesh, NDArray[np.int64]]:
    """Split faces until no edge is longer than `longest`; also which face each part is of."""
    import trimesh

    split: Any = trimesh.remesh.subdivide_to_size(
        mesh.vertices, mesh.faces, max_edge=longest, max_iter=20, return_index=True
    )
    fine = TriangleMesh(np.asarray(split[0], np.float64), np.asarray(split[1], np.int32))
    return fine, np.asarray(split[2], np.int64)


def _simplified(mesh: TriangleMesh, tolerance: float) -> TriangleMesh | None:
    """Simplify, and drop what lies inside another part or is wound inward."""
    solid = as_manifold(mesh)
    outer = [p for p in solid.decompose() if p.volume() > 0] if solid else []
    return as_mesh(union(outer).simplify(tolerance)) if outer else None
