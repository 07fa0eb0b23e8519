"""MuJoCo's word on the motion of two arms: its depths at the knots that are not far from all else."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bidexdata.arms.arm_scene import ArmScene, set_arms
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.contacts import arm_distances
from bidexdata.arms.fingers import fingers_at, key_places
from bidexdata.arms.solutions import Grasps
from bidexdata.record.status import Status

_STATUS = (
    Status.COLLISION_TABLE,
    Status.COLLISION_OBJECT,
    Status.COLLISION_ARMS,
    Status.COLLISION_SELF,
)
"""What the fields of `ArmDepths` are called where they are too deep."""


class FinalWord(NamedTuple):
    """Of one motion."""

    status: Status
    """OK, or what is too deep first."""
    least: Float[np.ndarray, " 4"]
    """Least signed distances to table, object, the other arm and itself, at most the reach [m]."""


def final_word(
    scene: ArmScene,
    grasps: Grasps,
    row: int,
    path: Float[np.ndarray, "2 W A"],
    asked: Bool[np.ndarray, " W"],
    config: ArmConfig,
) -> FinalWord:
    """Ask MuJoCo about one motion.

    Fingers are those of the pre-grasp up to its knot, then on the way to the grasp, and stay there:
    in the squeeze they press on, and are stopped. Until the last knot before the pre-grasp, which may
    overlap the object a little, hands may not touch it; it rises with them in the lift.

    Args:
        scene: The object at its size; its state is overwritten.
        grasps: The grasps.
        row: Which of them.
        path: Angles of both arms at every knot [rad].
        asked: Knots that are looked at.
        config: How deep they may be.
    """
    approach, reach, close, squeeze, lift = config.path.knots
    pregrasp = approach + reach
    squeezed = pregrasp + close + squeeze
    number = np.arange(path.shape[1])
    joints = fingers_at(grasps.joints[row], key_places(config.path.knots), "grasp")
    rise = np.maximum(number - squeezed, 0) / lift * config.path.lift
    set_arms(scene, grasps.object_pos[row], grasps.object_quat_wxyz[row], path[:, 0], joints[0])
    least = np.full(4, config.clearance.reach)
    # The grasp is looked at first: most motions that collide do so there.
    for touch in (True, False):
        knots = np.flatnonzero(asked & ((number >= pregrasp - 1) == touch))
        found = np.stack(
            arm_distances(
                scene,
                path[:, knots].swapaxes(0, 1),
                joints[knots],
                rise=rise[knots],
                reach=config.clearance.reach,
                hands_touch=touch,
            ),
            axis=1,
        )
        least = np.minimum(least, found.min(axis=0, initial=config.clearance.reach))
        deep = np.flatnonzero(found.min(axis=1) < -config.clearance.depth)
        if len(deep):
            return FinalWord(_STATUS[int(found[deep[0]].argmin())], least)
    return FinalWord(Status.OK, least)
