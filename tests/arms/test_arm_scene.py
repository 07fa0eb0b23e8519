"""The scene with arms: the protocol's numbers, the record's poses, and servos that hold."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from box_solids import box_solid

from bidexdata.arms import contacts
from bidexdata.arms.arm_scene import (
    ARM,
    FIXTURE,
    ServoSettings,
    SizedArmScenes,
    build_arm_scene,
    set_arms,
)
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.contacts import REACH, Masks, arm_distances, masks_of_kinds, pair_kinds
from bidexdata.frames import matrix_from_quat
from bidexdata.simulation.scene import build_scene

SIZE = 0.3
ASIDE = np.array([5.0, 5.0, 1.0])
"""Where an object is out of the way [m]."""
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def arms(robot):
    return build_arm_scene(robot, box_solid(), SIZE)


def at_rest(robot) -> tuple[np.ndarray, np.ndarray]:
    q = np.full((2, robot.joints), np.nan)
    joints = np.full((2, max(len(h.joint_names) for h in robot.hands)), np.nan)
    for i, arm in enumerate(robot.arms):
        q[i, : arm.chain.joints] = arm.chain.rest
        joints[i, : len(robot.hands[i].joint_names)] = robot.hands[i].posture_open
    return q, joints


def postures(robot, rng) -> np.ndarray:
    q = np.full((2, robot.joints), np.nan)
    for i, arm in enumerate(robot.arms):
        q[i, : arm.chain.joints] = rng.uniform(arm.chain.lower, arm.chain.upper)
    return q


def test_what_attaching_drops_is_set_again(arms, robot):
    # MjSpec.attach keeps the arm's options; the protocol's are those of floating hands.
    floating = build_scene(robot.hands, box_solid(), SIZE, table=True)
    one, other = arms.scene.model, floating.model
    for name in ("cone", "impratio", "integrator", "timestep", "solver", "noslip_iterations",
                 "iterations", "tolerance", "disableflags"):  # fmt: skip
        assert getattr(one.opt, name) == getattr(other.opt, name), name
    assert one.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert mujoco.mj_isSparse(one)
    for i, hand in enumerate(robot.hands):
        for name in hand.body_names:
            a, b = one.body(f"hand{i}/{name}"), other.body(f"hand{i}/{name}")
            np.testing.assert_array_equal(a.mass, b.mass)
        for u, v in zip(arms.scene.actuators[i], floating.actuators[i], strict=True):
            for field in ("gainprm", "biasprm", "forcerange", "forcelimited", "ctrllimited"):
                values = [getattr(m, f"actuator_{field}") for m in (one, other)]
                np.testing.assert_array_equal(values[0][u], values[1][v], err_msg=field)
    for scene in (arms.scene, floating):
        hands = (scene.geom_owner >= 0) & (scene.geom_owner < 2)
        assert np.all(scene.model.geom_solref[hands] == scene.settings.hand_solref)


def test_geoms_of_hands_object_and_table_are_those_of_floating_scenes(arms, robot):
    floating = build_scene(robot.hands, box_solid(), SIZE, table=True)
    for owner in (-1, 0, 1, 2):
        counts = []
        for scene in (arms.scene, floating):
            solid = (scene.model.geom_contype | scene.model.geom_conaffinity) > 0
            counts.append(np.sum(solid & (scene.geom_owner == owner)))
        assert counts[0] == counts[1] > 0
    for i in range(2):
        assert np.sum(arms.scene.geom_owner == ARM - i) >= 8
    assert np.sum(arms.scene.geom_owner == FIXTURE) == len(robot.rig.spec.fixtures)


def test_hands_stand_where_the_chain_says(arms, robot, rng):
    _, joints = at_rest(robot)
    for _ in range(20):
        q = postures(robot, rng)
        set_arms(arms, ASIDE, UPRIGHT, q, joints)
        mujoco.mj_kinematics(arms.scene.model, arms.scene.data)
        for i, arm in enumerate(robot.arms):
            body = arms.scene.data.body(f"hand{i}/{robot.hands[i].root_body}")
            pos, rot = chain_forward(arm.chain, q[i, : arm.chain.joints])
            np.testing.assert_allclose(body.xpos, pos, atol=1e-9)
            np.testing.assert_allclose(matrix_from_quat(body.xquat), rot, atol=1e-9)


def test_gravity_compensation_holds_arms_and_hands_and_not_the_object(arms, robot):
    q, joints = at_rest(robot)
    set_arms(arms, ASIDE, UPRIGHT, q, joints)
    scene = arms.scene
    scene.model.opt.gravity[2] = -9.8
    before = scene.data.qpos.copy()
    try:
        scene.step(250)
    finally:
        scene.model.opt.gravity[:] = 0.0
    for i in range(2):
        moved = scene.data.qpos[arms.arm_qpos[i]] - before[arms.arm_qpos[i]]
        assert np.abs(moved).max() < 1e-4
    assert scene.data.qpos[scene.object_qpos + 2] < before[scene.object_qpos + 2] - 0.5


def test_without_it_arms_sag(robot):
    arms = build_arm_scene(robot, None, 1.0, servos=ServoSettings(gravity_compensation=0.0))
    q, joints = at_rest(robot)
    set_arms(arms, ASIDE, UPRIGHT, q, joints)
    arms.scene.model.opt.gravity[2] = -9.8
    arms.scene.step(250)
    moved = [np.abs(arms.scene.data.qpos[a] - q[i, : len(a)]).max() for i, a in
             enumerate(arms.arm_qpos)]  # fmt: skip
    assert min(moved) > 1e-3


def test_gains_are_multiples_and_torque_limits_stay(robot):
    one = build_arm_scene(robot, None, 1.0)
    stiff = build_arm_scene(robot, None, 1.0, servos=ServoSettings(arm_gain=4.0, wrist_gain=9.0))
    for i, arm in enumerate(robot.arms):
        u = one.arm_actuators[i]
        a, b = one.scene.model, stiff.scene.model
        gain = np.full(arm.chain.joints, 4.0)
        gain[arm.chain.joints - arm.chain.wrist :] = 9.0
        np.testing.assert_allclose(b.actuator_gainprm[u, 0], gain * a.actuator_gainprm[u, 0])
        np.testing.assert_allclose(b.actuator_biasprm[u, 1], gain * a.actuator_biasprm[u, 1])
        np.testing.assert_allclose(
            b.actuator_biasprm[u, 2], np.sqrt(gain) * a.actuator_biasprm[u, 2]
        )
        np.testing.assert_array_equal(b.actuator_forcerange[u], a.actuator_forcerange[u])
        np.testing.assert_allclose(a.actuator_forcerange[u, 1], arm.chain.torque)


def test_distances_fall_as_the_object_comes_and_depths_are_mujocos(arms, robot):
    q, joints = at_rest(robot)
    set_arms(arms, ASIDE, UPRIGHT, q, joints)
    far = arm_distances(arms, q, joints, hands_touch=False)
    assert far.obj == REACH
    # The object where a link is: as deep as it gets.
    link = arms.scene.data.geom_xpos[np.flatnonzero(arms.scene.geom_owner == ARM)[-1]].copy()
    set_arms(arms, link, UPRIGHT, q, joints)
    deep = arm_distances(arms, q, joints, hands_touch=True)
    assert deep.obj < 0
    assert deep.itself == far.itself
    assert deep.arms == far.arms
    # The hand alone in it counts only while hands do not touch.
    hand = arms.scene.data.body(f"hand1/{robot.hands[1].root_body}").xpos.copy()
    pos, rot = chain_forward(robot.arms[1].chain, robot.arms[1].chain.rest)
    palm = pos + rot @ (robot.hands[1].T_hand_palm @ [0.0, 0.0, 0.06, 1.0])[:3]
    set_arms(arms, palm, UPRIGHT, q, joints)
    off, on = (arm_distances(arms, q, joints, hands_touch=t).obj for t in (False, True))
    assert np.linalg.norm(hand - pos) < 1e-9
    assert off < on


def test_fixtures_stop_arms_and_nothing_else(arms, robot):
    model, owner = arms.scene.model, arms.scene.geom_owner
    fixtures = np.flatnonzero(owner == FIXTURE)

    def collide(a: int, b: int) -> bool:
        return bool(
            (model.geom_contype[a] & model.geom_conaffinity[b])
            or (model.geom_contype[b] & model.geom_conaffinity[a])
        )

    solid = (model.geom_contype | model.geom_conaffinity) > 0
    for f in fixtures:
        for g in np.flatnonzero(solid):
            robots = owner[g] in (ARM, ARM - 1, 0, 1)
            assert collide(f, g) == robots


def test_a_batch_of_postures_is_one_after_the_other(arms, robot, rng):
    _, joints = at_rest(robot)
    set_arms(arms, np.array([0.2, 0.0, 0.3]), UPRIGHT, at_rest(robot)[0], joints)
    q = np.stack([postures(robot, rng) for _ in range(6)])
    many = arm_distances(arms, q.reshape(2, 3, *q.shape[1:]), joints, hands_touch=False)
    for k in range(6):
        one = arm_distances(arms, q[k], joints, hands_touch=False)
        for name in one._fields:
            assert getattr(many, name).reshape(-1)[k] == getattr(one, name)
    none = arm_distances(arms, q[:0], joints, hands_touch=True)
    assert none.table.shape == (0,)


@pytest.mark.parametrize("touch", [False, True])
def test_pairs_that_do_not_count_are_left_out_and_no_distance_changes(
    arms, robot, rng, monkeypatch, touch
):
    model, (_, joints) = arms.scene.model, at_rest(robot)
    set_arms(arms, np.array([0.1, 0.0, 0.3]), UPRIGHT, at_rest(robot)[0], joints)
    q = np.stack([postures(robot, rng) for _ in range(8)])
    before = [getattr(model, name).copy() for name in Masks._fields]
    found = arm_distances(arms, q, joints, hands_touch=touch)
    for name, bits in zip(Masks._fields, before, strict=True):
        np.testing.assert_array_equal(getattr(model, name), bits)
    masks = contacts._looked_at(arms, hands_touch=touch)
    assert masks.masks is not None
    monkeypatch.setattr(contacts, "_looked_at", lambda *_, **__: masks._replace(masks=None))
    expected = arm_distances(arms, q, joints, hands_touch=touch)
    for name in found._fields:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert masks_of_kinds(arms, pair_kinds(arms, hands_touch=touch)) is not None


def test_one_compiled_scene_measures_all_sizes(robot, rng):
    sized = SizedArmScenes(robot, box_solid())
    rest, joints = at_rest(robot)
    palm = chain_forward(robot.arms[1].chain, robot.arms[1].chain.rest)[0]
    near = 0
    for size in (0.3, 0.8, 0.45):
        fresh = build_arm_scene(robot, box_solid(), size)
        for _ in range(8):
            q = rest + rng.normal(0, 0.1, rest.shape)
            found = []
            for scene in (sized.at(size), fresh):
                set_arms(scene, palm, UPRIGHT, rest, joints)
                found.append(arm_distances(scene, q, joints, hands_touch=False))
            np.testing.assert_allclose(found[0], found[1], atol=1e-6)
            near += found[1].obj < REACH
    assert near > 0
