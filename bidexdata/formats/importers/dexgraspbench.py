"""Grasps in the format of DexGraspBench (JYChen18/DexGraspBench): one pickled dictionary per file.

A file holds one grasp (29,) or several (N, 29) of the right Shadow hand: `pregrasp_qpos`,
`grasp_qpos`, `squeeze_qpos` = x y z, qw qx qy qz of the hand's root, 22 joints; `obj_pose`,
`obj_scale` (metres per unit of the object's meshes), `obj_path`. An object is a folder with
`urdf/meshes/*.obj` (convex pieces), `mesh/simplified.obj` and `info/simplified.json`. What BODex
itself writes is another format (bodex.py).

The benchmark's simulator weighs an object piece by piece, so volume, centre of mass and inertia
here are sums over the pieces, overlaps counted twice; what it calls mass refers to the volume of
the simplified mesh, kept as `nominal_volume`.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from bidexdata.formats.importers.coacd_objects import stated_origin
from bidexdata.formats.importers.format import (
    BadFile,
    FloatArray,
    ForeignGrasps,
    Format,
    ObjectSource,
    files_below,
)
from bidexdata.formats.importers.restricted_pickle import MAX_BYTES, read_npy_dict
from bidexdata.frames import quat_rotate
from bidexdata.objects.assemble import UnitSolid, assembled, unit_solid_of_sum
from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.loading import file_mesh
from bidexdata.objects.prepared import PreparedObject, TriangleMesh
from bidexdata.objects.sources.item import UNKNOWN

JOINT_NAMES = (
    *("rh_FFJ4", "rh_FFJ3", "rh_FFJ2", "rh_FFJ1", "rh_MFJ4", "rh_MFJ3", "rh_MFJ2", "rh_MFJ1"),
    *("rh_RFJ4", "rh_RFJ3", "rh_RFJ2", "rh_RFJ1", "rh_LFJ5", "rh_LFJ4", "rh_LFJ3", "rh_LFJ2"),
    *("rh_LFJ1", "rh_THJ5", "rh_THJ4", "rh_THJ3", "rh_THJ2", "rh_THJ1"),
)
"""Order of the 22 joints. Source: MuJoCo's order in the benchmark's assets/hand/shadow."""
ROOT_TO_PALM = np.array([0.0, 0.0, 0.034])
"""Palm body in the hand's root frame, same axes [m]. Source: the same file."""
STAGE_KEYS = ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos")
_GRASPS = "graspdata"
_PIECES = ("urdf", "meshes")
_ABOUT = ("source", "licence", "author", "category")


def files(root: Path) -> list[str]:
    """Grasp files below `graspdata` (or, without such a folder, anywhere below)."""
    return files_below(root, _GRASPS if (root / _GRASPS).is_dir() else ".", ".npy")


def read(data: bytes, name: str) -> ForeignGrasps:
    """Read one file.

    Raises:
        BadFile: It cannot be read, lacks a key, or not one of its grasps can be used.
    """
    del name  # the file says all itself
    found = read_npy_dict(data)
    first = numbers(found, STAGE_KEYS[0])
    if first.ndim not in (1, 2) or first.shape[-1:] != (7 + len(JOINT_NAMES),):
        width = 7 + len(JOINT_NAMES)
        raise BadFile(f"{STAGE_KEYS[0]} has shape {first.shape}, not ({width},) or (N, {width})")
    count = len(first) if first.ndim == 2 else 1
    qpos = np.stack([_rows(found, key, count, first.shape[-1]) for key in STAGE_KEYS], axis=1)
    scale = _rows(found, "obj_scale", count, 1)[:, 0]
    pose = _rows(found, "obj_pose", count, 7)
    reasons = [reason_against(qpos[i], scale[i], pose[i]) for i in range(count)]
    row = np.array([i for i, reason in enumerate(reasons) if not reason], np.int64)
    several = count > 1
    bad = [f"grasp {i}: {r}" if several else r for i, r in enumerate(reasons) if r]
    if not len(row):
        raise BadFile(bad[0] if bad else "it holds no grasp")
    quat = unit_quats(qpos[row, :, 3:7])
    return ForeignGrasps(
        object_name=named_object(found),
        scale=scale[row],
        object_pos=pose[row, :3],
        object_quat_wxyz=unit_quats(pose[row, 3:]),
        hand_pos=(qpos[row, :, :3] + quat_rotate(quat, ROOT_TO_PALM))[:, None],
        hand_quat_wxyz=quat[:, None],
        joints=(qpos[row, :, 7:],),
        row=row,
        several=several,
        left_out=tuple(bad),
    )


def find_object(name: str, root: Path, objects: Path | None) -> ObjectSource:
    """Find the folder of an object: in `objects`, at its own path, or in `root/objects`.

    Raises:
        BadFile: It is not there or holds no convex pieces.
    """
    path = PurePosixPath(name)
    inside = not path.is_absolute() and ".." not in path.parts
    places = [(objects / path.name, objects)] if objects is not None else []
    places += [(root / path, root)] if inside else []
    places.append((root / "objects" / path.name, root))
    found = next((p for p in places if p[0].joinpath(*_PIECES).is_dir()), None)
    if not path.name or found is None:
        tried = ", ".join(dict.fromkeys(str(p) for p, _ in places))
        raise BadFile(f"its object {name!r} has no urdf/meshes (looked in {tried})")
    folder, top = found
    meshes = folder.joinpath(*_PIECES)
    pieces = sorted((p for p in meshes.glob("*.obj") if p.is_file()), key=os.fsencode)
    if not pieces:
        raise BadFile(f"its object {name!r} has no convex piece in {meshes}")
    others = (folder / "info" / "simplified.json", folder / "mesh" / "simplified.obj")
    files = (*pieces, *(p for p in others if p.is_file()))
    return ObjectSource.of(path.name, folder, files, stated_origin(folder), top=top)


