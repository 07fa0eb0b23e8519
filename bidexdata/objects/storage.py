"""A solid's folder: `mesh.glb`, `pieces.npz`, `geometry.npz`, `object.json`, always the same bytes.

A folder is written under a temporary name and renamed, so its presence means it is complete. A
release keeps the folder without `geometry.npz`: `read_solid` needs only the other three.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import socket
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.config import to_plain
from bidexdata.errors import Contradiction, PathNotFound

from .glb import read_glb, write_glb
from .prepared import PreparedObject, SignedDistanceGrid, Solid, TriangleMesh

SCHEMA_VERSION = "1.0"
"""Version of the folder's files; another major version cannot be read."""
SOLID_FILES = ("mesh.glb", "object.json", "pieces.npz")
"""What a `Solid` needs."""
OBJECT_FILES = ("geometry.npz", *SOLID_FILES)
"""What a `PreparedObject` needs."""


def write_object(
    folder: Path,
    obj: PreparedObject,
    config: Mapping[str, Any] | None = None,
    beside: Mapping[str, bytes] | None = None,
) -> None:
    """Write a prepared object.

    Args:
        folder: Becomes the object's folder; replaced when it exists.
        obj: The object.
        config: The configuration it was made with, kept in `object.json`.
        beside: More files of the folder by name, which are no part of the object.
    """
    write_files(folder, {**object_files(obj, config), **(beside or {})})


def write_solid(folder: Path, solid: Solid) -> None:
    """Write what simulation, pictures and metrics need of an object, as a release keeps it."""
    write_files(folder, solid_files(solid))


def object_files(obj: PreparedObject, config: Mapping[str, Any] | None = None) -> dict[str, bytes]:
    """Contents of the files of a prepared object by name."""
    geometry = {
        "solid_vertices": obj.solid.vertices.astype(np.float32),
        "solid_faces": obj.solid.faces.astype(np.int32),
        "hull_vertices": obj.hull.vertices.astype(np.float32),
        "hull_faces": obj.hull.faces.astype(np.int32),
        "surface_points": obj.surface_points,
        "surface_normals": obj.surface_normals,
        "sdf_values": obj.sdf.values,
        "sdf_origin": obj.sdf.origin,
        "sdf_cell": np.float64(obj.sdf.cell),
    }
    return {**solid_files(obj, config), "geometry.npz": npz_bytes(geometry, compress=True)}


