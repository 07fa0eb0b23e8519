"""Opening: pre-grasps made of grasps, by drawing the palms back and opening the fingers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from bidexdata.frames import matrix_from_quat
from bidexdata.hands.kinematics import hand_points
from bidexdata.synthesis.pose import Pose

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand

LEAST_CLOSING = 0.005
"""A joint closes when it moves its finger's pad along the pad's normal by at least this way per
radian, in the curved posture [m]. Ours: joints that spread the fingers stay."""


def opened(
    grasp: Pose,
    hands: Sequence[Hand],
    *,
    palm: float,
    joints: float,
    least_closing: float = LEAST_CLOSING,
) -> Pose:
    """The pre-grasp of grasps that have none: palms drawn back, fingers opened past any limit.

    The squeeze goes on from it, so a joint at its stop closes by the whole angle; `within_limits`
    gives what the hand can do of it.

    Args:
        grasp: Both hands touching.
        hands: Left and right.
        palm: Way of the palms back along their normals [m].
        joints: Angle by which closing joints open [rad].
        least_closing: Which joints these are, see `LEAST_CLOSING`.

    Source:
        BiDexGrasp, section 6, how BimanGrasp's grasps were tested.
    """
    R = matrix_from_quat(grasp.quat_wxyz)
    position, opened_joints = grasp.position.copy(), []
    for h, hand in enumerate(hands):
        # Sums per component, so that the batch's size cannot change the rounding.
        out = np.sum(R[:, h] * hand.T_hand_palm[:3, 2], axis=-1)
        position[:, h] -= palm * out
        opened_joints.append(grasp.joints[h] - joints * closing_joints(hand, least_closing))
    return Pose(position, grasp.quat_wxyz, (opened_joints[0], opened_joints[1]))


def within_limits(pose: Pose, hands: Sequence[Hand]) -> Pose:
    """The same pose with every joint within its limits."""
    left, right = (
        np.clip(q, hand.joint_lower, hand.joint_upper)
        for q, hand in zip(pose.joints, hands, strict=True)
    )
    return pose._replace(joints=(left, right))


def closing_joints(hand: Hand, least: float) -> Float[np.ndarray, " J"]:
    """Which way each joint closes its finger: 1, -1, or 0 for those that do neither.

    Args:
        hand: The hand, in its curved posture.
        least: Way of a pad along its normal per radian from which a joint closes [m].
    """
    step = 1e-4
    middle = hand_points(hand, hand.posture_curved)
    sense = np.zeros(len(hand.joint_names))
    for j in range(len(sense)):
        turned = hand.posture_curved.copy()
        turned[j] += step
        moved = (hand_points(hand, turned).contact - middle.contact) / step
        along = np.sum(moved * middle.normal, axis=-1)
        most = along[np.argmax(np.abs(along))]
        sense[j] = np.sign(most) if abs(most) >= least else 0.0
    return sense
