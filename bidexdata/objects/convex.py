"""Convex pieces of a closed solid.

A solid that fills its hull is one piece. Everything else goes to CoACD under a limit of CPU
seconds, more finely where its pieces bridge gaps; else to a cheaper second try, and at last it
becomes its hull, which the method's name says. Whether two runs agree can depend on the CPU limits
only, and that is recorded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.record.status import Status

from .closed import as_manifold, as_mesh, convex_hull, thinnest, union
from .coacd_process import run_coacd
from .config import ConvexConfig
from .cuts import overlap_cuts
from .failure import PrepareFailure
from .physics import mass_properties
from .prepared import TriangleMesh
from .trimmed import trimmed

if TYPE_CHECKING:
    from manifold3d import Manifold

_FLAT = 1e-5
"""Pieces thinner than this (unit diagonal) have no volume that a simulator accepts."""
_COARSEST = 0.008
"""Largest tolerance of the simplification before the search."""
_FINEST, _ROUGHEST = 1e-5, 0.1
"""Between these lies the tolerance that leaves few enough vertices (unit diagonal)."""
_BISECTIONS = 10
"""Steps of that search: the tolerance to within 1 %."""
_FINER = "coacd_finer"
"""Method of pieces that a lower threshold than the first made."""


class Decomposition(NamedTuple):
    """Convex pieces, how they were found, and warnings for the report."""

    pieces: tuple[TriangleMesh, ...]
    method: str
    """`convex`, `coacd`, `coacd_turned`, `coacd_finer`, `coacd_second` or at last `hull`."""
    warnings: tuple[str, ...]


def decompose(mesh: TriangleMesh, config: ConvexConfig) -> Decomposition:
    """Split a closed solid of about unit diagonal into convex pieces.

    Raises:
        PrepareFailure: Not even the hull has a volume.
    """
    solid = as_manifold(mesh)
    if solid is None:
        raise PrepareFailure(Status.NO_VOLUME, "the repaired mesh is not closed")
    hull = convex_hull(mesh.vertices)
    if hull.is_empty() or thinnest(mesh.vertices) < _FLAT:
        raise PrepareFailure(Status.NO_VOLUME, "all vertices lie in a plane")
    if solid.volume() >= config.convex_ratio * hull.volume():
        return Decomposition((_few_vertices(hull, config),), "convex", ())

    simple = simplified(solid, config)
    thin = solid.volume() / solid.surface_area() < config.thin_ratio
    warnings: list[str] = []
    out_of_time = False
    for attempt in _attempts(config, thin):
        if attempt.after_death and out_of_time:
            continue
        found = run_coacd(simple, attempt.options, attempt.cpu_seconds)
        pieces = _solid_pieces(found.pieces, mesh, config)
        if pieces:
            method = attempt.method
            if not out_of_time:
                pieces, method, doubts = _finer(pieces, simple, mesh, attempt, config)
                warnings += doubts
            return Decomposition(pieces, method, tuple(warnings))
        out_of_time = out_of_time or found.out_of_time
        warnings.append(f"{attempt.method} {found.reason or 'gave no piece with a volume'}")
    warnings.append("replaced by its hull")
    return Decomposition((_few_vertices(hull, config),), "hull", tuple(warnings))


class _Attempt(NamedTuple):
    """One search: what it is called, what CoACD is told, how long it may take."""

    method: str
    options: dict[str, Any]
    cpu_seconds: int
    after_death: bool = False


def _attempts(config: ConvexConfig, thin: bool) -> tuple[_Attempt, ...]:
    """The searches in order.

    CoACD dies on some meshes whose faces lie in its cutting planes (an extruded L does it):
    turned to its principal axes the same mesh passes.
    """
    first = {
        "threshold": config.thin_threshold if thin else config.threshold,
        "max_convex_hull": config.max_pieces,
        "preprocess_mode": "off",
        "resolution": config.resolution,
        "mcts_nodes": config.mcts_nodes,
        "mcts_iterations": config.mcts_iterations,
        "mcts_max_depth": config.mcts_max_depth,
        # Its decimation makes pieces smaller than their part; ours keeps their volume.
        "decimate": False,
        "seed": 0,
    }
    cheaper = {
        **first,
        "threshold": config.second_threshold,
        "max_convex_hull": config.second_max_pieces,
    }
    return (
        _Attempt("coacd", first, config.cpu_seconds),
        _Attempt("coacd_turned", {**first, "pca": True}, config.cpu_seconds, after_death=True),
        _Attempt("coacd_second", cheaper, config.second_cpu_seconds),
    )


def _finer(
    pieces: tuple[TriangleMesh, ...],
    simple: TriangleMesh,
    mesh: TriangleMesh,
    attempt: _Attempt,
    config: ConvexConfig,
) -> Decomposition:
    """Search on with a lower threshold while pieces bridge gaps and more of them are allowed.

    Returns:
        The pieces whose union is nearest to the mesh in volume, the method that found them, and a
        warning where a search gave none.
    """
    warnings: tuple[str, ...] = ()
    whole = abs(mass_properties(mesh).volume)
    best, method, ratio = pieces, attempt.method, _volume(pieces) / whole
    latest, threshold, seconds = pieces, attempt.options["threshold"], config.finer_cpu_seconds
    while ratio > config.finer_above and len(latest) < config.max_pieces:
        threshold *= config.finer_factor
        if threshold < config.finest_threshold:
            break
        found = run_coacd(simple, {**attempt.options, "threshold": threshold}, seconds)
        latest = _solid_pieces(found.pieces, mesh, config)
        if not latest:
            warnings = (f"{_FINER} {found.reason or 'gave no piece with a volume'}",)
            break
        now = _volume(latest) / whole
        if abs(now - 1) < abs(ratio - 1):
            best, method, ratio = latest, _FINER, now
    return Decomposition(best, method, warnings)


def _volume(pieces: tuple[TriangleMesh, ...]) -> float:
    """Of the union of convex pieces."""
    return union([convex_hull(piece.vertices) for piece in pieces]).volume()


def simplified(solid: Manifold, config: ConvexConfig) -> TriangleMesh:
    """Collapse edges under the tolerance, and further while there are too many faces."""
    tolerance = config.simplify
    simple = solid.simplify(tolerance)
    while simple.num_tri() > config.max_faces and tolerance < _COARSEST:
        tolerance *= 1.4
        simple = solid.simplify(tolerance)
    return as_mesh(simple)


def _solid_pieces(
    raw: list[NDArray[np.float64]], mesh: TriangleMesh, config: ConvexConfig
) -> tuple[TriangleMesh, ...]:
    """Hull every raw piece, drop those too small for a simulator, close the cracks between, trim."""
    hulls = [convex_hull(v) for v in raw if len(v) >= 4 and np.all(np.isfinite(v))]
    hulls = [h for h in hulls if not h.is_empty() and h.volume() > 0]
    total = sum(h.volume() for h in hulls)
    kept = [as_mesh(h) for h in hulls if h.volume() >= config.min_volume * total]
    kept = [piece for piece in kept if thinnest(piece.vertices) > _FLAT]
    whole = overlap_cuts(kept, mesh, config.overlap) if len(kept) > 1 else kept
    few = [_few_vertices(convex_hull(piece.vertices), config) for piece in whole]
    less = [piece for piece in trimmed(few) if thinnest(piece.vertices) > _FLAT]
    return tuple(_few_vertices(convex_hull(piece.vertices), config) for piece in less)


def _few_vertices(hull: Manifold, config: ConvexConfig) -> TriangleMesh:
    """Bound the vertices of a convex body and keep its volume.

    Two ways, the one that keeps more: edges collapsed under the smallest tolerance that leaves
    few enough (best for flat sides), and vertices far from each other (best for round bodies,
    where equal edges collapse all at once). Then the body is blown up about its centre to the
    volume that it had.
    """
    if hull.num_vert() <= config.max_vertices:
        return as_mesh(hull)
    candidates = [_collapsed(hull, config.max_vertices), _spread(hull, config.max_vertices)]
    fewer = max(candidates, key=lambda body: body.volume())
    if fewer.is_empty():
        raise PrepareFailure(Status.DECOMPOSITION_FAILED, "a piece has too many vertices")
    mesh = as_mesh(fewer)
    centre = mass_properties(mesh).centre
    grow = (hull.volume() / fewer.volume()) ** (1 / 3)
    return TriangleMesh(centre + grow * (mesh.vertices - centre), mesh.faces)


def _collapsed(hull: Manifold, most: int) -> Manifold:
    """Collapse edges under a tolerance found by bisection of its logarithm."""
    low, high = _FINEST, _ROUGHEST
    best = hull.__class__()
    for _ in range(_BISECTIONS):
        tolerance = (low * high) ** 0.5
        body = convex_hull(as_mesh(hull.simplify(tolerance)).vertices)
        if body.num_vert() > most:
            low = tolerance
        else:
            high = tolerance
            best = body if body.volume() > best.volume() else best
    return best


def _spread(hull: Manifold, most: int) -> Manifold:
    """Keep the extremes along the axes, then one by one the vertex farthest from those kept."""
    vertices = as_mesh(hull).vertices
    kept = list(np.unique(np.concatenate([vertices.argmin(axis=0), vertices.argmax(axis=0)])))
    nearest = np.linalg.norm(vertices[:, None] - vertices[None, kept], axis=2).min(axis=1)
    while len(kept) < most:
        kept.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(vertices - vertices[kept[-1]], axis=1))
    return convex_hull(vertices[kept])
