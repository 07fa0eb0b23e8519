"""One solid of closed components: cavities filled, inward parts turned, specks dropped, the rest united."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.wording import counted

from .closed import as_manifold, as_mesh, union
from .config import RepairConfig
from .physics import solid_angles, thickness
from .prepared import TriangleMesh

if TYPE_CHECKING:
    from manifold3d import Manifold
    from numpy.typing import NDArray

NO_VOLUME = 1e-9
"""Volume below which a mesh of unit diagonal encloses nothing."""
_SHEET = 1e-5
"""Thickness below which a closed component is a sheet with two sides; thinnest plate seen: 3e-4."""
_SHARED = 0.08
"""Share of the volume of components that others have too, above which a warning says so: joints of
furniture stay below."""


class Closed(NamedTuple):
    """A closed, outward mesh of one solid, and what was done to it."""

    mesh: TriangleMesh
    steps: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def one_solid(mesh: TriangleMesh, config: RepairConfig) -> Closed | None:
    """Unite the components of a closed mesh; None when it is not closed or has no volume.

    Inward components are cavities where they lie inside another one, and are filled: convex
    pieces could not show them. Elsewhere they are parts that were wound the wrong way.
    """
    solid = as_manifold(mesh)
    return None if solid is None else united(solid.decompose(), config)


def united(parts: Sequence[Manifold], config: RepairConfig) -> Closed | None:
    """Unite closed parts to one solid.

    Specks have less than `min_part` of the volume and are small in every direction. A closed
    part without thickness that is not small is a sheet: it is no solid, so there is none.
    """
    if not parts or len(parts) > config.max_components:
        return None
    outer = [p for p in parts if p.volume() > 0]
    inner = [p for p in parts if p.volume() <= 0]
    cavities = [p for p in inner if p.volume() < 0 and _lies_inside(p, outer)]
    wrong = [_outward(p) for p in inner if not any(p is c for c in cavities)]
    total = sum(p.volume() for p in outer + wrong)
    if total < NO_VOLUME:
        return None
    solids, least = outer + wrong, config.min_part * total
    specks = [p.volume() < least and _size(p) < config.debris for p in solids]
    kept = [p for p, gone in zip(solids, specks, strict=True) if not gone]
    if any(2 * p.volume() < _SHEET * p.surface_area() for p in kept if p.volume() < least):
        return None
    dropped, turned = sum(specks), len(wrong) - sum(specks[len(outer) :])
    steps, warnings = [], []
    if cavities:
        steps.append("fill_cavities")
        warnings.append(f"{counted(len(cavities), 'inner cavity', 'inner cavities')} filled")
    if turned:
        steps.append("turn_outward")
        text = (
            "faces turned outward"
            if len(parts) == 1
            else f"{counted(turned, 'component')} turned outward"
        )
        warnings.append(text)
    if dropped:
        steps.append("drop_specks")
        warnings.append(f"{counted(dropped, 'speck')} dropped")
    if len(kept) > 1:
        steps.append("unite")
    whole = kept[0] if len(kept) == 1 else _without_cavities(union(kept))
    if whole.is_empty() or whole.volume() < NO_VOLUME:
        return None
    shared = 1 - whole.volume() / sum(p.volume() for p in kept)
    if shared > _SHARED:
        warnings.append(f"overlapping or nested components, {shared:.0%} of their volume, united")
    return Closed(as_mesh(whole), tuple(steps), tuple(warnings))


def winding_number(mesh: TriangleMesh, point: NDArray[np.float64]) -> float:
    """How often a surface goes around a point: 1 inside a closed outward mesh, 0 outside."""
    shifted = TriangleMesh(mesh.vertices - point, mesh.faces)
    return float(solid_angles(shifted).sum() / (4 * np.pi))


def is_sheet(mesh: TriangleMesh) -> bool:
    """Tell whether a closed mesh has no thickness."""
    return thickness(mesh) < _SHEET


def _size(part: Manifold) -> float:
    box = np.reshape(part.bounding_box(), (2, 3))
    return float(np.linalg.norm(box[1] - box[0]))


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


def _lies_inside(part: Manifold, others: list[Manifold]) -> bool:
    """Tell whether a vertex of `part` is inside one of the other closed parts."""
    point = as_mesh(part).vertices[0]
    for other in others:
        box = np.reshape(other.bounding_box(), (2, 3))
        within = np.all(point > box[0]) and np.all(point < box[1])
        if within and winding_number(as_mesh(other), point) > 0.5:
            return True
    return False
