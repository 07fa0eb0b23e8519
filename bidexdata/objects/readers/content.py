"""What a mesh file holds: parts at their places, joined into one set of triangles."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.components import joined
from bidexdata.objects.config import LoadConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.record.status import Status

R_WORLD_Y_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Turns a file with y up to z up."""
R_WORLD_X_UP = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Turns a file with x up to z up."""


class Content(NamedTuple):
    """Triangles of a file and what its format says of them."""

    mesh: TriangleMesh
    """In file units and along the file's axes; no vertex is merged."""
    R_world_file: NDArray[np.float64]
    """Rotation from the file's axes to z up, (3, 3)."""
    metres_per_unit: float | None
    """None where the format does not say."""
    warnings: tuple[str, ...] = ()
    group: NDArray[np.intp] | None = None
    """Number of the named group of each face, (F,); None where the reader looks for none."""


class Part(NamedTuple):
    """Triangles of one part of a file and where it stands."""

    vertices: NDArray[np.float64]
    """(V, 3)."""
    faces: NDArray[np.int64]
    """(F, 3)."""
    T_world_part: NDArray[np.float64] | None = None
    """(4, 4); None where the vertices are in world coordinates."""


def unreadable(reason: str) -> PrepareFailure:
    """The failure of a file that contradicts itself or its format."""
    return PrepareFailure(Status.UNREADABLE, reason)


def joined_parts(parts: Iterable[Part], config: LoadConfig) -> TriangleMesh:
    """All triangles in world coordinates, without merging any vertex.

    Mirrored parts are wound anew so that their faces keep pointing out.

    Raises:
        PrepareFailure: No part has faces, a face names a vertex that does not exist, or there are
            more faces than the bound; the parts are not copied then.
    """
    parts = list(parts)
    full = [p for p in parts if len(p.faces)]
    if not full:
        found = sum(len(p.vertices) for p in parts)
        raise PrepareFailure(Status.NO_FACES, f"{found} vertices and no face")
    check_faces(sum(len(p.faces) for p in full), config)
    if any(p.faces.min() < 0 or p.faces.max() >= len(p.vertices) for p in full):
        raise unreadable("a face names a vertex that does not exist")
    return joined([_in_world(p) for p in full])


def _in_world(part: Part) -> TriangleMesh:
    if part.T_world_part is None:
        return TriangleMesh(part.vertices, part.faces.astype(np.int32))
    # Only what faces use: many parts may share one long list of vertices.
    used, own = np.unique(part.faces, return_inverse=True)
    own = own.reshape(-1, 3)
    R, p = part.T_world_part[:3, :3], part.T_world_part[:3, 3]
    own = (own[:, ::-1] if np.linalg.det(R) < 0 else own).astype(np.int32)
    return TriangleMesh(part.vertices[used] @ R.T + p, own)


def check_faces(count: int, config: LoadConfig) -> None:
    """Refuse more faces than the bound.

    Raises:
        PrepareFailure: There are more.
    """
    if count > config.max_faces:
        raise PrepareFailure(
            Status.TOO_COMPLEX,
            f"{count} faces; load.max_faces is {config.max_faces}: decimate the mesh",
        )


def check_instances(count: int, config: LoadConfig) -> None:
    """Refuse a scene that places more parts than the bound.

    Raises:
        PrepareFailure: There are more.
    """
    if count > config.max_instances:
        raise PrepareFailure(
            Status.TOO_COMPLEX,
            f"its scene places {_rough(count)} parts; load.max_instances is {config.max_instances}",
        )


def _rough(count: int) -> str:
    return str(count) if count < 10**9 else f"about {float(min(count, 10**300)):.0e}"
