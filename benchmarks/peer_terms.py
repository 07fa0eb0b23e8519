"""BimanGrasp's energy terms on its own stored poses: `python -m benchmarks.peer_terms [FOLDER]`.

FOLDER holds `grasps.npz`, `hand/` and `objects/` as BimanGrasp's files in `../shared/peers/bimangrasp`:
poses with the final terms that its code gave. The same terms by `bimangrasp_energies`, on its hand
(capsules and boxes, its keypoints and limits) and the exact surface of its object, grasp by grasp.
"""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import trimesh

from bidexdata.hands.geometry import body_shapes, depth
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.surface import farthest_point_order, sample_surface
from bidexdata.synthesis.baselines import bimangrasp_energies as energies
from bidexdata.synthesis.baselines.bimangrasp_config import BimanGraspEnergyConfig

PEER = Path("../shared/peers/bimangrasp")
OBJECT = "objects/Curver_Storage_Bin_Black_Small/coacd/decomposed.obj"
SIDES = ("left", "right")
POINTS = 2000
DRAWN = 20_000
"""Points drawn by area, of which the farthest-point order takes 2000."""
SMOOTH = 1e-8
"""The peer's distance is the root of the squared one plus this, at unit scale."""


class Contacts(NamedTuple):
    """Stored contacts against the exact surface, both hands."""

    points: np.ndarray
    """[m], (8, 3)."""
    normals: np.ndarray
    """Outward, from the difference to the nearest point, (8, 3)."""
    distance: np.ndarray
    """As the peer smooths it [m], positive inside, (8,)."""
    exact: np.ndarray
    """Unsigned distance at unit scale, (8,)."""


class PeerHand(NamedTuple):
    """The peer's hand of one side, compiled without its meshes."""

    model: mujoco.MjModel
    joints: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    keypoints: list[np.ndarray]
    """Per body, in its frame [m]."""


def stored(folder: Path) -> dict[str, np.ndarray]:
    """Read the stored poses and terms."""
    with np.load(folder / "grasps.npz") as data:
        return {
            k: data[k].astype(np.float64) if data[k].dtype == np.float32 else data[k] for k in data
        }


def our_terms(
    folder: Path, seeds: Sequence[int] = (1, 2, 3, 4)
) -> tuple[energies.Terms, list[Contacts]]:
    """Compute the six terms of every stored pose.

    Args:
        folder: The peer's files.
        seeds: Sets of surface points; E_pen and E_spen are means over them.
    """
    data = stored(folder)
    shown = trimesh.load_mesh(folder / OBJECT, process=False)
    mesh = TriangleMesh(np.asarray(shown.vertices), np.asarray(shown.faces, np.int32))
    joints = data["joint_names"].tolist()
    hands = {side: peer_hand(folder, side, joints) for side in SIDES}
    sets = [_spread(mesh, seed) for seed in seeds]
    reach = BimanGraspEnergyConfig().keypoint_reach
    found, contacts = [], []
    for g, scale in enumerate(data["scale"]):
        touching = _contacts(mesh, data, g)
        placed = {side: body_poses(hands[side], data[f"{side}_pose"][g]) for side in SIDES}
        G = energies.normal_wrenches(touching.points, touching.normals)
        pen = [
            sum(
                float(energies.penetration_energy(_depths(hands[k], placed[k], scale * points)))
                for k in SIDES
            )
            for points in sets
        ]
        found.append(
            energies.Terms(
                fc=energies.closure_energy(G),
                dis=energies.distance_energy(touching.distance),
                pen=np.array(np.mean(pen)),
                spen=np.array(sum(_near(hands[k], placed[k], reach) for k in SIDES)),
                joints=np.array(sum(_beyond(hands[k], data[f"{k}_pose"][g][9:]) for k in SIDES)),
                vew=energies.wrench_volume_energy(G),
            )
        )
        contacts.append(touching)
    return energies.Terms(*(np.array(column) for column in zip(*found, strict=True))), contacts


