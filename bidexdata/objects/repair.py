"""From triangles to one closed solid: the lightest repair that works.

In order: weld; fix winding and fill small holes; keep the closed components and drop crumbs; weld
cracked seams; remesh from the winding number. Each test is whether manifold3d accepts the
result as closed and oriented with a positive volume. All lengths are fractions of the diagonal.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.objects.closed import as_manifold, as_mesh, thinnest, union
from bidexdata.objects.config import RepairConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.physics import mass_properties, surface_area
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.remesh import remesh, winding_number
from bidexdata.objects.weld import weld
from bidexdata.record.status import Status

if TYPE_CHECKING:
    from manifold3d import Manifold

_NO_VOLUME = 1e-9
"""Volume below which a mesh of unit diagonal encloses nothing."""
_FLAT = 1e-6
"""Thickness below which a mesh of unit diagonal is a drawing in a plane."""
_CRUMBS = 0.01
"""Share of the area in open components that may be dropped."""
_AREA_KEPT = 0.99
"""Share of the area that a loose weld must keep."""


class Repaired(NamedTuple):
    """A closed solid, the repair that made it, and warnings for the report."""

    mesh: TriangleMesh
    method: str
    """`as_is`, `loose_weld`, `light`, `components`, `remesh` or `remesh_shell`."""
    warnings: tuple[str, ...]
    source: TriangleMesh
    """The input after the weld, without copies of faces: what deviations are measured to."""


def repair(mesh: TriangleMesh, config: RepairConfig) -> Repaired:
    """Make one closed solid of triangles of unit diagonal.

    Raises:
        PrepareFailure: The triangles lie in a plane, or nothing closed came out.
    """
    if thinnest(mesh.vertices) < _FLAT:
        raise PrepareFailure(Status.NO_VOLUME, "all vertices lie in a plane")
    welded = weld(mesh, config.weld)
    if len(welded.faces) == 0:
        raise PrepareFailure(Status.NO_VOLUME, "every face is a line or a point")
    tries: tuple[tuple[str, Callable[[], _Closed | None]], ...] = (
        ("as_is", lambda: _one_solid(welded, config)),
        ("light", lambda: _one_solid(_light_repair(welded), config)),
        ("components", lambda: _closed_components(welded, config)),
        ("loose_weld", lambda: _loosely_welded(welded, config)),
    )
    for method, attempt in tries:
        found = attempt()
        if found:
            return Repaired(found.mesh, method, found.warnings, welded)
    made, method, warnings = remesh(welded, config)
    found = _one_solid(made, config)
    if not found:
        raise PrepareFailure(Status.NO_VOLUME, "the remeshed surface encloses nothing")
    return Repaired(found.mesh, method, warnings + found.warnings, welded)


class _Closed(NamedTuple):
    mesh: TriangleMesh
    warnings: tuple[str, ...]


def _one_solid(mesh: TriangleMesh, config: RepairConfig) -> _Closed | None:
    """Unite the components of a closed mesh; None when it is not closed or has no volume.

    Inward components are cavities where they lie inside another one, and are filled: convex
    pieces could not show them. Elsewhere they are parts that were wound the wrong way.
    """
    solid = as_manifold(mesh)
    if solid is None:
        return None
    parts = solid.decompose()
    if len(parts) == 1:
        if abs(solid.volume()) < _NO_VOLUME:
            return None
        return _Closed(as_mesh(_outward(solid)), _turned(solid))
    if len(parts) > config.max_components:
        return None
    outer = [p for p in parts if p.volume() > 0]
    inner = [p for p in parts if p.volume() < 0]
    cavities = [p for p in inner if _lies_inside(p, outer)]
    wrong = [_outward(p) for p in inner if not any(p is c for c in cavities)]
    total = sum(p.volume() for p in outer + wrong)
    if total < _NO_VOLUME:
        return None
    warnings = []
    if cavities:
        warnings.append(f"{len(cavities)} inner cavities filled")
    if wrong:
        warnings.append(f"{len(wrong)} components turned outward")
    kept = [p for p in outer + wrong if p.volume() >= config.min_part * total]
    if len(kept) < len(outer) + len(wrong):
        warnings.append(f"{len(outer) + len(wrong) - len(kept)} specks dropped")
    whole = union(kept)
    if whole.is_empty() or whole.volume() < _NO_VOLUME:
        return None
    return _Closed(as_mesh(_without_cavities(whole)), tuple(warnings))


def _without_cavities(solid: Manifold) -> Manifold:
    """Drop the inner surfaces that a union of overlapping walls leaves."""
    parts = solid.decompose()
    outer = [p for p in parts if p.volume() > 0]
    return solid if len(outer) == len(parts) else union(outer)


def _outward(solid: Manifold) -> Manifold:
    if solid.volume() >= 0:
        return solid
    mesh = as_mesh(solid)
    turned = as_manifold(TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]))
    assert turned is not None, "a closed mesh stays closed when it is turned inside out"
    return turned


def _turned(solid: Manifold) -> tuple[str, ...]:
    return ("faces turned outward",) if solid.volume() < 0 else ()


def _lies_inside(part: Manifold, others: list[Manifold]) -> bool:
    """Tell whether a vertex of `part` is inside one of the other closed parts."""
    point = as_mesh(part).vertices[0]
    for other in others:
        box = np.reshape(other.bounding_box(), (2, 3))
        within = np.all(point > box[0]) and np.all(point < box[1])
        if within and winding_number(as_mesh(other), point) > 0.5:
            return True
    return False


def _loosely_welded(mesh: TriangleMesh, config: RepairConfig) -> _Closed | None:
    looser = weld(mesh, config.loose_weld)
    if len(looser.faces) == 0 or surface_area(looser) < _AREA_KEPT * surface_area(mesh):
        return None
    return _one_solid(looser, config)


def _light_repair(mesh: TriangleMesh) -> TriangleMesh:
    """Drop double faces, make the winding of each component consistent, close small holes."""
    import trimesh

    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    made.update_faces(made.unique_faces())
    trimesh.repair.fill_holes(made)
    trimesh.repair.fix_normals(made, multibody=True)
    return TriangleMesh(np.asarray(made.vertices), np.asarray(made.faces, np.int32))


def _closed_components(mesh: TriangleMesh, config: RepairConfig) -> _Closed | None:
    """Keep the closed components when the open ones are crumbs."""
    import trimesh

    light = _light_repair(mesh)
    whole = trimesh.Trimesh(light.vertices, light.faces, process=False)
    labels = trimesh.graph.connected_component_labels(
        whole.face_adjacency, node_count=len(light.faces)
    )
    count = int(labels.max()) + 1
    if count > config.max_components:
        return None
    closed, dropped = [], 0.0
    total = surface_area(light)
    for k in range(count):
        part = TriangleMesh(light.vertices, light.faces[labels == k])
        used, faces = np.unique(part.faces, return_inverse=True)
        part = TriangleMesh(part.vertices[used], faces.reshape(-1, 3).astype(np.int32))
        if as_manifold(part) is not None and mass_properties(part).volume > _NO_VOLUME:
            closed.append(part)
            continue
        dropped += surface_area(part)
        if dropped > _CRUMBS * total:
            return None
    found = _one_solid(_joined(closed), config) if closed else None
    if not found:
        return None
    share = f"open parts with {dropped / total:.1%} of the area dropped"
    return _Closed(found.mesh, (*found.warnings, share))


def _joined(parts: list[TriangleMesh]) -> TriangleMesh:
    offsets = np.cumsum([0] + [len(p.vertices) for p in parts])
    faces = [p.faces + offset for p, offset in zip(parts, offsets, strict=False)]
    return TriangleMesh(
        np.concatenate([p.vertices for p in parts]), np.concatenate(faces).astype(np.int32)
    )
