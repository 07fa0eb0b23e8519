"""Convex pieces of a closed solid.

A solid that fills its hull is one piece. Everything else goes to CoACD in a child process with a
limit of CPU seconds, then to a cheaper second try, and at last it becomes its hull, which the
method's name says. Whether two runs agree can depend on the CPU limit only, and that is recorded.
"""

from __future__ import annotations

import io
import json
import logging
import os
import subprocess
import sys
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.closed import as_manifold, as_mesh, convex_hull, thinnest
from bidexdata.objects.config import ConvexConfig
from bidexdata.objects.cuts import overlap_cuts
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.physics import mass_properties
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.record.status import Status

if TYPE_CHECKING:
    from manifold3d import Manifold

_log = logging.getLogger(__name__)

_WALL_PER_CPU = 6.0
"""Wall-clock seconds granted per CPU second: the machine may be busy with other work."""
_FLAT = 1e-5
"""Pieces thinner than this (unit diagonal) have no volume that a simulator accepts."""
_COARSEST = 0.008
"""Largest tolerance of the simplification before the search."""
_FIRST_TOLERANCE = 2e-4
"""Where the search for the tolerance that leaves few enough vertices starts."""


class Decomposition(NamedTuple):
    """Convex pieces, how they were found, and warnings for the report."""

    pieces: tuple[TriangleMesh, ...]
    method: str
    """`convex`, `coacd`, `coacd_second` or `hull` (the last answer)."""
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

    simple = _simplified(solid, config)
    warnings = []
    thin = solid.volume() / solid.surface_area() < config.thin_ratio
    tries = (
        (
            "coacd",
            config.thin_threshold if thin else config.threshold,
            config.max_pieces,
            config.cpu_seconds,
        ),
        (
            "coacd_second",
            config.second_threshold,
            config.second_max_pieces,
            config.second_cpu_seconds,
        ),
    )
    for method, threshold, most, seconds in tries:
        raw, reason = _run_coacd(simple, config, threshold, most, seconds)
        pieces = _solid_pieces(raw, mesh, config)
        if pieces:
            return Decomposition(pieces, method, tuple(warnings))
        warnings.append(f"{method} {reason or 'gave no piece with a volume'}")
    warnings.append("replaced by its hull")
    return Decomposition((_few_vertices(hull, config),), "hull", tuple(warnings))


def _simplified(solid: Manifold, config: ConvexConfig) -> TriangleMesh:
    """Collapse edges under the tolerance, and further while there are too many faces."""
    tolerance = config.simplify
    simple = solid.simplify(tolerance)
    while simple.num_tri() > config.max_faces and tolerance < _COARSEST:
        tolerance *= 1.4
        simple = solid.simplify(tolerance)
    return as_mesh(simple)


def _run_coacd(
    mesh: TriangleMesh, config: ConvexConfig, threshold: float, most: int, seconds: int
) -> tuple[list[NDArray[np.float64]], str]:
    """Return the vertices of the raw pieces, or none and a reason."""
    problem = _unsafe(mesh)
    if problem:
        return [], problem
    options = {
        "threshold": threshold,
        "max_convex_hull": most,
        "preprocess_mode": "off",
        "resolution": config.resolution,
        "mcts_nodes": config.mcts_nodes,
        "mcts_iterations": config.mcts_iterations,
        "mcts_max_depth": config.mcts_max_depth,
        "decimate": False,
        "seed": 0,
        "cpu_seconds": seconds,
    }
    buffer = io.BytesIO()
    np.savez(
        buffer, vertices=mesh.vertices, faces=mesh.faces, options=np.array(json.dumps(options))
    )
    command = [sys.executable, "-m", "bidexdata.objects.coacd_worker"]
    # One thread: the pieces must not depend on the number of cores.
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    try:
        done = subprocess.run(
            command,
            input=buffer.getvalue(),
            capture_output=True,
            timeout=_WALL_PER_CPU * seconds,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return [], f"did not end within {_WALL_PER_CPU * seconds:.0f} s"
    if done.returncode != 0:
        _log.debug("CoACD: %s", done.stderr.decode(errors="replace")[-2000:])
        ended = "reached its limit" if done.returncode in (-24, -9) else "died"
        return [], f"{ended} (limit {seconds} CPU s, exit status {done.returncode})"
    answer = np.load(io.BytesIO(done.stdout), allow_pickle=False)
    return [answer[f"v{k}"] for k in range(int(answer["count"]))], ""


def _unsafe(mesh: TriangleMesh) -> str:
    """Name what would make CoACD abort or hang; empty when the mesh is fit."""
    if len(mesh.faces) < 4:
        return "was given too few faces"
    if not np.all(np.isfinite(mesh.vertices)):
        return "was given vertices that are not finite"
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        return "was given face indices out of range"
    return ""


def _solid_pieces(
    raw: list[NDArray[np.float64]], mesh: TriangleMesh, config: ConvexConfig
) -> tuple[TriangleMesh, ...]:
    """Hull every raw piece, drop those too small for a simulator, close the cracks between."""
    hulls = [convex_hull(v) for v in raw if len(v) >= 4 and np.all(np.isfinite(v))]
    hulls = [h for h in hulls if not h.is_empty() and h.volume() > 0]
    total = sum(h.volume() for h in hulls)
    kept = [as_mesh(h) for h in hulls if h.volume() >= config.min_volume * total]
    kept = [piece for piece in kept if thinnest(piece.vertices) > _FLAT]
    whole = overlap_cuts(kept, mesh, config.overlap) if len(kept) > 1 else kept
    return tuple(_few_vertices(convex_hull(piece.vertices), config) for piece in whole)


def _few_vertices(hull: Manifold, config: ConvexConfig) -> TriangleMesh:
    """Bound the vertices of a convex body and keep its volume.

    Edges are collapsed under a growing tolerance; the smaller body is blown up about its centre
    to the volume it had.
    """
    fewer, tolerance = hull, _FIRST_TOLERANCE
    while fewer.num_vert() > config.max_vertices:
        fewer = convex_hull(as_mesh(hull.simplify(tolerance)).vertices)
        if fewer.is_empty():
            raise PrepareFailure(Status.DECOMPOSITION_FAILED, "a piece has too many vertices")
        tolerance *= 1.5
    mesh = as_mesh(fewer)
    if fewer is hull:
        return mesh
    centre = mass_properties(mesh).centre
    grow = (hull.volume() / fewer.volume()) ** (1 / 3)
    return TriangleMesh(centre + grow * (mesh.vertices - centre), mesh.faces)
