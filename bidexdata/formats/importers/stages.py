"""What an import makes of grasps: the stages that a format lacks, and what the hand cannot do.

A format without pre-grasp and squeeze gets those by which the paper tested BimanGrasp's grasps: the
palm drawn back, and on, along its normal, the joints that close the fingers opened, and closed. Joints
a little outside our hand's range are moved to its edge; farther outside, the grasp is no grasp of our
hand, and its row has the status `joint_range` and no pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.formats.importers.format import FloatArray
from bidexdata.frames import quat_rotate
from bidexdata.hands.model import Hand
from bidexdata.record.fields import STAGES
from bidexdata.synthesis.opening import LEAST_CLOSING, closing_joints

MADE_PALM = 0.01
"""Way of the palm back at the pre-grasp, and on at the squeeze [m]. Source: BiDexGrasp, section 6."""
MADE_JOINTS = 0.1
"""Angle by which closing joints open, and close [rad]. Source: the same."""
MOVED_TO_EDGE = 0.002
"""How far outside its range a joint may be to be moved to the edge of it [rad]. Ours: a fingertip
moves by at most 0.2 mm."""
GRASP = STAGES.index("grasp")


class Staged(NamedTuple):
    """Poses and joints of one hand at every stage."""

    pos: FloatArray
    """(N, S, 3) [m]."""
    quat_wxyz: FloatArray
    """(N, S, 4)."""
    joints: FloatArray
    """In the hand's order, (N, S, J) [rad]."""
    possible: NDArray[np.bool_]
    """Whether pre-grasp and grasp are within the hand's range, or nearly so, (N,)."""


def staged(pos: FloatArray, quat_wxyz: FloatArray, joints: FloatArray, hand: Hand) -> Staged:
    """Give every stage of one hand's grasps, within the hand's range.

    The squeeze is a command, which may ask for more than a joint can give: it stays as it is.

    Args:
        pos: Origins of the hand frame, (N, S, 3) with S = 3, or 1 for the grasp alone [m].
        quat_wxyz: Its orientation, (N, S, 4).
        joints: In the hand's order, (N, S, J) [rad].
        hand: Whose range it is.
    """
    told = joints[:, : GRASP + 1]
    outside = np.maximum(hand.joint_lower - told, told - hand.joint_upper)
    possible = np.asarray((outside <= MOVED_TO_EDGE).all(axis=(1, 2)))
    if joints.shape[1] == 1:
        pos, quat_wxyz, joints = _made(pos[:, 0], quat_wxyz[:, 0], joints[:, 0], hand)
    moved = joints.copy()
    moved[:, : GRASP + 1] = np.clip(joints[:, : GRASP + 1], hand.joint_lower, hand.joint_upper)
    return Staged(pos, quat_wxyz, moved, possible)


def made_of() -> dict[str, float]:
    """How stages are made, for the run's configuration."""
    return {"palm": MADE_PALM, "joints": MADE_JOINTS}


def _made(
    pos: FloatArray, quat_wxyz: FloatArray, joints: FloatArray, hand: Hand
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Draw the palm back and open the fingers, and the reverse; S = 3 from none."""
    way = np.array([-1.0, 0.0, 1.0])[None, :, None]
    on = quat_rotate(quat_wxyz, MADE_PALM * hand.T_hand_palm[:3, 2])
    close = MADE_JOINTS * closing_joints(hand, LEAST_CLOSING)
    return (
        pos[:, None] + way * on[:, None],
        np.repeat(quat_wxyz[:, None], len(STAGES), axis=1),
        joints[:, None] + way * close,
    )


def all_possible(parts: Sequence[Staged]) -> NDArray[np.bool_]:
    """Whether every hand can do its part, (N,)."""
    return np.logical_and.reduce([p.possible for p in parts])