def solid_files(solid: Solid, config: Mapping[str, Any] | None = None) -> dict[str, bytes]:
    """Contents of the files of a solid by name."""
    pieces = {}
    for k, piece in enumerate(solid.pieces):
        pieces[f"vertices_{k:02d}"] = piece.vertices.astype(np.float32)
        pieces[f"faces_{k:02d}"] = piece.faces.astype(np.int32)
    document = {
        "schema_version": SCHEMA_VERSION,
        "object_id": solid.object_id,
        "volume": solid.volume,
        "inertia": solid.inertia.tolist(),
        "rest_quats_wxyz": solid.rest_quats_wxyz.tolist(),
        "rest_heights": solid.rest_heights.tolist(),
        "rest_probabilities": solid.rest_probabilities.tolist(),
        "provenance": to_plain(solid.provenance),
    }
    if config is not None:
        document["config"] = to_plain(config)
    text = json.dumps(document, indent=1, sort_keys=True, allow_nan=False, ensure_ascii=False)
    return {
        "mesh.glb": write_glb(solid.mesh),
        "pieces.npz": npz_bytes(pieces),
        "object.json": (text + "\n").encode(),
    }


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files under a temporary folder name and rename it into place.

    A folder that has the same files already stays, and so does one that another machine puts there
    meanwhile: somebody may be reading it.
    """
    stale = folder.is_dir()
    if stale and _holds(folder, files):
        return
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = folder.with_name(f".{folder.name}.{socket.gethostname()}.{os.getpid()}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    for name, data in files.items():
        with open(partial / name, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
    if stale:
        shutil.rmtree(folder, ignore_errors=True)
    try:
        os.replace(partial, folder)
    except OSError:
        if not folder.is_dir():
            raise
        shutil.rmtree(partial)


def _holds(folder: Path, files: Mapping[str, bytes]) -> bool:
    try:
        return all((folder / name).read_bytes() == data for name, data in files.items())
    except OSError:
        return False


def read_object(folder: Path) -> PreparedObject:
    """Read a prepared object.

    Raises:
        PathNotFound: The folder does not exist.
        Contradiction: A file is missing, damaged or of another version.
    """
    solid = read_solid(folder)
    arrays = read_npz(folder / "geometry.npz")
    try:
        return PreparedObject(
            **{name: getattr(solid, name) for name in Solid.__slots__},
            solid=_mesh(arrays, "solid_vertices", "solid_faces"),
            hull=_mesh(arrays, "hull_vertices", "hull_faces"),
            surface_points=arrays["surface_points"],
            surface_normals=arrays["surface_normals"],
            sdf=SignedDistanceGrid(
                arrays["sdf_values"], arrays["sdf_origin"], float(arrays["sdf_cell"])
            ),
        )
    except KeyError as err:
        raise Contradiction(f"{folder / 'geometry.npz'}: the array {err} is missing") from err


def read_solid(folder: Path) -> Solid:
    """Read the solid of an object's folder, of a library or a release.

    Raises:
        PathNotFound: The folder does not exist.
        Contradiction: A file is missing, damaged or of another version.
    """
    document = read_document(folder)
    arrays = read_npz(folder / "pieces.npz")
    try:
        glb = (folder / "mesh.glb").read_bytes()
    except OSError as err:
        raise Contradiction(f"{folder / 'mesh.glb'} is missing or cannot be read") from err
    try:
        return Solid(
            object_id=document["object_id"],
            mesh=read_glb(glb, str(folder / "mesh.glb")),
            pieces=tuple(
                _mesh(arrays, f"vertices_{k:02d}", f"faces_{k:02d}")
                for k in range(len(arrays) // 2)
            ),
            volume=float(document["volume"]),
            inertia=np.array(document["inertia"], np.float64).reshape(3, 3),
            rest_quats_wxyz=np.array(document["rest_quats_wxyz"], np.float64).reshape(-1, 4),
            rest_heights=np.array(document["rest_heights"], np.float64),
            rest_probabilities=np.array(document["rest_probabilities"], np.float64),
            provenance=document["provenance"],
        )
    except (KeyError, ValueError, TypeError) as err:
        raise Contradiction(f"{folder}: object.json and pieces.npz do not fit ({err})") from err


def read_union(folder: Path) -> TriangleMesh:
    """Read the surface of the union of a prepared object's pieces, and nothing else of it.

    Raises:
        Contradiction: The file is missing or damaged.
    """
    names = ("solid_vertices", "solid_faces")
    return _mesh(read_npz(folder / "geometry.npz", names), *names)


def read_document(folder: Path) -> dict[str, Any]:
    """Read `object.json` and check its version.

    Raises:
        PathNotFound: The folder does not exist.
        Contradiction: It is missing, damaged or of another version.
    """
    path = folder / "object.json"
    if not folder.is_dir():
        raise PathNotFound(folder, "the folder of a prepared object")
    try:
        document = json.loads(path.read_bytes())
        version = str(document["schema_version"])
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise Contradiction(f"{path} is missing or damaged ({type(err).__name__})") from err
    if version.partition(".")[0] != SCHEMA_VERSION.partition(".")[0]:
        raise Contradiction(
            f"{path} has schema version {version}, this version reads {SCHEMA_VERSION}; "
            "prepare the library again"
        )
    return document


def npz_bytes(arrays: Mapping[str, NDArray[Any]], *, compress: bool = False) -> bytes:
    """Arrays as an npz archive whose bytes depend on the arrays alone (no time stamps)."""
    buffer = io.BytesIO()
    kind = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
    with zipfile.ZipFile(buffer, "w", kind, compresslevel=4 if compress else None) as archive:
        for name in sorted(arrays):
            entry = io.BytesIO()
            np.lib.format.write_array(
                entry, np.asarray(arrays[name], order="C"), allow_pickle=False
            )
            info = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            info.compress_type = kind
            info.external_attr = 0o644 << 16
            archive.writestr(info, entry.getvalue())
    return buffer.getvalue()


def read_npz(path: Path, names: Sequence[str] | None = None) -> dict[str, NDArray[Any]]:
    """Read arrays of an npz archive: those that are named, or all.

    Raises:
        Contradiction: It is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in names or archive.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as err:
        raise Contradiction(f"{path} is missing or damaged ({type(err).__name__})") from err


def _mesh(arrays: Mapping[str, NDArray[Any]], vertices: str, faces: str) -> TriangleMesh:
    return TriangleMesh(arrays[vertices].astype(np.float64), arrays[faces].astype(np.int32))
