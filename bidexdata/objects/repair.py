"""From triangles to one closed solid: a ladder of repairs, the cheapest that works.

Each rung hands its result to the same judges: manifold3d accepts it as closed and oriented, it has
a volume (`solids`), no part of it or of the input is far from the other (`deviation`: a lid over an
opening that was meant to be one, or a part that got lost, shows there), and its walls are not
paper. What a rung cannot do goes to the next; where none comes near enough, the nearest is taken.
Only the last rungs, which give what is still open a new surface, change where surfaces are. All
lengths are fractions of the diagonal.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bidexdata.record.status import Status
from bidexdata.wording import counted

from .closed import as_manifold, convex_hull, thinnest
from .components import components, joined, oriented, without_double_faces
from .config import RepairConfig
from .deviation import hausdorff
from .failure import PrepareFailure
from .holes import Filled, filled, is_closed
from .physics import mass_properties, surface_area, thickness
from .plates import thickened
from .prepared import TriangleMesh
from .remesh import remesh
from .solids import Closed, is_sheet, one_solid, united
from .weld import weld

_FLAT = 1e-6
"""Thickness below which a mesh of unit diagonal is a drawing in a plane."""
_INNER = 0.2
"""Share of the volume within the outer walls that inner walls enclose at least: less is a detail."""
_RIM = 0.02
"""How far inner walls may reach out of the box of the outer ones."""
_CRUMBS = 0.01
"""Share of the area in open components that may be dropped."""
_AREA_KEPT = 0.99
"""Share of the area that a loose weld must keep."""
_FEWEST = 3
"""Faces below which a component encloses nothing, lids or not: a file of loose triangles has
thousands of them."""
_CONVEX = 0.985
"""Share of its hull that a plate fills: no other surface is needed to make it thicker."""
_BETTER, _NEARLY = 0.7, 1.5
"""A dearer repair is taken only where it brings the surface so much nearer, and nearly near."""


class Repaired(NamedTuple):
    """A closed solid, the repair that made it, and warnings for the report."""

    mesh: TriangleMesh
    method: str
    """The rung: `as_is`, `orient`, `fill_holes`, `components`, `loose_weld`, `remesh`,
    `remesh_shell`, or `thicken` after any of them."""
    steps: tuple[str, ...]
    """What was done, in order; docs/sources.md lists the names."""
    warnings: tuple[str, ...]
    hausdorff: float
    """Of the mesh and the input after the weld (`deviation.hausdorff`), fraction of the diagonal."""
    thin: bool
    """Whether its walls are too thin to be taken where anything else is left."""


def repair(mesh: TriangleMesh, config: RepairConfig) -> Repaired:
    """Make one closed solid of triangles of unit diagonal.

    Raises:
        PrepareFailure: The triangles lie in a plane, or nothing closed came out.
    """
    if thinnest(mesh.vertices) < _FLAT:
        raise PrepareFailure(
            Status.NO_VOLUME, "all vertices lie in a plane: give the sheet a thickness in the file"
        )
    welded = weld(mesh, config.weld)
    if len(welded.faces) == 0:
        raise PrepareFailure(Status.NO_VOLUME, "every face is a line or a point")
    sorted_ = functools.cache(lambda: _sorted(welded, config))
    rungs: tuple[tuple[str, Callable[[], Closed | None]], ...] = (
        ("as_is", lambda: one_solid(welded, config) if is_closed(welded) else None),
        ("", lambda: _mended(welded, sorted_(), config)),
        ("loose_weld", lambda: _loosely_welded(welded, config)),
        ("", lambda: _with_remeshed_parts(welded, sorted_(), config)),
        ("", lambda: _remeshed(welded, config)),
    )
    best: Repaired | None = None
    for name, attempt in rungs:
        found = attempt()
        if found is None:
            continue
        away = hausdorff(found.mesh, welded, config.hausdorff_samples)
        thin = thickness(found.mesh) < config.thin and not _is_convex(found.mesh)
        steps = ("weld",) * _changed(mesh, welded) + found.steps
        tried = Repaired(found.mesh, name or _rung(steps), steps, found.warnings, away, thin)
        best = tried if best is None else _better(best, tried, config)
        lids = "fill_holes" in best.steps and "remesh" not in best.steps
        near = config.near_lids if lids else config.near
        if best.hausdorff <= near and not best.thin:
            break
    if best is None:
        raise _no_solid(welded, config)
    return _told(_thickened(best, welded, config), config)


def _no_solid(welded: TriangleMesh, config: RepairConfig) -> PrepareFailure:
    """Say why nothing closed came out."""
    parts = len(components(welded))
    if parts > config.max_components:
        text = f"{parts} separate parts; repair.max_components is {config.max_components}"
        return PrepareFailure(Status.TOO_COMPLEX, f"{text}: give the parts files of their own")
    return PrepareFailure(Status.NO_VOLUME, "the remeshed surface encloses nothing")


def _changed(mesh: TriangleMesh, welded: TriangleMesh) -> bool:
    counts = (len(m.vertices) + len(m.faces) for m in (mesh, welded))
    return len(set(counts)) > 1


def _better(best: Repaired, tried: Repaired, config: RepairConfig) -> Repaired:
    """The one that is near and not too thin, else the nearer one; the cheaper of equals."""
    if best.thin and not tried.thin:
        return tried if tried.hausdorff <= max(config.near, best.hausdorff) else best
    if tried.thin and not best.thin:
        return best
    # A new surface over an opening may bulge towards the input: that is nearer and no better.
    worth = tried.hausdorff <= _NEARLY * config.near
    return tried if worth and tried.hausdorff < _BETTER * best.hausdorff else best


def _is_convex(mesh: TriangleMesh) -> bool:
    hull = convex_hull(mesh.vertices).volume()
    return mass_properties(mesh).volume >= _CONVEX * hull


def _thickened(found: Repaired, welded: TriangleMesh, config: RepairConfig) -> Repaired:
    """Give a convex plate or needle a thickness that can be simulated."""
    wall = thickness(found.mesh)
    if wall >= config.thin or not _is_convex(found.mesh):
        return found
    text = f"only {wall:.2%} of the diagonal thick: made {config.plate:.2%} thick"
    mesh = thickened(found.mesh, config.plate)
    return Repaired(
        mesh,
        "thicken",
        (*found.steps, "thicken"),
        (*found.warnings, text),
        hausdorff(mesh, welded, config.hausdorff_samples),
        False,
    )


def _told(found: Repaired, config: RepairConfig) -> Repaired:
    """Add warnings of what no rung mends."""
    wall, warnings = thickness(found.mesh), found.warnings
    if wall < config.thin:
        warnings += (f"only {wall:.2%} of the diagonal thick",)
    if found.hausdorff > config.near:
        warnings += (f"the repair is up to {found.hausdorff:.1%} of the diagonal from the file",)
    return found._replace(warnings=warnings)


def _rung(steps: tuple[str, ...]) -> str:
    """The rung that steps belong to: the most expensive of them names it.

    `orient` also where components that touch had only to be told apart.
    """
    order = ("remesh_shell", "remesh", "drop_open", "fill_holes", "orient")
    names = {"drop_open": "components"}
    return next((names.get(s, s) for s in order if s in steps), "orient")


class _Sorted(NamedTuple):
    """Components that are closed, or became so, and those that are open."""

    closed: list[TriangleMesh]
    open: list[TriangleMesh]
    doubles: int
    """Faces that others had twice."""
    turned: bool
    """Whether faces were turned to be wound as their neighbours."""
    holes: int = 0
    """Holes that were closed."""
    lids: float = 0.0
    """Largest share of a component's area that its lids have."""

    @property
    def steps(self) -> tuple[str, ...]:
        done = (
            ("drop_double_faces", self.doubles),
            ("orient", self.turned),
            ("fill_holes", self.holes),
        )
        return tuple(name for name, needed in done if needed)

    @property
    def warnings(self) -> tuple[str, ...]:
        told = []
        if self.doubles:
            told.append(f"{counted(self.doubles, 'double face')} dropped")
        if self.holes:
            closed = counted(self.holes, "hole")
            told.append(f"{closed} closed, at most {self.lids:.1%} of a component's area")
        return tuple(told)


