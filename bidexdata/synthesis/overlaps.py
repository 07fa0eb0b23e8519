"""Overlaps of finished grasps, measured on the hands' own collision geometry by the engine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from bidexdata.synthesis.attempts import Attempts, rows_per_scene
from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.results import Overlaps

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.record import Scene
    from bidexdata.simulation.scene import SimScene


def deepest_overlaps(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    attempts: Sequence[Attempts],
    stages: tuple[Pose, Pose, Pose],
    finite: np.ndarray,
) -> Overlaps:
    """Measure the deepest overlaps of each start on the hands' own geometry.

    Args:
        obj: The object.
        hands: Left and right.
        attempts: Of each scene.
        stages: Pre-grasp, grasp and squeeze of all K starts, object frame.
        finite: Which of them consist of numbers, (K,).
    """
    from bidexdata.simulation.resize import COMPILED_SIZE, SizedScenes
    from bidexdata.simulation.scene import build_scene

    depths = np.full((3, len(finite)), np.nan)
    scenes: dict[bool, SizedScenes] = {}
    for one, every in zip(attempts, rows_per_scene(attempts), strict=True):
        rows = every[finite[every]]
        if len(rows) == 0:
            continue
        on_table = one.scene.setting == "tabletop"
        if on_table not in scenes:
            compiled = build_scene(hands, obj, COMPILED_SIZE, table=on_table)
            scenes[on_table] = SizedScenes(compiled)
        built = scenes[on_table].at(one.scene.size)
        depths[:, rows] = _overlaps(built, obj, one.scene, stages[0].rows(rows))
        for pose in stages[1:] if on_table else ():
            table = _overlaps(built, obj, one.scene, pose.rows(rows))[2]
            depths[2, rows] = np.maximum(depths[2, rows], table)
    return Overlaps(*depths)


def _overlaps(built: SimScene, obj: PreparedObject, scene: Scene, pose: Pose) -> np.ndarray:
    """Overlaps of one stage: hands with the object, among the hands, with the table [m], (3, n)."""
    from bidexdata.simulation.distances import pregrasp_penetration

    hands = built.hands
    padded = np.full((len(pose.position), 2, max(len(h.joint_names) for h in hands)), np.nan)
    for h, joints in enumerate(pose.joints):
        padded[:, h, : joints.shape[1]] = joints
    # In the world, where the table is z = 0; a floating object is at the identity there.
    origin, turn = np.array(scene.object_pos), np.array(scene.object_quat_wxyz)
    world = pose.moved(origin, turn)
    return np.stack(
        pregrasp_penetration(
            hands,
            obj,
            scene.size,
            origin,
            turn,
            world.position,
            world.quat_wxyz,
            padded,
            scene=built,
        )
    )
