"""Laws of motions that are read at any time, and of the postures that say what stopped the others."""

from __future__ import annotations

import numpy as np
import pytest
from motions import CONFIG, beside_box, with_arms

from bidexdata.arms.arm_scene import build_arm_scene, set_arms
from bidexdata.arms.contacts import arm_distances
from bidexdata.arms.furthest import Found, furthest_posture
from bidexdata.arms.motion import at_home, hand_poses, motion_of
from bidexdata.arms.motion_views import Held, furthest_parts
from bidexdata.arms.robot_shapes import MARKED, drawn_bodies, robot_parts
from bidexdata.arms.solutions import join_targets
from bidexdata.record import Status
from bidexdata.runs.arms import targets_of

SINGLE = 1e-6
"""Angles are stored in single precision [rad]."""
REACHED = 1e-3
"""Palms stand where the grasp has them to this [m]."""


@pytest.fixture(scope="module")
def rows(made):
    batch = with_arms(made, beside_box(made.hands))
    assert batch["arm_status"][0] == Status.OK
    return batch


@pytest.fixture(scope="module")
def motion(made, rows):
    return motion_of(made, rows, 0)


def test_a_motion_goes_through_its_knots_and_stands_still_at_both_ends(motion, rows):
    for k, time in enumerate(rows["arm_time"][0]):
        assert np.allclose(motion.at(float(time)).arms, rows["arm_path"][0, :, k], atol=SINGLE)
    for time, at in ((-1.0, 0), (motion.seconds + 9, -1)):
        assert np.array_equal(motion.at(time).arms, motion.arms[:, at])
    for k in range(len(motion.time) - 1):
        middle = motion.at(float(motion.time[k : k + 2].mean())).arms
        assert np.allclose(middle, motion.arms[:, k : k + 2].mean(axis=1), atol=SINGLE)


def test_hands_are_at_the_stages_at_their_key_frames_and_the_object_rises_with_them(
    made, rows, motion
):
    for stage in range(3):
        moment = motion.at(float(motion.key_time[2 + stage]))
        poses = hand_poses(made, moment)
        assert np.abs(poses.pos - rows["hand_pos"][0, :, stage]).max() < REACHED
        assert np.allclose(moment.joints, rows["joints"][0, :, stage], equal_nan=True)
        assert np.allclose(moment.object_pos, rows["object_pos"][0], atol=SINGLE)
    rise = motion.at(motion.seconds).object_pos - rows["object_pos"][0]
    assert np.allclose(rise, [0, 0, CONFIG.path.lift], atol=REACHED)
    assert [motion.phase_at(t) for t in (0.0, motion.seconds)] == ["approach", "lift"]


def test_rows_without_a_motion_have_none(made, rows):
    columns = {**rows.columns, "arm_status": np.array([Status.JUMP], np.int8)}
    assert motion_of(made, type(rows)(rows.header, columns), 0) is None
    home = at_home(made, rows, 0)
    assert np.array_equal(home.arms[1], made.arms[1].chain.rest)


def found_of(made, status, side=-1, grasp=None):
    frames = np.full((2, 6, made.joints), np.nan)
    if grasp is not None:
        frames[:, 3] = grasp
    return Found(status, frames, side)


def grasps_of(batch):
    return join_targets([targets_of(batch, np.array([0]))])


def test_hands_that_cannot_be_reached_stay_short_and_are_marked_where_they_should_be(made):
    grasps = grasps_of(beside_box(made.hands, shift=(2.0, 0.0)))
    shown = furthest_posture(made, None, None, grasps, found_of(made, Status.IK_GRASP), CONFIG)
    poses, sides = shown.wanted
    assert sides == (0, 1)
    assert np.allclose(poses.pos, grasps.hand_pos[0, :, 1])
    assert np.isfinite(shown.moment.arms).all()
    reached = hand_poses(made, shown.moment).pos
    short = 1e3 * np.linalg.norm(reached[0] - poses.pos[0])
    assert f"the left hand stays {short:.0f} mm" in shown.words


def test_bodies_that_collide_are_marked_and_no_others(made, rng):
    grasps = grasps_of(beside_box(made.hands))
    scene = build_arm_scene(made, None, 0.3)
    rests = np.array([arm.chain.rest for arm in made.arms])
    joints = grasps.joints[0, :, 0]
    set_arms(scene, grasps.object_pos[0], grasps.object_quat_wxyz[0], rests, joints)
    for _ in range(200):
        q = rests.copy()
        q[1] = rng.uniform(made.arms[1].chain.lower, made.arms[1].chain.upper)
        depth = arm_distances(scene, q[None], joints, hands_touch=True)
        if depth.table[0] < -0.05:
            break
    found = found_of(made, Status.COLLISION_TABLE, 1, q)
    shown = furthest_posture(made, scene, None, grasps, found, CONFIG)
    assert np.array_equal(shown.moment.arms, q)
    assert shown.touching
    assert "the table and right" in shown.words
    names = {body.name for body in drawn_bodies(made, 1)}
    assert shown.touching <= names
    # Red is what they are made of; what is below the table is red, but for hands not so deep.
    plain = robot_parts(made, q, joints)
    marked = robot_parts(made, q, joints, marked=shown.touching)
    assert sum(len(p.faces) for p in plain) == sum(len(p.faces) for p in marked)
    red = next(p for p in marked if p.label == MARKED)
    assert red.vertices[:, 2].min() < -0.05
    for part in marked:
        if part.label.endswith("_arm"):
            assert part.vertices[:, 2].min() > -0.002


def test_a_jump_shows_the_arm_before_and_after(made, rows, motion, boxed):
    grasp = np.array(motion.at(float(motion.key_time[3])).arms)
    found = found_of(made, Status.JUMP, 0, grasp)
    found.frames[:, 4:] = grasp[:, None]
    found.frames[:, 1:3] = grasp[:, None]
    found.frames[0, 5, 2] += 1.5
    shown = furthest_posture(made, None, None, grasps_of(rows), found, CONFIG)
    assert shown.words == "the left arm turns a joint by 1.50 rad between squeeze and lift"
    assert np.array_equal(shown.moment.arms, grasp)
    parts = furthest_parts(made, boxed, shown)
    labels = [p.label for p in parts]
    assert labels.count(MARKED) == 1
    # Of the left arm what is behind the third joint, once more; what stands still is not.
    bodies = drawn_bodies(made, 0)
    still = {"arm0/base", "arm0/link1", "arm0/link2"}
    turned = [p for body in bodies if body.name not in still for p in body.parts]
    red = next(p for p in parts if p.label == MARKED)
    assert len(red.faces) == sum(len(p.faces) for p in turned)
    assert {"object", "left", "right", "left_arm", "right_arm", "ground"} <= set(labels)


@pytest.fixture(scope="module")
def boxed():
    from box_solids import box_solid

    return Held(box_solid(), 0.3, np.array([1.0, 0, 0, 0]))