def _mended(mesh: TriangleMesh, found: _Sorted, config: RepairConfig) -> Closed | None:
    """Wind consistently, close holes; keep the closed components when the open ones are crumbs."""
    share = sum(map(surface_area, found.open)) / surface_area(mesh)
    if not found.closed or share > _CRUMBS:
        return None
    solid = _united(found.closed, config)
    if solid is None:
        return None
    steps, warnings = found.steps, found.warnings
    if found.open:
        steps += ("drop_open",)
        warnings += (f"open parts with {share:.1%} of the area dropped",)
    return Closed(solid.mesh, steps + solid.steps, warnings + solid.warnings)


def _sorted(mesh: TriangleMesh, config: RepairConfig) -> _Sorted:
    """Split into components and close what can be closed by lids.

    A lid that would be a large part of a component shows that it is an open shell or a sheet. The
    walls of a cavity that are not joined to the outer walls must not get lids of their own either:
    what lies between them is theirs to enclose.
    """
    single = without_double_faces(mesh)
    wound = oriented(single)
    parts = components(wound)
    tries = [filled(part) if len(part.faces) >= _FEWEST else None for part in parts]
    hollow = _hollow(parts, tries)
    doubles = len(mesh.faces) - len(single.faces)
    found = _Sorted([], [], doubles, not np.array_equal(wound.faces, single.faces))
    for part, lids, walls in zip(parts, tries, hollow, strict=True):
        if lids is None or walls or lids.share > config.lid_share or not _is_solid(lids.mesh):
            found.open.append(part)
            continue
        found.closed.append(lids.mesh)
        found = found._replace(holes=found.holes + lids.holes, lids=max(found.lids, lids.share))
    return found


