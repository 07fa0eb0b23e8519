"""Grasps of BimanDexGraspBench (DexGrasp-TH): DexGraspBench's files for two Shadow hands.

As dexgraspbench.py, one dictionary per file, but `pregrasp_qpos`, `grasp_qpos` and `squeeze_qpos` are
numbers in the order of the file's own `joint_names`: for each hand three slides and three hinges that
stand for an arm (dummy_arms.py), and 22 joints.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bidexdata.formats.importers.dexgraspbench import (
    JOINT_NAMES,
    ROOT_TO_PALM,
    STAGE_KEYS,
    files,
    find_object,
    load_object,
    named_object,
    numbers,
    unit_quats,
)
from bidexdata.formats.importers.dummy_arms import ARM_JOINTS, arm_pose
from bidexdata.formats.importers.format import BadFile, FloatArray, ForeignGrasps, Format
from bidexdata.formats.importers.restricted_pickle import MAX_BYTES, read_npy_dict
from bidexdata.frames import quat_rotate

SIDES = ("left", "right")
JOINTS = {"left": tuple(n.replace("rh_", "lh_") for n in JOINT_NAMES), "right": JOINT_NAMES}


def read(data: bytes, name: str) -> ForeignGrasps:
    """Read one file.

    Raises:
        BadFile: It cannot be read, lacks a key, or its grasp cannot be used.
    """
    del name  # the file says all itself
    found = read_npy_dict(data)
    place = _places(found)
    qpos = np.stack([_one(found, key, len(place)) for key in STAGE_KEYS])
    scale, pose = _one(found, "obj_scale", 1), _one(found, "obj_pose", 7)
    if not np.linalg.norm(pose[3:]) > 0.5 or not scale[0] > 0:
        raise BadFile("its obj_pose or obj_scale is none")
    hands = []
    for side in SIDES:
        arm = qpos[:, [place[n] for n in ARM_JOINTS[side]]]
        root, quat = arm_pose(arm, side)
        hands.append((root + quat_rotate(quat, ROOT_TO_PALM), quat))
    return ForeignGrasps(
        object_name=named_object(found),
        scale=scale,
        object_pos=pose[None, :3],
        object_quat_wxyz=unit_quats(pose[None, 3:]),
        hand_pos=np.stack([pos for pos, _ in hands])[None],
        hand_quat_wxyz=np.stack([quat for _, quat in hands])[None],
        joints=tuple(qpos[None][..., [place[n] for n in JOINTS[s]]] for s in SIDES),
        row=np.zeros(1, np.int64),
        several=False,
    )


def _places(found: dict[str, Any]) -> dict[str, int]:
    """Where each joint's number is."""
    names = found.get("joint_names")
    listed = names.tolist() if isinstance(names, np.ndarray) else names
    if not isinstance(listed, list) or not all(isinstance(n, str) for n in listed):
        raise BadFile("it has no list of joint_names")
    place = {n: k for k, n in enumerate(listed)}
    missing = [n for s in SIDES for n in (*ARM_JOINTS[s], *JOINTS[s]) if n not in place]
    if missing or len(place) != len(listed):
        what = f"lack {missing[0]}" if missing else "name a joint twice"
        raise BadFile(f"its joint_names {what}: it is not of two Shadow hands on slides and hinges")
    return place


def _one(found: dict[str, Any], key: str, width: int) -> FloatArray:
    value = numbers(found, key)
    if value.size != width or value.ndim > 1:
        raise BadFile(f"its {key} has shape {value.shape}, not ({width},)")
    if not np.isfinite(value).all():
        raise BadFile(f"its {key} is not finite")
    return value.reshape(width)


FORMAT = Format(
    name="bimandexgraspbench",
    description="BimanDexGraspBench's format: graspdata/**/*.npy, two Shadow hands",
    sides=SIDES,
    joint_names=tuple(JOINTS[s] for s in SIDES),
    expected="graspdata/**/*.npy (or **/*.npy), each a pickled dictionary with "
    + ", ".join((*STAGE_KEYS, "joint_names", "obj_pose", "obj_scale", "obj_path")),
    files=files,
    read=read,
    max_bytes=MAX_BYTES,
    find_object=find_object,
    load_object=load_object,
    protocol="bimandexgraspbench-1",
    unknown=(
        "how many attempts the grasps are of, and how they were chosen",
        "contacts, contact forces and energies",
        "the friction and the mass that they were made for",
    ),
)
