"""Convex pieces that a source gives: they are kept as they are, without repair or decomposition.

A file of pieces is an OBJ: each `o` or `g` group in it is a piece, and a file without groups is
one. Coordinates are those of the file; OBJ has z up here.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bidexdata.objects.readers import read_content
from bidexdata.objects.readers.inside import regular_bytes
from bidexdata.objects.sources.item import SourceItem
from bidexdata.record.status import Status

from .closed import as_mesh, convex_hull, thinnest
from .components import compact, joined
from .config import LoadConfig
from .failure import PrepareFailure
from .loading import file_mesh, unit_mesh
from .physics import mass_properties
from .prepared import TriangleMesh

_CONVEX = 0.97
"""Share of its hull that a piece fills. Measured: 0.999999 and more for all 74 pieces of six
objects of DexGraspNet, BimanGrasp and DexGraspBench; all pieces of a mug in one group: 0.28."""
_FLAT = 1e-5
"""Pieces thinner than this share of the object's box diagonal have no volume."""


class GivenPieces(NamedTuple):
    """The pieces of an object in file coordinates."""

    pieces: tuple[TriangleMesh, ...]
    """Convex; their vertices are those of the file that lie on the hull."""
    whole: TriangleMesh
    """All triangles of the files of pieces."""
    radius: float
    """Distance of the vertex farthest from the file's origin."""
    shown: TriangleMesh | None
    """The mesh to show; None where the source has no other than the pieces."""
    not_convex: int
    """Number of pieces that do not fill their hull: no decomposition, then."""
    warnings: tuple[str, ...]


def given_pieces(item: SourceItem, config: LoadConfig) -> GivenPieces:
    """Read the pieces of an input that names files of pieces.

    Raises:
        PrepareFailure: A file cannot be read or used, or no piece has a volume.
    """
    raw = [piece for path in item.pieces for piece in file_groups(path, config)]
    corners = np.concatenate([p.vertices for p in raw])
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    solid = [p for p in raw if len(p.vertices) >= 4 and thinnest(p.vertices) > _FLAT * diagonal]
    if not solid:
        raise PrepareFailure(Status.NO_VOLUME, f"none of {len(raw)} given pieces has a volume")
    warnings = []
    if len(solid) < len(raw):
        warnings.append(f"{len(raw) - len(solid)} of {len(raw)} given pieces are flat: left out")
    shown, doubts = _shown(item.shown, config)
    hulls = [as_mesh(convex_hull(p.vertices)) for p in solid]
    return GivenPieces(
        pieces=tuple(hulls),
        whole=joined(raw),
        radius=float(np.linalg.norm(corners, axis=1).max()),
        shown=shown,
        not_convex=sum(not fills_hull(p, h) for p, h in zip(solid, hulls, strict=True)),
        warnings=(*warnings, *doubts),
    )


def file_groups(path: Path, config: LoadConfig) -> list[TriangleMesh]:
    """The groups of a file that have faces, in its order; all of it where it names none.

    Raises:
        PrepareFailure: The file cannot be read or is no mesh.
    """
    data = regular_bytes(path, config.max_bytes)
    try:
        content = read_content(path, data, config)
        # Refuses what is no mesh; a piece without some of its faces is another piece.
        unit_mesh(content.mesh, replace(config, broken_faces=0.0))
    except PrepareFailure as failure:
        raise PrepareFailure(failure.status, f"{path.name}: {failure.reason}") from failure
    vertices, faces = content.mesh
    cuts = () if content.group is None else np.flatnonzero(np.diff(content.group)) + 1
    return [compact(TriangleMesh(vertices, own)) for own in np.split(faces, cuts)]


def fills_hull(piece: TriangleMesh, hull: TriangleMesh) -> bool:
    """Whether a closed piece is convex, or nearly: it fills its hull."""
    return abs(mass_properties(piece).volume) >= _CONVEX * mass_properties(hull).volume


def _shown(path: Path | None, config: LoadConfig) -> tuple[TriangleMesh | None, tuple[str, ...]]:
    """The mesh to show, and why the one that the source has is not shown."""
    if path is None:
        return None, ()
    try:
        return file_mesh(path, config), ()
    except PrepareFailure as failure:
        return None, (f"{path.name} is not shown: {failure.reason}",)
