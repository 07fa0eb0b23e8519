"""Where the open hands stand before they reach for the object: back from the pre-grasp, clear of it.

Along the palm's normal as a rule. Fingers that lie round the object would come through it that way,
so that hands go back towards their wrists too, or up, whichever leaves most room.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from bidexdata.arms.clearance import room_of_ways
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.surroundings import Surroundings
from bidexdata.arms.waypoints import Poses, stand_off
from bidexdata.hands.model import Hand

_HALF = float(np.sqrt(0.5))
_BACK = np.array(
    [[0, 0, -1], [-_HALF, 0, -_HALF], [-1, 0, 0], [0, _HALF, -_HALF], [0, -_HALF, -_HALF]],
    np.float64,
)
"""Ways back in the palm frame: from the object, towards the wrist, sideways; up comes last."""
_CHECKS = 6
_ENOUGH = -5e-4
"""Room that the first way needs for no other to be taken [m]."""


def stand_offs(
    hand: Hand,
    side: int,
    pregrasp: Poses,
    around: Surroundings,
    config: ArmConfig,
    refused: Int[np.ndarray, " N"],
) -> Poses:
    """Give the stand-off of one hand of each grasp.

    Args:
        hand: The hand.
        side: Its place among the hands.
        pregrasp: Where it is before it closes.
        around: The object, and the hands as they are then.
        config: How far back, and how high.
        refused: How many of each grasp's, the best first, are passed over.
    """
    rule = config.path
    held = around.held[side]
    assert held is not None
    balls = held.pos @ np.swapaxes(pregrasp.rot, -1, -2)
    below = np.max(hand.sphere_radius - balls[..., 2], axis=1)[:, None]
    palm = pregrasp.rot @ hand.T_hand_palm[:3, :3]
    up = np.broadcast_to([[0.0, 0.0, 1.0]], (len(palm), 1, 3))
    away = rule.standoff * np.concatenate([_BACK @ np.swapaxes(palm, -1, -2), up], axis=1)
    every = Poses(pregrasp.pos[:, None], pregrasp.quat_wxyz[:, None])
    back = stand_off(every, away, np.broadcast_to(below, away.shape[:2]), rule.lowest).pos
    lines, rows = back - every.pos, np.arange(len(back))

    def room_of(some: np.ndarray, ways: slice) -> np.ndarray:
        room, start = room_of_ways(
            around, side, some, pregrasp.pos[some], pregrasp.rot[some], lines[some, ways], _CHECKS
        )
        # An overlap of the pre-grasp is the grasp's own.
        return np.minimum(room - np.minimum(start, 0.0), 0.0)

    best = np.zeros(len(back), np.intp)
    first = room_of(rows, slice(0, 1))
    short = np.flatnonzero((first[:, 0] < _ENOUGH) | (refused > 0))
    room = np.concatenate([first[short], room_of(short, slice(1, None))], axis=1)
    room[first[short, 0] >= _ENOUGH, 0] = np.inf
    order = np.argsort(-room, axis=1, kind="stable")
    best[short] = np.take_along_axis(order, refused[short, None], axis=1)[:, 0]
    return Poses(back[rows, best], pregrasp.quat_wxyz)
