"""MuJoCo's word on the motion of two arms: its depths at the knots that are not far from all else."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bidexdata.arms.arm_scene import ArmScene, set_arms
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.contacts import ArmDepths, arm_distances
from bidexdata.arms.solutions import Targets
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
    """OK, or what is deepest at the first knot that is too deep."""
    least: Float[np.ndarray, " 4"]
    """Least signed distances to table, object, the other arm and itself, at most the reach [m]."""


def final_word(
    scene: ArmScene,
    targets: Targets,
    row: int,
    path: Float[np.ndarray, "2 K A"],
    asked: Bool[np.ndarray, " K"],
    config: ArmConfig,
) -> FinalWord:
    """Ask MuJoCo about one motion.

    Fingers are those of the pre-grasp up to its knot, then on the way to the grasp, and stay there:
    in the squeeze they press on, and are stopped. Until the last knot before the pre-grasp, which may
    overlap the object a little, hands may not touch it; it rises with them in the lift.

    Args:
        scene: The object at its size; its state is overwritten.
        targets: The grasps of the scene.
        row: Which of them.
        path: Angles of both arms at every knot [rad].
        asked: Knots that are looked at.
        config: How deep they may be.
    """
    approach, reach, close, squeeze, lift = config.path.knots
    touch = approach + reach
    risen = touch + close + squeeze
    share = np.clip((np.arange(path.shape[1]) - touch) / close, 0.0, 1.0)[:, None, None]
    joints = targets.joints[row, :, 0] + share * (
        targets.joints[row, :, 1] - targets.joints[row, :, 0]
    )
    pos, quat = targets.object_pos, targets.object_quat_wxyz
    knots = np.flatnonzero(asked)
    least = np.full(4, config.clearance.reach)
    for some, hands_touch in ((knots[knots < touch - 1], False), (knots[knots >= touch - 1], True)):
        low = some[some <= risen]
        groups = [low] if len(low) else []
        groups += [np.array([k]) for k in some[some > risen]]
        for group in groups:
            height = max(0.0, (group[-1] - risen) / lift) * config.path.lift
            set_arms(
                scene, pos + np.array([0.0, 0.0, height]), quat, path[:, group[0]], joints[group[0]]
            )
            depths = arm_distances(
                scene, path[:, group].swapaxes(0, 1), joints[group],
                reach=config.clearance.reach, hands_touch=hands_touch,
            )  # fmt: skip
            worst = _first_too_deep(depths, config.clearance.depth)
            least = np.minimum(least, [np.min(x) for x in depths])
            if worst is not None:
                return FinalWord(worst, least)
    return FinalWord(Status.OK, least)


def _first_too_deep(depths: ArmDepths, depth: float) -> Status | None:
    found = np.stack(depths, axis=1)
    deep = np.flatnonzero(found.min(axis=1) < -depth)
    return None if not len(deep) else _STATUS[int(found[deep[0]].argmin())]
