"""Laws of what a grasp that has no motion is called: one constructed case for each status."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from test_solve import CONFIG, solved, targets

from bidexdata.arms import Targets
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.config import PathConfig
from bidexdata.arms.solve import solve_arms
from bidexdata.arms.spec import FixtureSpec
from bidexdata.frames import invert, quat_from_matrix, quat_multiply
from bidexdata.record.status import Status

NO_PLANS = dataclasses.replace(CONFIG, search=dataclasses.replace(CONFIG.search, nodes=0))


@pytest.fixture(scope="module")
def reached(made):
    """A grasp that both arms take."""
    scenes = targets(made)
    motions = solved(made, scenes, NO_PLANS)
    return scenes[int(np.flatnonzero(motions.ok)[0])]


def palms_at(robot, palms):
    """Hands whose palms stand still at poses T_world_palm, as grasps of one scene."""
    pos, quat = np.zeros((1, 2, 3, 3)), np.zeros((1, 2, 3, 4))
    for h, (hand, T) in enumerate(zip(robot.hands, palms, strict=True)):
        at = T @ invert(hand.T_hand_palm)
        pos[0, h], quat[0, h] = at[:3, 3], quat_from_matrix(at[:3, :3])
    widest = max(len(hand.joint_names) for hand in robot.hands)
    still = np.array([1.0, 0, 0, 0])
    return Targets(np.array([0.0, 0, 0.1]), still, 0.3, pos, quat, np.zeros((1, 2, 3, widest)))


def down(side: float) -> np.ndarray:
    """A palm over the middle of the table that looks down, fingers away from the arm at y = side."""
    T = np.eye(4)
    x, z = np.array([0.0, -side, 0.0]), np.array([0.0, 0.0, -1.0])
    T[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    T[:3, 3] = (0.0, 0.0, 0.3)
    return T


def at_home(robot):
    """Hands where they are at rest."""
    pos, quat = np.zeros((1, 2, 3, 3)), np.zeros((1, 2, 3, 4))
    for h, arm in enumerate(robot.arms):
        at, rot = chain_forward(arm.chain, arm.chain.rest)
        pos[0, h], quat[0, h] = at, quat_from_matrix(rot)
    palms = palms_at(robot, [np.eye(4)] * 2)
    return palms._replace(hand_pos=pos, hand_quat_wxyz=quat)


def moved(one, shift, stages=(0, 1, 2), sides=(0, 1)):
    """The hands elsewhere at some stages."""
    pos = one.hand_pos.copy()
    for h in sides:
        pos[:, h, list(stages)] += np.array(shift)
    return one._replace(hand_pos=pos)


def status(robot, one, config=NO_PLANS) -> tuple[str, int]:
    motions = solve_arms(robot, None, None, one, config)
    assert np.isnan(motions.arm_path).all()
    return Status(int(motions.arm_status[0])).label, int(motions.arm_failed_side[0])


def test_a_grasp_out_of_reach_of_one_arm_names_that_arm(made, reached):
    assert status(made, moved(reached, (3.0, 0, 0))) == ("ik_grasp", -1)
    assert status(made, moved(reached, (3.0, 0, 0), sides=(0,))) == ("ik_grasp", 0)
    assert status(made, moved(reached, (3.0, 0, 0), sides=(1,))) == ("ik_grasp", 1)


def test_a_pre_grasp_out_of_reach_is_told_from_a_grasp_out_of_reach(made, reached):
    assert status(made, moved(reached, (3.0, 0, 0), stages=(0,), sides=(1,))) == ("ik_pregrasp", 1)
    assert status(made, moved(reached, (3.0, 0, 0), stages=(2,), sides=(0,))) == ("ik_grasp", 0)


def test_a_lift_out_of_reach_is_named(made, reached):
    high = dataclasses.replace(
        NO_PLANS, path=dataclasses.replace(CONFIG.path, lift=1.0, knots=(24, 4, 4, 2, 40))
    )
    assert status(made, reached, high)[0] == "ik_lift"


def test_a_way_that_turns_too_far_between_two_knots_is_a_jump(made, reached):
    # Half a turn about the palm's own normal, in the two knots of the squeeze.
    quat, T = reached.hand_quat_wxyz.copy(), made.hands[0].T_hand_palm
    about = T[:3, :3] @ np.diag([-1.0, -1.0, 1.0]) @ T[:3, :3].T
    quat[0, 0, 2] = quat_multiply(quat[0, 0, 1], quat_from_matrix(about))
    turned = reached._replace(hand_quat_wxyz=quat)
    assert status(made, turned) == ("jump", 0)


def test_hands_under_the_table_are_a_collision_with_the_table(made):
    # Arms at rest, with bases sunk until the table is above them.
    sunk = (0.0, 0.0, -1.2)
    before = [arm.chain.before_pos.copy() for arm in made.arms]
    for shift in before:
        shift[0] += sunk
    arms = tuple(
        dataclasses.replace(arm, chain=dataclasses.replace(arm.chain, before_pos=pos))
        for arm, pos in zip(made.arms, before, strict=True)
    )
    below = dataclasses.replace(made, arms=arms)
    assert status(below, moved(at_home(made), sunk))[0] == "collision_table"


def test_a_base_that_is_walled_in_is_a_collision_of_the_arm_with_its_own_rig(made, reached):
    wall = (FixtureSpec(pos=(0.0, 0.0, 0.4), half=(0.5, 0.5, 0.4)),)
    left, right = made.arms
    walled = dataclasses.replace(made, arms=(dataclasses.replace(left, fixtures=wall), right))
    assert status(walled, reached) == ("collision_self", 0)


def test_two_hands_at_one_place_are_a_collision_of_the_arms(made):
    one = palms_at(made, [down(1.0), down(-1.0)])
    assert status(made, one) == ("collision_arms", -1)


def test_settings_that_ask_for_less_reach_no_less(made, reached):
    short = dataclasses.replace(NO_PLANS, path=PathConfig(knots=CONFIG.path.knots, lift=0.02))
    assert solve_arms(made, None, None, reached, short).ok.all()
