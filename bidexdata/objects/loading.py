"""A mesh file as plain triangles of unit diagonal, z up, or the reason why not."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.readers import SUFFIXES as SUFFIXES
from bidexdata.objects.readers import read_content
from bidexdata.objects.readers.content import check_faces, unreadable
from bidexdata.objects.readers.inside import regular_bytes
from bidexdata.record.status import Status

from .config import LoadConfig
from .failure import PrepareFailure
from .prepared import TriangleMesh

_COARSE = 1e-4
"""Step between neighbouring numbers above which fine detail is lost: that of the looser weld."""


class LoadedMesh(NamedTuple):
    """Triangles of unit diagonal about the middle of their box, z up, as the file has them."""

    mesh: TriangleMesh
    centre: NDArray[np.float64]
    """Middle of the box in file units after the up conversion, (3,)."""
    diagonal: float
    """Diagonal of the box, in file units."""
    metres_per_unit: float | None
    """Metres per file unit where the format says so (glTF, DAE, 3MF)."""
    warnings: tuple[str, ...]


def load_mesh(path: Path, data: bytes, config: LoadConfig) -> LoadedMesh:
    """Read a mesh file.

    Args:
        path: Where it lies; references to other files resolve inside its folder only.
        data: Its bytes.
        config: Bounds.

    Raises:
        PrepareFailure: It is no mesh, or one that cannot be used.
    """
    content = read_content(path, data, config)
    with np.errstate(invalid="ignore"):  # infinite coordinates are refused just below
        turned = content.mesh.vertices @ content.R_world_file.T
    return unit_mesh(
        TriangleMesh(turned, content.mesh.faces),
        config,
        metres_per_unit=content.metres_per_unit,
        warnings=content.warnings,
    )


def file_mesh(path: Path, config: LoadConfig) -> TriangleMesh:
    """Read a mesh file in its own units, turned to z up; vertices without faces are dropped.

    Raises:
        PrepareFailure: It cannot be read, is no mesh, or one that cannot be used.
    """
    loaded = load_mesh(path, regular_bytes(path, config.max_bytes), config)
    return TriangleMesh(loaded.centre + loaded.diagonal * loaded.mesh.vertices, loaded.mesh.faces)


def unit_mesh(
    mesh: TriangleMesh,
    config: LoadConfig,
    *,
    metres_per_unit: float | None = None,
    warnings: tuple[str, ...] = (),
) -> LoadedMesh:
    """Check triangles in file units, drop vertices without faces, centre and scale.

    Raises:
        PrepareFailure: No faces, too many, bad indices, or vertices that span no box.
    """
    vertices = np.asarray(mesh.vertices, np.float64).reshape(-1, 3)
    faces = np.asarray(mesh.faces, np.int64).reshape(-1, 3)
    if len(faces) == 0:
        raise PrepareFailure(Status.NO_FACES, f"{len(vertices)} vertices and no face")
    check_faces(len(faces), config)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise unreadable("a face names a vertex that does not exist")
    faces, dropped = _finite(vertices, faces, config)
    used, faces = np.unique(faces, return_inverse=True)
    vertices = vertices[used]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    # Halves first: the sum of two huge coordinates would overflow.
    centre = low / 2 + high / 2
    diagonal = 2 * math.hypot(*(high / 2 - low / 2))
    if not np.isfinite(diagonal) or diagonal <= np.abs(centre).max() * 1e-12 or diagonal == 0:
        raise PrepareFailure(Status.NOT_FINITE_MESH, "all vertices lie in one point")
    unit = TriangleMesh(
        (vertices - centre) / diagonal, np.ascontiguousarray(faces.reshape(-1, 3), np.int32)
    )
    warnings += dropped + _of_precision(vertices, diagonal)
    return LoadedMesh(unit, centre, diagonal, metres_per_unit, warnings)


def _of_precision(vertices: NDArray[np.float64], diagonal: float) -> tuple[str, ...]:
    """Warn of coordinates so large that their rounding, single or double, shows in the shape."""
    largest = float(np.abs(vertices).max())
    with np.errstate(over="ignore"):
        single = np.array_equal(vertices.astype(np.float32), vertices)
    step = float(np.spacing(np.float32(largest) if single else largest)) / diagonal
    text = f"far from its origin: coordinates are {step:.2%} of the diagonal apart"
    return (text,) if step > _COARSE else ()


def _finite(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], config: LoadConfig
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Drop the faces of vertices that are no numbers, and say so; refuse when they are many."""
    broken = np.any(~np.isfinite(vertices), axis=1)
    lost = broken[faces].any(axis=1)
    if not lost.any():
        return faces, ()
    count = len(np.unique(faces[lost][broken[faces[lost]]]))
    text = f"{count} vertices are not finite: {int(lost.sum())} of {len(faces)} faces"
    if lost.sum() > config.broken_faces * len(faces):
        raise PrepareFailure(
            Status.NOT_FINITE_MESH,
            f"{text}; load.broken_faces allows {config.broken_faces:.0%}: export the mesh again",
        )
    return faces[~lost], (f"{text} dropped",)
