"""Tiny folders in the formats of DexGraspNet, BimanGrasp and BODex, made by hand.

Objects are boxes; joints fit the hands `shadow` and `capsule`, which have the same ones.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from made_dexgraspbench import BOX_FACES, OBJECTS, box, made_object, save

from bidexdata.formats.importers.named_qpos import LEFT_SIGNS, RIGHT_SIGNS, THEIR_JOINTS

SCALES = (0.08, 0.15)
PER_SCALE = 3


def decomposed(folder: Path, boxes, *, named: bool = True) -> None:
    """`coacd/decomposed.obj` with a closed body per box, as groups or without names."""
    lines, start = [], 0
    for k, (centre, half) in enumerate(boxes):
        lines += [f"o convex_{k}"] if named else []
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in box(centre, half)]
        lines += ["f " + " ".join(str(i + start) for i in face) for face in BOX_FACES]
        start += 8
    path = folder / "coacd" / "decomposed.obj"
    path.parent.mkdir(parents=True)
    path.write_text("\n".join(lines) + "\n")


def named_qpos(rng: np.random.Generator, signs=RIGHT_SIGNS) -> dict[str, float]:
    """A hand 20 cm from the object, joints well inside our range."""
    place = rng.normal(size=3)
    place *= 0.2 / np.linalg.norm(place)
    turn = rng.uniform(-1.5, 1.5, 3)
    sense = [1 if s == "+" else -1 for s in "".join(signs.values())]
    joints = np.array(sense) * rng.uniform(0.05, 0.15, len(THEIR_JOINTS))
    named = dict(zip(THEIR_JOINTS, joints.tolist(), strict=True))
    for axis, p, t in zip("xyz", place.tolist(), turn.tolist(), strict=True):
        named |= {f"WRJT{axis}": p, f"WRJR{axis}": t}
    return named


def one_hand(rng: np.random.Generator, scale: float) -> dict[str, Any]:
    return {"qpos": named_qpos(rng), "scale": np.float64(scale)}


def two_hands(rng: np.random.Generator, scale: float) -> dict[str, Any]:
    return {
        "scale": scale,
        "qpos_left": named_qpos(rng, LEFT_SIGNS),
        "qpos_right": named_qpos(rng),
        "energy": 1.0,
    }


def as_list(rows) -> np.ndarray:
    """What `numpy.save` makes of a list of dictionaries."""
    return np.array([*rows, None], object)[:-1]


def made_named(root: Path, kind: str, seed: int = 0) -> Path:
    """Write a folder of `dexgraspnet` or `bimangrasp`: 2 objects, 2 scales, 3 grasps of each."""
    rng = np.random.default_rng(seed)
    make = {"dexgraspnet": one_hand, "bimangrasp": two_hands}[kind]
    for name, boxes in OBJECTS.items():
        decomposed(root / "meshdata" / name, boxes)
        rows = [make(rng, scale) for scale in SCALES for _ in range(PER_SCALE)]
        save(root / "dataset" / f"{name}.npy", as_list(rows))
    return root


def bodex_grasps(rng: np.random.Generator, count: int) -> dict[str, Any]:
    """What BODex writes of a scene: palms, thumbs first."""
    quat = rng.normal(size=(1, count, 3, 4))
    quat /= np.linalg.norm(quat, axis=-1, keepdims=True)
    pose = np.concatenate([0.1 * rng.normal(size=(1, count, 3, 3)), quat], axis=-1)
    joints = rng.uniform(0.0, 0.15, (1, count, 3, 22))
    return {
        "robot_pose": np.concatenate([pose, joints], axis=-1).astype(np.float32),
        "obj_pose": np.array([[0, 0, 0, 1.0, 0, 0, 0]], np.float32),
        "obj_scale": np.array([0.1], np.float32),
        "world_cfg": [{"name": "x"}],
    }


def made_bodex(root: Path, seed: int = 0) -> Path:
    """Write a folder of BODex: 2 objects, one scene of 4 grasps each."""
    rng = np.random.default_rng(seed)
    for name, boxes in OBJECTS.items():
        made_object(root / "objects" / name, boxes)
        save(root / "graspdata" / name / "scale010_pose000_grasp.npy", bodex_grasps(rng, 4))
    return root
