"""A mesh file as plain triangles of unit diagonal, z up, or the reason why not.

The readers of trimesh do the parsing; everything they do silently is undone or checked here
(docs/measurements.md, 9): no welding in file units, empty results, cut-off STL files, meshes
that only a missing decoder could read, vertices that are not numbers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.config import LoadConfig
from bidexdata.objects.containers import check_container
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.record.status import Status

SUFFIXES = (".3mf", ".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""File types that are read, in lower case."""


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
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        known = ", ".join(SUFFIXES)
        raise PrepareFailure(Status.UNSUPPORTED, f"{suffix or 'no'} file type; known: {known}")
    container = check_container(suffix, data)
    vertices, faces = _read(path, suffix)
    with np.errstate(invalid="ignore"):  # infinite coordinates are refused just below
        turned = vertices @ container.R_world_file.T
    return unit_mesh(
        TriangleMesh(turned, faces),
        config,
        metres_per_unit=container.metres_per_unit,
        warnings=container.warnings,
    )


def file_mesh(path: Path, config: LoadConfig) -> TriangleMesh:
    """Read a mesh file in its own units, turned to z up; vertices without faces are dropped.

    Raises:
        PrepareFailure: It cannot be read, is no mesh, or one that cannot be used.
    """
    try:
        data = path.read_bytes()
    except OSError as err:
        reason = err.strerror or type(err).__name__
        raise PrepareFailure(Status.UNREADABLE, f"{path.name}: {reason}") from err
    loaded = load_mesh(path, data, config)
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
    if len(faces) > config.max_faces:
        raise PrepareFailure(
            Status.TOO_COMPLEX, f"{len(faces)} faces; load.max_faces is {config.max_faces}"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise PrepareFailure(Status.UNREADABLE, "a face names a vertex that does not exist")
    used, faces = np.unique(faces, return_inverse=True)
    vertices = vertices[used]
    broken = int((~np.isfinite(vertices).all(axis=1)).sum())
    if broken:
        raise PrepareFailure(
            Status.NOT_FINITE_MESH, f"{broken} of {len(vertices)} vertices are not finite"
        )
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    # Halves first: the sum of two huge coordinates would overflow.
    centre = low / 2 + high / 2
    diagonal = float(np.linalg.norm(high / 2 - low / 2) * 2)
    if not np.isfinite(diagonal) or diagonal <= np.abs(centre).max() * 1e-12 or diagonal == 0:
        raise PrepareFailure(Status.NOT_FINITE_MESH, "all vertices lie in one point")
    unit = TriangleMesh(
        (vertices - centre) / diagonal, np.ascontiguousarray(faces.reshape(-1, 3), np.int32)
    )
    return LoadedMesh(unit, centre, diagonal, metres_per_unit, warnings)


def _read(path: Path, suffix: str) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    import trimesh

    try:
        loaded: Any = trimesh.load(path, file_type=suffix[1:], process=False)
        parts = _parts(loaded) if isinstance(loaded, trimesh.Scene) else [_part(loaded)]
    except MemoryError as err:
        raise PrepareFailure(Status.TOO_COMPLEX, "reading it needs too much memory") from err
    except ImportError as err:
        raise PrepareFailure(
            Status.UNSUPPORTED, f"{err}; install it with: pip install 'bidexdata[synth]'"
        ) from err
    except Exception as err:
        # No list of classes would be honest: trimesh hands the bytes to a parser per format (its
        # own, lxml, pycollada, json, struct, numpy), and hostile files have made them raise index,
        # key, attribute, type, XML, zip, recursion and struct errors. One that is left out would
        # end a run for one bad mesh. Only the calls into them stand in this block.
        text = (str(err).strip() or type(err).__name__).splitlines()[0][:200]
        raise PrepareFailure(Status.UNREADABLE, f"{type(err).__name__}: {text}") from err
    return _joined(parts)


class _Part(NamedTuple):
    """Triangles of one part of a file, as the parser gives them."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    T_world_part: NDArray[np.float64] | None
    """None where the file has one part, in world coordinates."""


def _part(geometry: Any, T_world_part: Any = None) -> _Part:
    """What is no mesh, such as a path or a cloud, has no faces."""
    vertices, faces = (getattr(geometry, name, None) for name in ("vertices", "faces"))
    return _Part(
        np.asarray(np.zeros((0, 3)) if vertices is None else vertices, np.float64),
        np.asarray(np.zeros((0, 3)) if faces is None else faces, np.int64),
        None if T_world_part is None else np.asarray(T_world_part, np.float64),
    )


def _parts(scene: Any) -> list[_Part]:
    places = (scene.graph[name] for name in scene.graph.nodes_geometry)
    return [_part(scene.geometry[geometry], T_world_part) for T_world_part, geometry in places]


def _joined(parts: list[_Part]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """All triangles in world coordinates, without merging any vertex.

    Mirrored parts are wound anew so that their faces keep pointing out.
    """
    vertices, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
    for part in (p for p in parts if len(p.faces)):
        own, points, T_world_part = part.faces, part.vertices, part.T_world_part
        if own.min() < 0 or own.max() >= len(points):
            raise PrepareFailure(Status.UNREADABLE, "a face names a vertex that does not exist")
        if T_world_part is not None:
            own = own[:, ::-1] if np.linalg.det(T_world_part[:3, :3]) < 0 else own
            points = points @ T_world_part[:3, :3].T + T_world_part[:3, 3]
        vertices.append(points)
        faces.append(own + count)
        count += len(points)
    if len(faces) == 1:
        found = sum(len(p.vertices) for p in parts)
        raise PrepareFailure(Status.NO_FACES, f"{found} vertices and no face")
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)
