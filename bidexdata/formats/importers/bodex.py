"""Grasps as BODex itself writes them (JYChen18/BODex), before its conversion to the benchmark's format.

`<object>/<scene>_grasp.npy` holds a dictionary of one scene: `robot_pose` (1, G, 3, 29) with the
pre-grasp, grasp and squeeze of G grasps, `obj_pose` (1, 7), `obj_scale` (1). A pose is that of the
palm body (its URDF has no 34 mm between root and palm), and the five joints of the thumb come first.
Objects are DexGraspBench's.

Source: DexGraspBench, the conversion of BODex's files in src/task/convert_format.py.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from bidexdata.formats.importers.dexgraspbench import (
    JOINT_NAMES,
    find_object,
    load_object,
    numbers,
    reason_against,
    unit_quats,
)
from bidexdata.formats.importers.format import (
    BadFile,
    FloatArray,
    ForeignGrasps,
    Format,
    files_below,
)
from bidexdata.formats.importers.restricted_pickle import MAX_BYTES, read_npy_dict
from bidexdata.record.fields import STAGES

THUMB_FIRST = (*JOINT_NAMES[17:], *JOINT_NAMES[:17])
"""Order of its 22 joints."""
WIDTH = 7 + len(THUMB_FIRST)
ENDING = "_grasp.npy"


def files(root: Path) -> list[str]:
    """Grasp files below a folder; motions with arms (`*_mogen.npy`) are another format."""
    return files_below(root, ".", ENDING)


def read(data: bytes, name: str) -> ForeignGrasps:
    """Read one file.

    Raises:
        BadFile: It cannot be read, lacks a key, or not one of its grasps can be used.
    """
    found = read_npy_dict(data)
    qpos = numbers(found, "robot_pose")
    if qpos.ndim not in (3, 4) or qpos.shape[-2:] != (len(STAGES), WIDTH):
        raise BadFile(f"its robot_pose has shape {qpos.shape}, not (1, N, {len(STAGES)}, {WIDTH})")
    if qpos.ndim == 4 and qpos.shape[0] != 1:
        raise BadFile(f"its robot_pose is of {qpos.shape[0]} scenes, not of one")
    qpos = qpos.reshape(-1, len(STAGES), WIDTH)
    scale = np.resize(_one(found, "obj_scale", 1), len(qpos))
    pose = np.tile(_one(found, "obj_pose", 7), (len(qpos), 1))
    reasons = [reason_against(q, s, p) for q, s, p in zip(qpos, scale, pose, strict=True)]
    row = np.array([i for i, reason in enumerate(reasons) if not reason], np.int64)
    bad = tuple(f"grasp {i}: {reason}" for i, reason in enumerate(reasons) if reason)
    if not len(row):
        raise BadFile(bad[0] if bad else "it holds no grasp")
    return ForeignGrasps(
        object_name=_object_name(found, name),
        scale=scale[row],
        object_pos=pose[row, :3],
        object_quat_wxyz=unit_quats(pose[row, 3:]),
        hand_pos=qpos[row, :, :3][:, None],
        hand_quat_wxyz=unit_quats(qpos[row, :, 3:7])[:, None],
        joints=(qpos[row, :, 7:],),
        row=row,
        several=True,
        left_out=bad,
    )


def _object_name(found: dict[str, Any], name: str) -> str:
    """The folder that the file lies in, as in its own conversion; `obj_path` where there is none."""
    folder = PurePosixPath(name).parent.name
    told = found.get("obj_path")
    if not folder and isinstance(told, str):
        return told
    if not folder:
        raise BadFile("it lies in no folder that names its object, and it has no obj_path")
    return folder


def _one(found: dict[str, Any], key: str, width: int) -> FloatArray:
    """What is given once for the scene."""
    value = numbers(found, key)
    if value.size != width:
        raise BadFile(f"its {key} has shape {value.shape}, not that of one scene")
    return value.reshape(width)


FORMAT = Format(
    name="bodex",
    description="BODex's own files: <object>/<scene>_grasp.npy, right Shadow hand, thumb first",
    sides=("right",),
    joint_names=(THUMB_FIRST,),
    expected="**/<object>/*_grasp.npy, each a pickled dictionary with robot_pose (1, N, 3, 29), "
    "obj_pose and obj_scale",
    files=files,
    read=read,
    max_bytes=MAX_BYTES,
    find_object=find_object,
    load_object=load_object,
    protocol="dexgraspbench-1",
    unknown=(
        "which hand its numbers are of: 22 joints are taken for the right Shadow hand's",
        "how many attempts the grasps are of, and how they were chosen",
        "contacts, contact forces and energies",
        "the friction and the mass that they were made for",
    ),
)
