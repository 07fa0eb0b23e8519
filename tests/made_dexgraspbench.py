"""A tiny folder in DexGraspBench's format, made by hand: two objects of boxes, random grasps.

The joints fit the hands `shadow` and `capsule`, which have the same ones.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
BOX_FACES = [
    *([1, 2, 4], [1, 4, 3], [5, 7, 8], [5, 8, 6], [1, 5, 6], [1, 6, 2]),
    *([3, 4, 8], [3, 8, 7], [1, 3, 7], [1, 7, 5], [2, 6, 8], [2, 8, 4]),
]
# Centre and half extents of the boxes of each object. The first two overlap in 0.2 x 0.4 x 0.4.
OBJECTS = {
    "Two_Boxes": (((0.4, 0.0, 0.1), (0.5, 0.2, 0.2)), ((-0.3, 0.0, 0.1), (0.4, 0.3, 0.3))),
    "brick": (((0.0, 0.0, 0.0), (0.6, 0.4, 0.5)),),
}
NOMINAL = 0.7
"""Volume of the simplified mesh in its own units^3 that info/simplified.json states."""
SCALES = (0.1, 0.123456)
PER_SCENE = 2


def write_obj(path: Path, corners: np.ndarray, faces=BOX_FACES) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners]
    lines += [f"f {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


def box(centre, half) -> np.ndarray:
    return np.asarray(centre) + CORNERS * np.asarray(half)


def made_object(folder: Path, boxes) -> None:
    for k, (centre, half) in enumerate(boxes):
        write_obj(folder / "urdf" / "meshes" / f"convex_piece_{k:03d}.obj", box(centre, half))
    write_obj(folder / "mesh" / "simplified.obj", box(*boxes[0]))
    (folder / "info").mkdir()
    info = {"mass": 2 * NOMINAL * 8, "density": 2.0, "scale": 2.0, "gravity_center": [0, 0, 0]}
    (folder / "info" / "simplified.json").write_text(json.dumps(info))


def made_grasp(rng: np.random.Generator, name: str, scale: float, pose=None) -> dict[str, Any]:
    """What one file holds: a hand 10 cm from the object, fingers half closed."""
    quat = rng.normal(size=4)
    root = rng.normal(size=3)
    root *= 0.2 / np.linalg.norm(root)
    grasp = np.concatenate([root, quat / np.linalg.norm(quat), rng.uniform(0.0, 0.15, 22)])
    before, after = grasp.copy(), grasp.copy()
    before[:3] *= 1.1
    after[7:] += 0.01
    return {
        "obj_pose": np.array([0, 0, 0, 1.0, 0, 0, 0] if pose is None else pose),
        "obj_scale": np.float64(scale),
        "obj_path": f"assets/example_object/{name}",
        "pregrasp_qpos": before.astype(np.float32),
        "grasp_qpos": grasp.astype(np.float32),
        "squeeze_qpos": after.astype(np.float32),
    }


def made_grasps(rng: np.random.Generator, name: str, scale: float, count: int) -> dict[str, Any]:
    """A file of several grasps: arrays with a leading axis, the object given once."""
    rows = [made_grasp(rng, name, scale) for _ in range(count)]
    stacked = {k: np.stack([r[k] for r in rows]) for k in rows[0] if k.endswith("_qpos")}
    return {**rows[0], **stacked}


def save(path: Path, content: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, content, allow_pickle=True)


def made_dexgraspbench(root: Path, seed: int = 0) -> Path:
    """Write 8 files of one grasp each: 2 objects, 2 scales, 2 grasps."""
    rng = np.random.default_rng(seed)
    for name, boxes in OBJECTS.items():
        made_object(root / "objects" / name, boxes)
        for scale in SCALES:
            for k in range(PER_SCENE):
                folder = root / "graspdata" / name / f"scale{scale:g}_pose000"
                save(folder / f"{k}.npy", made_grasp(rng, name, scale))
    return root
