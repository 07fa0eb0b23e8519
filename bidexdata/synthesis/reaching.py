"""Which finished grasps the arms of a rig can take: asked as the record will store them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int8

from bidexdata.frames import quat_canonical
from bidexdata.record import Scene, Status
from bidexdata.synthesis.attempts import Attempts, rows_per_scene
from bidexdata.synthesis.pose import Pose

if TYPE_CHECKING:
    from bidexdata.arms.reach import Reach


class WorldStages(NamedTuple):
    """Pre-grasp, grasp and squeeze of N grasps as the record stores them: world, float32."""

    hand_pos: Float32[np.ndarray, "N 2 3 3"]
    """[m]."""
    hand_quat_wxyz: Float32[np.ndarray, "N 2 3 4"]
    joints: Float32[np.ndarray, "N 2 3 J"]
    """[rad]; the shorter hand's rows end in NaN."""


def world_stages(scene: Scene, stages: Sequence[Pose], rows: np.ndarray) -> WorldStages:
    """Give some grasps of a scene in the world, rounded as they are stored.

    Args:
        scene: Where the object is.
        stages: Pre-grasp, grasp and squeeze of all, object frame.
        rows: Which of them.
    """
    widest = max(q.shape[1] for q in stages[0].joints)
    pos = np.empty((len(rows), 2, len(stages), 3), np.float32)
    quat = np.empty((len(rows), 2, len(stages), 4), np.float32)
    joints = np.full((len(rows), 2, len(stages), widest), np.nan, np.float32)
    place = (np.array(scene.object_pos), np.array(scene.object_quat_wxyz))
    for s, pose in enumerate(stages):
        world = pose.rows(rows).moved(*place)
        pos[:, :, s] = world.position
        quat[:, :, s] = quat_canonical(world.quat_wxyz)
        for h, q in enumerate(world.joints):
            joints[:, h, s, : q.shape[1]] = q
    return WorldStages(pos, quat, joints)


def world_place(scene: Scene) -> tuple[Float32[np.ndarray, " 3"], Float32[np.ndarray, " 4"]]:
    """Position and orientation of a scene's object, rounded as they are stored."""
    quat = quat_canonical(np.array(scene.object_quat_wxyz))
    return np.array(scene.object_pos, np.float32), quat.astype(np.float32)


def arm_statuses(
    reach: Reach,
    attempts: Sequence[Attempts],
    stages: Sequence[Pose],
    asked: Bool[np.ndarray, " K"],
) -> Int8[np.ndarray, " K"]:
    """Ask the arms about finished grasps of several scenes of one object.

    Args:
        reach: The arms.
        attempts: Of each scene, which have K starts together.
        stages: Pre-grasp, grasp and squeeze of all starts, object frame.
        asked: About which of them.

    Returns:
        The statuses that the stage `arms` will store; NO_GRASP of those that are not asked about.
    """
    from bidexdata.arms.solutions import stored_targets

    status = np.full(len(asked), Status.NO_GRASP, np.int8)
    parts = [rows[asked[rows]] for rows in rows_per_scene(attempts)]
    targets = [
        stored_targets(
            *(*world_place(one.scene), np.float32(one.scene.size)),
            *world_stages(one.scene, stages, rows),
        )
        for one, rows in zip(attempts, parts, strict=True)
    ]
    for rows, found in zip(parts, reach.grasps(targets), strict=True):
        status[rows] = found
    return status
