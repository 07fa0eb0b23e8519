"""Pairs of palms round generic shapes on a table, as grasps of one scene each."""

from __future__ import annotations

import numpy as np

from bidexdata.arms import Targets
from bidexdata.arms.generic_pairs import draw_pairs
from bidexdata.frames import invert, quat_from_matrix


def targets(robot, size=0.3, count=8, seed=1, *, shapes=None) -> list[Targets]:
    """Hands open; at the grasp a centimetre outside, a centimetre and two farther at the other stages.

    Args:
        robot: The robot.
        size: Bounding-box diagonal [m].
        count: Pairs that are drawn.
        seed: Of the random numbers.
        shapes: Numbers of the generic shapes of which pairs are kept; all when omitted.
    """
    pairs = draw_pairs(size, count, np.random.default_rng(seed))
    widest = max(len(hand.joint_names) for hand in robot.hands)
    made = []
    for n in range(count):
        if shapes is not None and int(pairs.shape[n]) not in shapes:
            continue
        pos, quat = np.zeros((1, 2, 3, 3)), np.zeros((1, 2, 3, 4))
        for h, hand in enumerate(robot.hands):
            T = invert(hand.T_hand_palm)
            R = pairs.palm_rot[n, h] @ T[:3, :3]
            at = pairs.palm_pos[n, h] + pairs.palm_rot[n, h] @ T[:3, 3]
            back = -0.01 * pairs.palm_rot[n, h][:, 2]
            pos[0, h] = [at + 2 * back, at + back, at]
            quat[0, h] = quat_from_matrix(R)
        object_quat = quat_from_matrix(pairs.object_rot[n])
        made.append(
            Targets(pairs.object_pos[n], object_quat, size, pos, quat, np.zeros((1, 2, 3, widest)))
        )
    return made
