"""Grasps of BimanGrasp (Tsunami-kun/BimanGrasp-Generation): two hands, one pickled list per object.

`<object>.npy` holds an array of dictionaries with `scale`, `qpos_left` and `qpos_right`
(named_qpos.py), in the object's frame; `*_st` are starts and `energy`, `E_*` its own energies, which
are left aside. The right hand is DexGraspNet's. The left one is that hand mirrored at its x-z plane,
so its palm faces +y: our frame is half a turn about z from it, and its joints turn otherwise. There is
the grasp alone. Joint limits are soft in its optimiser, and some joints are off by many turns.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np

from bidexdata.formats.importers.coacd_objects import find_object, load_object
from bidexdata.formats.importers.format import ForeignGrasps, Format, files_below
from bidexdata.formats.importers.named_qpos import (
    LEFT_SIGNS,
    RIGHT_SIGNS,
    our_joints,
    palms,
    usable,
)
from bidexdata.formats.importers.restricted_pickle import MAX_BYTES, read_npy_dicts
from bidexdata.frames import quat_multiply

KEYS = ("qpos_left", "qpos_right")
LEFT_TURN = np.array([0.0, 0.0, 0.0, 1.0])
"""Our left hand frame in its, half a turn about z (w, x, y, z)."""


def files(root: Path) -> list[str]:
    """Grasp files below a folder; each is named after its object."""
    return files_below(root, ".", ".npy")


def read(data: bytes, name: str) -> ForeignGrasps:
    """Read one file.

    Raises:
        BadFile: It cannot be read, lacks a key, or not one of its grasps can be used.
    """
    found = read_npy_dicts(data)
    row, left_out = usable(found, KEYS)
    kept = [found[i] for i in row]
    left, right = (
        palms([g[key] for g in kept], signs)
        for key, signs in zip(KEYS, (LEFT_SIGNS, RIGHT_SIGNS), strict=True)
    )
    quats = (quat_multiply(left.quat_wxyz, LEFT_TURN), right.quat_wxyz)
    return ForeignGrasps(
        object_name=PurePosixPath(name).stem,
        scale=np.array([float(np.asarray(g["scale"]).reshape(())) for g in kept]),
        object_pos=np.zeros((len(row), 3)),
        object_quat_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (len(row), 1)),
        hand_pos=np.stack([left.pos, right.pos], axis=1)[:, :, None],
        hand_quat_wxyz=np.stack(quats, axis=1)[:, :, None],
        joints=(left.joints[:, None], right.joints[:, None]),
        row=np.array(row, np.int64),
        several=True,
        left_out=tuple(left_out),
    )


FORMAT = Format(
    name="bimangrasp",
    description="BimanGrasp's grasps: <object>.npy, two Shadow hands, no pre-grasp and no squeeze",
    sides=("left", "right"),
    joint_names=(our_joints("lh_"), our_joints("rh_")),
    expected="**/<object>.npy, each a pickled list of dictionaries with scale, qpos_left and "
    "qpos_right (WRJTx ... WRJRz, robot0:FFJ3 ... robot0:THJ0)",
    files=files,
    read=read,
    max_bytes=MAX_BYTES,
    find_object=find_object,
    load_object=load_object,
    protocol="paper-1",
    made_stages=True,
    settings=("floating",),
    unknown=(
        "pre-grasp and squeeze: made here, palm 10 mm back and on, closing joints 0.1 rad open and closed",
        "how many attempts the grasps are of, and how they were chosen",
        "contacts and contact forces (its energies are in other units and are left aside)",
        "the friction and the mass that they were made for",
        "the object's pose on a table: grasps are relative to the object alone",
    ),
)
