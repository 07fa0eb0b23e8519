"""Grasps made by hand: two palms beside a box, and batches of them."""

from __future__ import annotations

import numpy as np

from bidexdata.frames import invert, pos_quat, quat_multiply, quat_rotate
from bidexdata.record import FIELDS, GraspBatch, Header
from bidexdata.record.scene import Scene

SIZE_MM = 300
HALF = SIZE_MM / 1000 / np.sqrt(3) / 2  # of a cube's side

# Palms look along +x (beside the face at -x) and -x; fingers point up.
R_PALM = {
    1.0: np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]),
    -1.0: np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
}


def palm_pose(hand, towards: float, gap: float, offset=(0.0, 0.0)):
    """Hand pose whose palm is `gap` off the cube's face and looks towards +x or -x."""
    T = np.eye(4)
    T[:3, :3] = R_PALM[towards]
    T[:3, 3] = (-towards * (HALF + gap), *offset)
    return pos_quat(T @ invert(hand.T_hand_palm))


def squeeze(hands, gaps=(0.02, 0.01, 0.0), towards=(1.0, -1.0), offset=(0.0, 0.0)):
    """Palms that come together over the stages: hand_pos (H,S,3), hand_quat (H,S,4), joints."""
    poses = [
        [palm_pose(h, t, g, offset) for g in gaps] for h, t in zip(hands, towards, strict=False)
    ]
    pos = np.array([[p for p, _ in row] for row in poses])
    quat = np.array([[q for _, q in row] for row in poses])
    width = max(len(h.joint_names) for h in hands)
    joints = np.full((len(hands), 3, width), np.nan)
    for i, h in enumerate(hands):
        joints[i, :, : len(h.joint_names)] = np.zeros(len(h.joint_names))
    return pos, quat, joints


def turned(grasp, quat, shift):
    """The same grasp with the whole scene turned and shifted."""
    pos, hand_quat, joints = grasp
    return quat_rotate(quat, pos) + shift, quat_multiply(quat, hand_quat), joints


def batch_of(hands, grasps, object_pos=None, object_quat=None, size_mm=SIZE_MM, **columns):
    """A batch with one row per (hand_pos, hand_quat, joints)."""
    n = len(grasps)
    pos, quat, joints = (np.stack(parts) for parts in zip(*grasps, strict=True))
    scene = Scene("box", SIZE_MM)
    made = {
        "grasp_id": np.array([f"{i:016x}" for i in range(n)]),
        "scene_id": np.array([scene.scene_id] * n),
        "object_id": np.array(["box"] * n),
        "size_mm": np.broadcast_to(np.asarray(size_mm, np.int32), (n,)).copy(),
        "setting": np.array(["floating"] * n),
        "object_pos": np.zeros((n, 3)) if object_pos is None else np.asarray(object_pos),
        "object_quat_wxyz": (
            np.tile([1.0, 0, 0, 0], (n, 1)) if object_quat is None else np.asarray(object_quat)
        ),
        "attempt": np.arange(n),
        "hand_pos": pos,
        "hand_quat_wxyz": quat,
        "joints": joints,
        "synth_status": np.zeros(n),
    } | columns
    typed = {
        k: v if FIELDS[k].dtype == "string" else np.asarray(v).astype(FIELDS[k].dtype)
        for k, v in made.items()
    }
    return GraspBatch(Header(hands=tuple(h.header() for h in hands)), typed)
