"""Where the open hands stand before they reach for the object: back from the pre-grasp, clear of it.

Along the palm's normal as a rule. Fingers that lie round the object would come through it that way,
so that hands go back towards their wrists too, or up, whichever leaves most room.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bidexdata.arms.config import ArmConfig
from bidexdata.arms.solutions import Targets
from bidexdata.arms.waypoints import Poses, stand_off
from bidexdata.frames import matrix_from_quat
from bidexdata.hands.kinematics import hand_points
from bidexdata.hands.model import Hand
from bidexdata.objects.distance_field import signed_distance
from bidexdata.objects.prepared import SignedDistanceGrid

_HALF = float(np.sqrt(0.5))
_BACK = np.array(
    [[0, 0, -1], [-_HALF, 0, -_HALF], [-1, 0, 0], [0, _HALF, -_HALF], [0, -_HALF, -_HALF]], np.float64
)
"""Ways back in the palm frame: from the object, towards the wrist, sideways; up comes last."""
_CHECKS = 6
_ENOUGH = -5e-4
"""Room that the first way needs for no other to be tried [m]."""


def stand_offs(
    hand: Hand,
    side: int,
    pregrasp: Poses,
    field: SignedDistanceGrid | None,
    targets: Targets,
    config: ArmConfig,
) -> Poses:
    """Give the stand-off of one hand of each grasp.

    Args:
        hand: The hand.
        side: Its place among the hands.
        pregrasp: Where it is before it closes.
        field: The object; none where it does not count.
        targets: The grasps.
        config: How far back, and how high.
    """
    rule = config.path
    joints = targets.joints[:, side, 0, : len(hand.joint_names)]
    balls = hand_points(hand, joints).sphere @ np.swapaxes(pregrasp.rot, -1, -2)
    below = np.max(hand.sphere_radius - balls[..., 2], axis=1)
    palm = pregrasp.rot @ hand.T_hand_palm[:3, :3]
    first = stand_off(pregrasp, rule.standoff * palm @ _BACK[0], below, rule.lowest)
    if field is None:
        return first
    room = _room(balls, hand, pregrasp, first, field, targets)
    tight = np.flatnonzero(room < _ENOUGH)
    if not len(tight):
        return first
    up = np.broadcast_to([0.0, 0.0, 1.0], (len(tight), 3))
    part = Poses(pregrasp.pos[tight], pregrasp.quat_wxyz[tight])
    best = first.pos.copy()
    for away in (*(palm[tight] @ back for back in _BACK[1:]), up):
        other = stand_off(part, rule.standoff * away, below[tight], rule.lowest)
        found = _room(balls[tight], hand, part, other, field, targets)
        better = found > room[tight] + 1e-4
        best[tight[better]], room[tight[better]] = other.pos[better], found[better]
    return Poses(best, first.quat_wxyz)


def _room(
    balls: Float[np.ndarray, "N K 3"],
    hand: Hand,
    pregrasp: Poses,
    back: Poses,
    field: SignedDistanceGrid,
    targets: Targets,
) -> Float[np.ndarray, " N"]:
    """Least clearance of the open hand on its way [m], without the overlap of the pre-grasp; at most 0."""
    share = np.arange(_CHECKS) / _CHECKS
    at = back.pos[:, None] + share[:, None] * (pregrasp.pos - back.pos)[:, None]
    points = at[:, :, None] + balls[:, None] - targets.object_pos
    R = matrix_from_quat(targets.object_quat_wxyz)
    gap = signed_distance(field, targets.size, points @ R)[0] - hand.sphere_radius
    here = pregrasp.pos[:, None] + balls - targets.object_pos
    end = signed_distance(field, targets.size, here @ R)[0] - hand.sphere_radius
    own = np.minimum(end.min(axis=1), 0.0)
    return np.minimum(gap.min(axis=(1, 2)) - own, 0.0)
