"""A motion that is played meets nothing: between knots as at them, hands as well as arms."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from box_solids import box_solid
from palms import targets

from bidexdata.arms import ArmConfig
from bidexdata.arms.arm_scene import ArmScene, SizedArmScenes, place_joints, set_arms
from bidexdata.arms.contacts import arm_distances
from bidexdata.arms.generic_pairs import shape_grid
from bidexdata.arms.solve import solve_scenes
from bidexdata.record.status import Status

CONFIG = ArmConfig()
BOX, SIZE = 0, 0.6
"""Number of the cube among the generic shapes, and a diagonal that leaves hands off the table [m]."""
FINELY = 10
"""Places that are looked at per knot."""
SINGLE = 1e-5  # stored angles are float32
_APPROACH, _REACH, *_ = CONFIG.path.knots
PREGRASP = _APPROACH + _REACH


def motions(robot, count):
    """Scenes of a cube, each with its grasp and its motion, where there is one."""
    scenes = SizedArmScenes(robot, box_solid())
    some = targets(robot, SIZE, count, seed=4, shapes=(BOX,))
    found = solve_scenes(robot, shape_grid(BOX), scenes, some, CONFIG)
    for one, motion in zip(some, found, strict=True):
        if motion.arm_status[0] == Status.OK:
            arms, fingers = scenes.at(float(one.size)), one.joints[0, :, 0]
            path = motion.to_columns()["arm_path"][0].astype(float)
            set_arms(arms, one.object_pos, one.object_quat_wxyz, path[:, 0], fingers)
            yield arms, fingers, path, motion


def overlaps(arms: ArmScene, q, fingers) -> dict[tuple[int, int], float]:
    """Deepest overlaps by the owners of what overlaps [m], as the model lets things meet."""
    place_joints(arms, q, fingers)
    mujoco.mj_kinematics(arms.scene.model, arms.scene.data)
    mujoco.mj_collision(arms.scene.model, arms.scene.data)
    found: dict[tuple[int, int], float] = {}
    contact = arms.scene.data.contact
    for geoms, dist in zip(contact.geom, contact.dist, strict=True):
        first, second = sorted(int(arms.scene.geom_owner[g]) for g in geoms)
        if first != second or first < 0:  # fingers of one hand are the grasp's own
            found[first, second] = max(found.get((first, second), 0.0), -float(dist))
    return found


def assert_clear(robot, count, least):
    played = 0
    for arms, fingers, path, _motion in motions(robot, count):
        played += 1
        own = overlaps(arms, path[:, PREGRASP], fingers)
        for place in np.arange(PREGRASP * FINELY) / FINELY:
            k, t = int(place), place % 1.0
            deep = overlaps(arms, (1 - t) * path[:, k] + t * path[:, k + 1], fingers)
            for pair, depth in deep.items():
                if arms.scene.object_owner in pair and -1 in pair:
                    continue  # the object stands on the table
                may = own.get(pair, 0.0) if place > PREGRASP - 1 else 0.0
                assert depth <= max(CONFIG.clearance.depth, may), (pair, place)
    assert played >= least


def assert_clearances_are_the_least(robot, count, least):
    """Up to the pre-grasp, of arms and hands, at every knot: none is nearer than what is stored."""
    near = 0
    for arms, fingers, path, motion in motions(robot, count):
        reach = CONFIG.clearance.reach
        q = path[:, : PREGRASP + 1].swapaxes(0, 1)
        found = arm_distances(arms, q, fingers, reach=reach, hands_touch=False)
        stored = [motion.clear_table, motion.clear_object, motion.clear_arms, motion.clear_self]
        for there, column in zip(found, stored, strict=True):
            assert column[0] <= there.min() + SINGLE
            near += column[0] < reach
    assert near >= least


def test_a_motion_that_is_played_finely_meets_nothing_before_the_hands_close(made):
    assert_clear(made, 150, 3)


def test_no_arm_or_open_hand_comes_nearer_than_the_stored_clearances(made):
    assert_clearances_are_the_least(made, 500, 1)


@pytest.mark.slow
def test_motions_of_the_rigs_of_the_package_meet_nothing_before_the_hands_close(robot):
    assert_clear(robot, 250, 4)


@pytest.mark.slow
def test_on_those_rigs_nothing_comes_nearer_than_the_stored_clearances(robot):
    assert_clearances_are_the_least(robot, 600, 2)