def peer_hand(folder: Path, side: str, joint_names: Sequence[str]) -> PeerHand:
    """Compile a hand of the peer: its capsules and boxes, without meshes and actuators.

    Limits of the left hand are those of its file negated, as the peer's code takes them.
    """
    root = ET.parse(folder / "hand" / f"{side}_shadow_hand.xml").getroot()
    for parent in list(root.iter()):
        for child in list(parent):
            meshed = child.tag == "geom" and child.get("mesh") is not None
            if meshed or child.tag in {"mesh", "texture", "material", "site"}:
                parent.remove(child)
            child.attrib.pop("material", None)
    for part in list(root):
        if part.tag not in {"compiler", "default", "worldbody", "asset"}:
            root.remove(part)
    for geom in root.iter("geom"):
        geom.set("conaffinity", "1")
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    names = tuple(joint_names)
    ends = np.array([model.joint(n).range for n in names])
    if side == "left":
        ends = -ends[:, ::-1]
    points = json.loads((folder / "hand" / "penetration_points.json").read_text())
    bodies = [model.body(b).name for b in range(1, model.nbody)]
    own = [points.get(f"{b}_child", points.get(b, [])) for b in bodies]
    keypoints = [np.array(p, np.float64).reshape(-1, 3) for p in own]
    return PeerHand(model, names, ends[:, 0], ends[:, 1], keypoints)


def body_poses(hand: PeerHand, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions [m] and rotations of the bodies in the object frame.

    The two stored columns are made orthogonal without preferring one: their sum and difference are.
    """
    a, b = (c / np.linalg.norm(c) for c in (pose[3:6], pose[6:9]))
    middle, across = ((v / np.linalg.norm(v)) / np.sqrt(2) for v in (a + b, a - b))
    x, y = middle + across, middle - across
    R = np.stack([x, y, np.cross(x, y)], axis=1)
    data = mujoco.MjData(hand.model)
    for name, angle in zip(hand.joints, pose[9:], strict=True):
        data.qpos[hand.model.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(hand.model, data)
    return data.xpos[1:] @ R.T + pose[:3], R @ data.xmat[1:].reshape(-1, 3, 3)


def _spread(mesh: TriangleMesh, seed: int) -> np.ndarray:
    drawn, _ = sample_surface(mesh, DRAWN, np.random.default_rng(seed))
    return drawn[farthest_point_order(drawn.astype(np.float32), POINTS)]


def _contacts(mesh: TriangleMesh, data: dict[str, np.ndarray], g: int) -> Contacts:
    triangles = mesh.vertices[mesh.faces]
    outward = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    scale = data["scale"][g]
    points = np.concatenate([data[f"{side}_contact_points"][g] for side in SIDES])
    normals, exact, inside = [], [], []
    for p in points / scale:
        nearest = trimesh.triangles.closest_point(triangles, np.tile(p, (len(triangles), 1)))
        away = np.linalg.norm(nearest - p, axis=1)
        k = int(np.argmin(away))
        sign = np.sign((p - nearest[k]) @ outward[k])
        normals.append(sign * (p - nearest[k]) / away[k])
        exact.append(away[k])
        inside.append(-sign)
    smooth = np.sqrt(np.square(exact) + SMOOTH)
    return Contacts(points, np.array(normals), scale * np.array(inside) * smooth, np.array(exact))


def _depths(
    hand: PeerHand, placed: tuple[np.ndarray, np.ndarray], points: np.ndarray
) -> np.ndarray:
    """Depth of points in the hand's capsules and boxes [m]."""
    position, R = placed
    every = [
        depth(shapes, (points - position[b]) @ R[b])
        for b, shapes in enumerate(body_shapes(hand.model))
        if shapes
    ]
    return np.max(every, axis=0)


def _near(hand: PeerHand, placed: tuple[np.ndarray, np.ndarray], reach: float) -> float:
    position, R = placed
    points = np.concatenate([own @ R[b].T + position[b] for b, own in enumerate(hand.keypoints)])
    pairs = np.stack(np.triu_indices(len(points), k=1), axis=1)
    # Links have keypoints in common, which the peer does not count.
    apart = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1) > 1e-6
    return float(energies.keypoint_energy(points, pairs[apart], reach))


def _beyond(hand: PeerHand, joints: np.ndarray) -> float:
    return float(energies.joint_energy(joints, hand.lower, hand.upper))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the terms beside the stored ones as Markdown."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    folder = Path(given[0]) if given else PEER
    if not (folder / "grasps.npz").is_file():
        print(f"error: no grasps.npz in {folder.resolve()}", file=sys.stderr)
        return 3
    ours, data = our_terms(folder)[0], stored(folder)
    names = ours._fields
    print("| grasp | " + " | ".join(f"E_{n}, stored" for n in names) + " |")
    print("|" + "---|" * (len(names) + 1))
    for g in range(len(data["scale"])):
        cells = [f"{getattr(ours, n)[g]:.4f}, {data[f'final_E_{n}'][g]:.4f}" for n in names]
        print(f"| {g} | " + " | ".join(cells) + " |")
    ratios = [getattr(ours, n).sum() / data[f"final_E_{n}"].sum() for n in names]
    print("| sum, ratio | " + " | ".join(f"{r:.4f}" for r in ratios) + " |")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