def _is_solid(mesh: TriangleMesh) -> bool:
    return as_manifold(mesh) is not None and not is_sheet(mesh)


def _hollow(parts: list[TriangleMesh], tries: list[Filled | None]) -> list[bool]:
    """Which components with holes are the outer or inner walls of an open cavity."""
    boxes = [np.stack([p.vertices.min(axis=0), p.vertices.max(axis=0)]) for p in parts]
    holed = [k for k, t in enumerate(tries) if t is not None and t.holes]
    volume = {k: mass_properties(parts[k]).volume for k in holed}
    walls = [False] * len(parts)
    for inner in (k for k in holed if volume[k] < 0):
        for outer in (k for k in holed if 0 < volume[k] < -volume[inner] / _INNER):
            low, high = boxes[inner] - boxes[outer]
            if (low >= -_RIM).all() and (high <= _RIM).all():
                walls[inner] = walls[outer] = True
    return walls


def _united(parts: list[TriangleMesh], config: RepairConfig) -> Closed | None:
    solids = [s for s in map(as_manifold, parts) if s is not None]
    return united([p for s in solids for p in s.decompose()], config)


def _loosely_welded(mesh: TriangleMesh, config: RepairConfig) -> Closed | None:
    looser = weld(mesh, config.loose_weld)
    if len(looser.faces) == 0 or surface_area(looser) < _AREA_KEPT * surface_area(mesh):
        return None
    found = one_solid(looser, config) or _mended(looser, _sorted(looser, config), config)
    text = f"seams of up to {config.loose_weld:.2%} of the diagonal welded"
    return found and Closed(found.mesh, ("loose_weld", *found.steps), (text, *found.warnings))


def _with_remeshed_parts(mesh: TriangleMesh, found: _Sorted, config: RepairConfig) -> Closed | None:
    """Give what is open a new surface and unite it with what is closed."""
    if not found.closed or not found.open or len(found.closed) > config.max_components:
        return None
    share = sum(map(surface_area, found.open)) / surface_area(mesh)
    made = remesh(joined(found.open), config)
    solid = made and _united([*found.closed, made.mesh], config)
    text = f"the open parts, {share:.0%} of the area, have a new surface"
    return (
        made
        and solid
        and Closed(
            solid.mesh,
            (*found.steps, *made.steps, *solid.steps),
            (*found.warnings, text, *made.warnings, *solid.warnings),
        )
    )


def _remeshed(mesh: TriangleMesh, config: RepairConfig) -> Closed | None:
    """Give everything a new surface."""
    made = remesh(mesh, config)
    solid = made and one_solid(made.mesh, config)
    return (
        made
        and solid
        and Closed(solid.mesh, made.steps + solid.steps, made.warnings + solid.warnings)
    )
