"""Convex pieces that a source gives: they are kept as they are, without repair or decomposition.

A file of pieces is an OBJ: each `o` or `g` group in it is a piece, and a file without groups is
one. Coordinates are those of the file; OBJ has z up here, as in every reader.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.closed import as_mesh, convex_hull, thinnest
from bidexdata.objects.config import LoadConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.loading import file_mesh, unit_mesh
from bidexdata.objects.physics import mass_properties
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.readers.inside import regular_bytes
from bidexdata.objects.readers.text import plain_text
from bidexdata.objects.sources.item import SourceItem
from bidexdata.record.status import Status

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
    raw = [piece for path in item.pieces for piece in obj_groups(path, config)]
    corners = np.concatenate([p.vertices for p in raw])
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    solid = [p for p in raw if len(p.vertices) >= 4 and thinnest(p.vertices) > _FLAT * diagonal]
    if not solid:
        raise PrepareFailure(Status.NO_VOLUME, f"none of {len(raw)} given pieces has a volume")
    warnings = []
    if len(solid) < len(raw):
        warnings.append(f"{len(raw) - len(solid)} of {len(raw)} given pieces are flat: left out")
    hulls = [as_mesh(convex_hull(p.vertices)) for p in solid]
    return GivenPieces(
        pieces=tuple(hulls),
        whole=_joined(raw),
        radius=float(np.linalg.norm(corners, axis=1).max()),
        shown=_shown(item.shown, config, warnings),
        not_convex=sum(not _fills(p, h) for p, h in zip(solid, hulls, strict=True)),
        warnings=tuple(warnings),
    )


def obj_groups(path: Path, config: LoadConfig) -> list[TriangleMesh]:
    """The groups of an OBJ file that have faces, in its order; all of it where it names none.

    Raises:
        PrepareFailure: The file cannot be read or is no mesh.
    """
    text = plain_text(regular_bytes(path, config.max_bytes)).decode("utf-8", errors="replace")
    try:
        vertices, groups = _grouped(text)
    except (ValueError, OverflowError) as err:
        raise PrepareFailure(Status.UNREADABLE, f"{path.name}: {err}") from err
    faces = np.array([t for group in groups for t in group], np.int64).reshape(-1, 3)
    # Refuses what is no mesh; a piece without some of its faces is another piece.
    unit_mesh(TriangleMesh(vertices, faces.astype(np.int32)), replace(config, broken_faces=0.0))
    return [_compact(vertices, np.array(group, np.int64)) for group in groups if group]


def _grouped(text: str) -> tuple[NDArray[np.float64], list[list[tuple[int, int, int]]]]:
    """Vertices of an OBJ and the triangles of each group; polygons become fans."""
    vertices: list[list[float]] = []
    groups: list[list[tuple[int, int, int]]] = [[]]
    for line in text.splitlines():
        kind, *rest = line.partition("#")[0].split() or [""]
        if kind == "v":
            vertices.append([float(x) for x in rest[:3]])
        elif kind in ("o", "g"):
            groups.append([])
        elif kind == "f":
            corner = [int(c.split("/")[0]) for c in rest]
            if 0 in corner:
                raise ValueError("a face has the index 0; OBJ counts from 1")
            corner = [c - 1 if c > 0 else len(vertices) + c for c in corner]
            groups[-1] += [(corner[0], b, c) for b, c in pairwise(corner[1:])]
    return np.array(vertices, np.float64).reshape(-1, 3), groups


def _compact(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> TriangleMesh:
    used, index = np.unique(faces, return_inverse=True)
    return TriangleMesh(vertices[used], index.reshape(-1, 3).astype(np.int32))


def _joined(meshes: list[TriangleMesh]) -> TriangleMesh:
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    faces = [m.faces + start for m, start in zip(meshes, starts, strict=True)]
    vertices = np.concatenate([m.vertices for m in meshes])
    return TriangleMesh(vertices, np.concatenate(faces).astype(np.int32))


def _fills(piece: TriangleMesh, hull: TriangleMesh) -> bool:
    return abs(mass_properties(piece).volume) >= _CONVEX * mass_properties(hull).volume


def _shown(path: Path | None, config: LoadConfig, warnings: list[str]) -> TriangleMesh | None:
    if path is None:
        return None
    try:
        return file_mesh(path, config)
    except PrepareFailure as failure:
        warnings.append(f"{path.name} is not shown: {failure.reason}")
        return None
