"""Rows as DexGraspBench reads them: one dictionary per grasp, and objects as folders of pieces.

One-handed rows of the right Shadow hand are the benchmark's: `pregrasp_qpos`, `grasp_qpos` and
`squeeze_qpos` = x y z, qw qx qy qz of the hand's root, 22 joints. Two-handed rows are those of its
fork BimanDexGraspBench: numbers in the order of `joint_names`, where each hand hangs on three slides
and three hinges. Both have `obj_pose`, `obj_scale` (metres per unit of the object's meshes) and
`obj_path`, which is relative to the folder that is exported to.

An object's meshes have our object frame at a box diagonal of 2, as the benchmark's have.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bidexdata.errors import NotUsable
from bidexdata.formats.importers.dexgraspbench import JOINT_NAMES, ROOT_TO_PALM, STAGE_KEYS
from bidexdata.formats.importers.dummy_arms import ARM_JOINTS, arm_values
from bidexdata.frames import quat_rotate
from bidexdata.objects.prepared import Solid, TriangleMesh
from bidexdata.record import GraspBatch, HandHeader
from bidexdata.record.scene import scene_parts

DIAGONAL = 2.0
"""Box diagonal of the meshes in their own unit. Source: the benchmark's objects, about 2."""
OBJECTS, GRASPS = "objects", "graspdata"
_LEFT, _RIGHT = tuple(n.replace("rh_", "lh_") for n in JOINT_NAMES), JOINT_NAMES
TWO_HANDED = (*ARM_JOINTS["right"], *_RIGHT, *ARM_JOINTS["left"], *_LEFT)
"""Joints of the fork's two Shadow hands in MuJoCo's order. Source: BimanDexGraspBench,
assets/hand/dual_dummy_arm_shadow."""


class GraspFile(NamedTuple):
    """One grasp, ready to be written."""

    path: str
    """Relative to the folder that is exported to."""
    content: dict[str, Any]


def check_hands(hands: Sequence[HandHeader]) -> None:
    """Refuse hands that the benchmark, or its fork, does not have.

    Raises:
        NotUsable: They are not the right Shadow hand, or both.
    """
    wanted = {("right",): (_RIGHT,), ("left", "right"): (_LEFT, _RIGHT)}
    names = wanted.get(tuple(h.side for h in hands))
    own = [set(h.joint_names) for h in hands]
    if names is None or own != [set(n) for n in names]:
        found = ", ".join(f"{h.name} {h.side}" for h in hands)
        raise NotUsable(
            f"the format dexgraspbench takes the right Shadow hand, or both Shadow hands, not {found}"
        )


def grasp_files(batch: GraspBatch) -> Iterator[GraspFile]:
    """What to write of rows that have poses, in their order."""
    hands = batch.header.hands
    stages = _two_handed(batch) if len(hands) == 2 else _one_handed(batch)
    pose = np.concatenate([batch["object_pos"], batch["object_quat_wxyz"]], axis=1)
    for i in range(len(batch)):
        object_id = str(batch["object_id"][i])
        content: dict[str, Any] = {
            "obj_pose": pose[i].astype(np.float64),
            "obj_scale": float(batch["size"][i]) / DIAGONAL,
            "obj_path": f"{OBJECTS}/{object_id}",
            **{key: stages[i, s] for s, key in enumerate(STAGE_KEYS)},
        }
        if len(hands) == 2:
            content["joint_names"] = list(TWO_HANDED)
        place = _scene_folder(str(batch["scene_id"][i]))
        name = f"{GRASPS}/{object_id}/{place}/{batch['grasp_id'][i]}.npy"
        yield GraspFile(name, content)


def write_object(folder: Path, solid: Solid) -> None:
    """Write an object: its pieces, the mesh to show, the volume that a mass refers to."""
    meshes = folder / "urdf" / "meshes"
    meshes.mkdir(parents=True)
    names = [f"convex_piece_{k:03d}.obj" for k in range(len(solid.pieces))]
    for name, piece in zip(names, solid.pieces, strict=True):
        (meshes / name).write_text(obj_text(piece, DIAGONAL))
    (folder / "urdf" / "coacd.urdf").write_text(_urdf(names))
    (folder / "mesh").mkdir()
    (folder / "mesh" / "simplified.obj").write_text(obj_text(solid.mesh, DIAGONAL))
    corners = np.concatenate([p.vertices for p in solid.pieces])
    info = {
        "gravity_center": [0.0, 0.0, 0.0],
        "obb": (np.ptp(corners, axis=0) * DIAGONAL).tolist(),
        "scale": 1.0,
        "density": 1.0,
        "mass": solid.nominal_volume * DIAGONAL**3,
    }
    (folder / "info").mkdir()
    (folder / "info" / "simplified.json").write_text(json.dumps(info, indent=1) + "\n")


def obj_text(mesh: TriangleMesh, unit: float) -> str:
    """A mesh as an OBJ file, times `unit`; float32 coordinates are written exactly."""
    corners = np.asarray(mesh.vertices, np.float64) * unit
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces.tolist()]
    return "\n".join(lines) + "\n"


def _one_handed(batch: GraspBatch) -> np.ndarray:
    """Root pose and joints, (N, S, 29)."""
    order = [batch.header.hands[0].joint_names.index(n) for n in JOINT_NAMES]
    quat = batch["hand_quat_wxyz"][:, 0].astype(np.float64)
    root = batch["hand_pos"][:, 0] - quat_rotate(quat, ROOT_TO_PALM)
    parts = (root, quat, batch["joints"][:, 0][..., order])
    return np.concatenate(parts, axis=-1).astype(np.float32)


def _two_handed(batch: GraspBatch) -> np.ndarray:
    """Arms and joints in the order of `TWO_HANDED`, (N, S, 56)."""
    columns: dict[str, np.ndarray] = {}
    for h, hand in enumerate(batch.header.hands):
        quat = batch["hand_quat_wxyz"][:, h].astype(np.float64)
        root = batch["hand_pos"][:, h] - quat_rotate(quat, ROOT_TO_PALM)
        arm = arm_values(root, quat, hand.side)
        columns |= {n: arm[..., k] for k, n in enumerate(ARM_JOINTS[hand.side])}
        columns |= {n: batch["joints"][:, h, :, k] for k, n in enumerate(hand.joint_names)}
    return np.stack([columns[n] for n in TWO_HANDED], axis=-1).astype(np.float32)


def _scene_folder(scene_id: str) -> str:
    parts = scene_parts(scene_id)
    return f"{parts.size_mm:04d}mm_" + (
        f"table{parts.rest_pose}" if parts.rest_pose >= 0 else "float"
    )


def _urdf(names: Sequence[str]) -> str:
    """Pieces as links that are fixed to each other."""
    text = ['<robot name="root">']
    for k, name in enumerate(names):
        mesh = f'<geometry><mesh filename="meshes/{name}" scale="1 1 1"/></geometry>'
        text.append(f'  <link name="link_{name}">')
        text += [f"    <{kind}>{mesh}</{kind}>" for kind in ("visual", "collision")]
        text.append("  </link>")
        if k:
            text.append(f'  <joint name="link_{name}_joint" type="fixed">')
            text.append(f'    <parent link="link_{names[k - 1]}"/><child link="link_{name}"/>')
            text.append("  </joint>")
    return "\n".join([*text, "</robot>"]) + "\n"
