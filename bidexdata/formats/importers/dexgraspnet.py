"""Grasps of DexGraspNet (PKU-EPIC/DexGraspNet): one pickled list of dictionaries per object.

`<object>.npy` holds an array of dictionaries with `scale` (metres per unit of the object's mesh) and
`qpos`, the numbers of the right Shadow hand by name (named_qpos.py), in the object's frame. There is
the grasp alone. Its palm body has the frame of ours.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np

from bidexdata.formats.importers.coacd_objects import find_object, load_object
from bidexdata.formats.importers.format import ForeignGrasps, Format, files_below
from bidexdata.formats.importers.named_qpos import RIGHT_SIGNS, our_joints, palms, usable
from bidexdata.formats.importers.restricted_pickle import MAX_BYTES, read_npy_dicts

KEY = "qpos"


def files(root: Path) -> list[str]:
    """Grasp files below a folder; each is named after its object."""
    return files_below(root, ".", ".npy")


def read(data: bytes, name: str) -> ForeignGrasps:
    """Read one file.

    Raises:
        BadFile: It cannot be read, lacks a key, or not one of its grasps can be used.
    """
    found = read_npy_dicts(data)
    row, left_out = usable(found, [KEY])
    kept = [found[i] for i in row]
    hand = palms([g[KEY] for g in kept], RIGHT_SIGNS)
    return ForeignGrasps(
        object_name=PurePosixPath(name).stem,
        scale=np.array([float(np.asarray(g["scale"]).reshape(())) for g in kept]),
        object_pos=np.zeros((len(row), 3)),
        object_quat_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (len(row), 1)),
        hand_pos=hand.pos[:, None, None],
        hand_quat_wxyz=hand.quat_wxyz[:, None, None],
        joints=(hand.joints[:, None],),
        row=np.array(row, np.int64),
        several=True,
        left_out=tuple(left_out),
    )


FORMAT = Format(
    name="dexgraspnet",
    description="DexGraspNet's grasps: <object>.npy, right Shadow hand, no pre-grasp and no squeeze",
    sides=("right",),
    joint_names=(our_joints("rh_"),),
    expected="**/<object>.npy, each a pickled list of dictionaries with scale and qpos (WRJTx ... "
    "WRJRz, robot0:FFJ3 ... robot0:THJ0)",
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
        "contacts and contact forces",
        "the friction and the mass that they were made for",
        "the object's pose on a table: grasps are relative to the object alone",
    ),
)