def load_object(source: ObjectSource, config: PrepareConfig) -> PreparedObject:
    """Take the pieces as they are: no repair, no decomposition.

    Raises:
        PrepareFailure: A piece cannot be read or has no volume.
    """
    pieces = [file_mesh(f, config.load) for f in source.files if f.parent.name == "meshes"]
    solid = unit_solid_of_sum(pieces)
    warnings: list[str] = []
    display = _display(source, config, solid, warnings)
    volume = _nominal_volume(source, warnings)
    provenance: dict[str, Any] = {
        "source_name": source.name,
        **{key: source.about.get(key, UNKNOWN) for key in _ABOUT},
        "source_sha256": source.sha256,
        "source_bytes": source.bytes,
        "source_faces": sum(len(p.faces) for p in pieces),
        "source_diagonal": solid.diagonal,
        "source_metres_per_unit": None,
        "origin_in_file": [float(x) for x in solid.centre],
        "unit_in_file": solid.diagonal,
        "repair": "none",
        "piece_method": "given",
        "pieces": len(solid.pieces),
        "mass_properties": "sum of pieces",
        "warnings": warnings,
    }
    if volume is not None:
        provenance["nominal_volume"] = volume / solid.diagonal**3
    return assembled(source.object_id, solid, display, provenance, config)


def named_object(found: dict[str, Any]) -> str:
    """How a file names its object.

    Raises:
        BadFile: It does not.
    """
    name = found.get("obj_path")
    if not isinstance(name, str) or not name.strip("/ "):
        raise BadFile("it has no text obj_path")
    return str(name)


def numbers(found: dict[str, Any], key: str) -> FloatArray:
    """An array of a file.

    Raises:
        BadFile: It is not there, or not of numbers.
    """
    if key not in found:
        raise BadFile(f"it has no {key}")
    try:
        value = np.asarray(found[key])
    except ValueError as err:  # lists of different lengths
        raise BadFile(f"its {key} is not numbers") from err
    if value.dtype.kind not in "fiu":
        raise BadFile(f"its {key} is not numbers")
    with np.errstate(invalid="ignore"):
        return value.astype(np.float64)


def _rows(found: dict[str, Any], key: str, count: int, width: int) -> FloatArray:
    """One row per grasp; what is given once holds for all."""
    value = numbers(found, key)
    if value.shape in ((), (width,)) and value.size == width:
        return np.broadcast_to(value.reshape(1, width), (count, width))
    if value.size != count * width or value.shape[:1] != (count,):
        raise BadFile(f"its {key} has shape {value.shape}, which is not that of {count} grasps")
    return value.reshape(count, width)


def reason_against(qpos: FloatArray, scale: float, pose: FloatArray) -> str:
    """Say why a grasp cannot be used; empty where it can.

    Args:
        qpos: Its stages, (3, 29).
        scale: Of the object.
        pose: Of the object, (7,).
    """
    for key, values in zip(STAGE_KEYS, qpos, strict=True):
        if not np.isfinite(values).all():
            return f"its {key} is not finite"
        if not np.linalg.norm(values[3:7]) > 0.5:
            return f"the quaternion of its {key} is none"
    if not np.isfinite(pose).all() or not np.linalg.norm(pose[3:]) > 0.5:
        return "its obj_pose is none"
    if not (math.isfinite(scale) and scale > 0):
        return f"its obj_scale is {scale:g}"
    return ""


def unit_quats(quat: FloatArray) -> FloatArray:
    """Quaternions of length 1, (..., 4)."""
    return quat / np.linalg.norm(quat, axis=-1, keepdims=True)


def _display(
    source: ObjectSource, config: PrepareConfig, solid: UnitSolid, warnings: list[str]
) -> TriangleMesh:
    """The simplified mesh, or the union of the pieces where there is none that reads."""
    path = source.folder / "mesh" / "simplified.obj"
    if path in source.files:
        try:
            return file_mesh(path, config.load)
        except PrepareFailure as failure:
            warnings.append(f"mesh/simplified.obj is not shown: {failure.reason}")
    union = solid.mesh.vertices * solid.diagonal + solid.centre
    return TriangleMesh(union, solid.mesh.faces)


def _nominal_volume(source: ObjectSource, warnings: list[str]) -> float | None:
    """Volume mass / (density scale^3) of info/simplified.json [mesh units^3]; None: not stated."""
    path = source.folder / "info" / "simplified.json"
    if path not in source.files:
        return None
    try:
        info = json.loads(path.read_bytes())
        volume = float(info["mass"]) / (float(info["density"]) * float(info["scale"]) ** 3)
        if not (math.isfinite(volume) and volume > 0):
            raise ValueError(f"a volume of {volume:g}")
    except (OSError, ValueError, KeyError, TypeError, ZeroDivisionError, OverflowError) as err:
        warnings.append(f"info/simplified.json states no mass ({type(err).__name__})")
        return None
    return volume


FORMAT = Format(
    name="dexgraspbench",
    description="DexGraspBench's own format: graspdata/**/*.npy, right Shadow hand",
    sides=("right",),
    joint_names=(JOINT_NAMES,),
    expected="graspdata/**/*.npy (or **/*.npy), each a pickled dictionary with "
    + ", ".join((*STAGE_KEYS, "obj_pose", "obj_scale", "obj_path")),
    files=files,
    read=read,
    max_bytes=MAX_BYTES,
    find_object=find_object,
    load_object=load_object,
    protocol="dexgraspbench-1",
    unknown=(
        "how many attempts the grasps are of, and how they were chosen",
        "contacts, contact forces and energies",
        "the friction and the mass that they were made for",
    ),
)
