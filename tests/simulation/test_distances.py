"""Distances against the support function of the hand, computed from its geoms by hand."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
from box_solids import box_solid

from bidexdata.frames import quat_multiply, quat_rotate, random_quat
from bidexdata.simulation.assembly import scene_spec
from bidexdata.simulation.distances import (
    REACH,
    list_contacts,
    measure_distances,
    pregrasp_penetration,
)
from bidexdata.simulation.scene import build_scene
from bidexdata.simulation.state import set_pose

SIZE = 0.8
HALF = SIZE / np.sqrt(3) / 2
TOLERANCE = 2e-5  # convex collision errs by 0.01 mm where a capsule lies almost flat
AT_ORIGIN = np.zeros(3), np.array([1.0, 0, 0, 0])


@pytest.fixture(scope="module")
def scene(hands):
    return build_scene(hands, box_solid(), SIZE)


@pytest.fixture(scope="module")
def one_hand(hands):
    return build_scene(hands[:1], box_solid(), SIZE)


def lowest_point(scene, owner):
    """Smallest z over the hand's geoms, from their shapes alone."""
    model, data = scene.model, scene.data
    lowest = np.inf
    for g in np.flatnonzero(scene.geom_owner == owner):
        R, centre, size = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g], model.geom_size[g]
        down = R.T @ [0, 0, -1]
        kind = model.geom_type[g]
        if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            reach = size[0]
        elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            reach = size[0] + size[1] * abs(down[2])
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            reach = size[0] * np.hypot(down[0], down[1]) + size[1] * abs(down[2])
        elif kind == mujoco.mjtGeom.mjGEOM_BOX:
            reach = np.abs(down) @ size
        elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            reach = np.linalg.norm(size * down)
        else:
            mesh = model.mesh(model.geom_dataid[g])
            first, count = mesh.vertadr[0], mesh.vertnum[0]
            reach = np.max(model.mesh_vert[first : first + count] @ down)
        lowest = min(lowest, centre[2] - reach)
    return lowest


def pose_over_top(scene, gap, rng):
    """One hand, turned at random, its lowest point `gap` over the top face of the box."""
    hand = scene.hands[0]
    joints = rng.uniform(hand.joint_lower, hand.joint_upper)[None]
    quat = random_quat(rng, (1,))
    set_pose(scene, *AT_ORIGIN, np.array([[0, 0, 1.0]]), quat, joints)
    mujoco.mj_kinematics(scene.model, scene.data)
    height = 1.0 - lowest_point(scene, 0) + HALF + gap
    return np.array([[0, 0, height]]), quat, joints


@pytest.mark.parametrize("gap", [0.009, 0.004, 0.0005, -0.0005, -0.003])
def test_distance_to_a_flat_face_is_that_of_the_lowest_point(one_hand, gap):
    rng = np.random.default_rng(2)
    for _ in range(8):
        d = measure_distances(one_hand, *AT_ORIGIN, *pose_over_top(one_hand, gap, rng))
        assert d.hand_object == pytest.approx(gap, abs=TOLERANCE)
        assert min(*d.bodies[0]) == d.hand_object
        assert d.inter_hand == 0


def test_beyond_the_reach_every_distance_reads_as_the_reach(one_hand):
    pose = pose_over_top(one_hand, REACH + 0.001, np.random.default_rng(3))
    d = measure_distances(one_hand, *AT_ORIGIN, *pose)
    assert d.hand_object == REACH
    np.testing.assert_array_equal(d.fingers, REACH)


def test_a_turned_scene_has_the_same_distances(scene):
    hands = scene.hands
    joints = np.stack([h.posture_open for h in hands])
    pos = np.array([[0.05, 0, HALF + 0.02], [-0.05, 0.02, -HALF - 0.02]])
    rng = np.random.default_rng(4)
    quat = random_quat(rng, (2,))
    plain = measure_distances(scene, *AT_ORIGIN, pos, quat, joints)
    for q in [random_quat(rng), np.array([0, 1.0, 0, 0]), np.array([0, 0, 0, 1.0])]:
        shift = rng.normal(size=3)
        turned = measure_distances(
            scene, shift, q, quat_rotate(q, pos) + shift, quat_multiply(q, quat), joints
        )
        # where two boxes lie edge to edge the engine's penetration axis may flip within its tolerance
        np.testing.assert_allclose(turned.fingers, plain.fingers, atol=5e-5)
        assert turned.hand_object == pytest.approx(plain.hand_object, abs=5e-5)


def test_crossed_hands_overlap_between_hands_and_not_within(scene):
    hands = scene.hands
    joints = np.stack([h.posture_open for h in hands])
    pos = np.array([[2.0, 0, 0], [2.0, 0.005, 0]])
    quat = np.tile([1.0, 0, 0, 0], (2, 1))
    d = measure_distances(scene, *AT_ORIGIN, pos, quat, joints)
    assert d.inter_hand < -0.001
    assert d.hand_object == REACH
    pos[1, 0] = 3.0
    apart = measure_distances(scene, *AT_ORIGIN, pos, quat, joints)
    assert apart.inter_hand == 0
    assert apart.self_collision == pytest.approx(d.self_collision, abs=1e-9)


def test_one_collision_pass_lists_what_a_full_forward_pass_lists(scene):
    rng = np.random.default_rng(5)
    joints = np.stack([rng.uniform(h.joint_lower, h.joint_upper) for h in scene.hands])
    pos = np.array([[0, 0, HALF + 0.03], [0.02, 0, HALF + 0.05]])
    pose = (*AT_ORIGIN, pos, random_quat(rng, (2,)), joints)
    set_pose(scene, *pose)
    found = list_contacts(scene, 0.0, full_broad_phase=True)
    set_pose(scene, *pose)
    mujoco.mj_forward(scene.model, scene.data)
    assert len(found.dist) == scene.data.ncon > 0
    np.testing.assert_array_equal(found.dist, scene.data.contact.dist)
    np.testing.assert_array_equal(np.sort(found.geoms), np.sort(scene.data.contact.geom))
    np.testing.assert_array_equal(found.points, scene.data.contact.pos)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1, atol=1e-12)
    np.testing.assert_array_equal(scene.model.geom_gap, 0)
    np.testing.assert_array_equal(scene.model.body_margin, 0)


def test_pregrasp_penetration_is_the_depth_and_nan_for_poses_that_are_not_finite(hands, one_hand):
    rng = np.random.default_rng(6)
    depths = np.array([0.004, 0.001, -0.005])
    poses = [pose_over_top(one_hand, -d, rng) for d in depths]
    pos, quat, joints = (np.stack(p) for p in zip(*poses, strict=True))
    joints[2, 0, 0] = np.nan
    pos = np.concatenate([pos, pos[:1]])
    quat, joints = np.concatenate([quat, quat[:1]]), np.concatenate([joints, joints[:1]])
    pos[3, 0, 2] += 1.0
    args = (box_solid(), SIZE, *AT_ORIGIN, pos, quat, joints)
    got = pregrasp_penetration(hands[:1], *args, scene=one_hand)
    np.testing.assert_allclose(got.hand_object, [0.004, 0.001, np.nan, 0.0], atol=TOLERANCE)
    np.testing.assert_array_equal(got.table, [0, 0, np.nan, 0])
    np.testing.assert_array_equal(pregrasp_penetration(hands[:1], *args), got)
    none = pregrasp_penetration(hands[:1], *args[:4], pos[:0], quat[:0], joints[:0])
    assert none.hand_object.shape == (0,)


def test_pregrasp_penetration_tells_object_hands_and_table_apart(hands):
    joints = np.stack([h.posture_open for h in hands])[None].repeat(2, axis=0)
    quat = np.tile([1.0, 0, 0, 0], (2, 2, 1))
    # Crossed hands far above the table, then hands apart of which one stands in the table.
    pos = np.array([[[2.0, 0, 1], [2.0, 0.005, 1]], [[2.0, 0, 1], [3.0, 0, 0]]])
    on_table = (np.array([0, 0, HALF - 0.001]), AT_ORIGIN[1])  # the object itself sinks in a bit
    got = pregrasp_penetration(hands, box_solid(), SIZE, *on_table, pos, quat, joints, table=True)
    assert got.hand_object.tolist() == [0, 0]
    assert got.among_hands[0] > 0.001 > got.among_hands[1]
    assert got.table[0] == 0
    assert got.table[1] > 0.001


def test_a_warning_of_the_engine_leaves_no_file(hands, scene, tmp_path, monkeypatch):
    spec = scene_spec(hands, box_solid(), SIZE, scene.settings, table=False)
    spec.memory = 100_000  # room for less than half of the contacts
    model = spec.compile()
    small = dataclasses.replace(scene, model=model, data=mujoco.MjData(model))
    joints = np.stack([h.posture_open for h in hands])
    pose = (np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), joints)
    monkeypatch.chdir(tmp_path)
    measure_distances(small, *AT_ORIGIN, *pose)
    assert small.data.warning[mujoco.mjtWarning.mjWARN_CONTACTFULL].number > 0
    one = tuple(part[None] for part in pose)
    pregrasp_penetration(hands, box_solid(), SIZE, *AT_ORIGIN, *one, scene=small)
    assert list(tmp_path.iterdir()) == []


def test_the_fork_s_rule_leaves_out_the_last_body_of_the_left_hand_alone(scene):
    left = next(i for i, hand in enumerate(scene.hands) if hand.side == "left")
    last = len(scene.hands[left].body_names) - 1
    joints = np.stack([h.posture_open for h in scene.hands])
    rng, changed = np.random.default_rng(6), 0
    for _ in range(200):
        pos = np.array([[2.0, 0, 0], [2.0, 0, 0]]) + rng.uniform(-0.12, 0.12, (2, 3))
        pose = (*AT_ORIGIN, pos, random_quat(rng, (2,)), joints)
        every = measure_distances(scene, *pose).inter_hand
        ruled = measure_distances(scene, *pose, last_body_counts=False).inter_hand
        set_pose(scene, *pose)
        owners, geoms, dist, *_ = list_contacts(scene, 0.0, full_broad_phase=True)
        thumb = ((owners == left) & (scene.geom_body[geoms] == last)).any(axis=1)
        between = (owners[:, 0] != owners[:, 1]) & (owners < len(scene.hands)).all(axis=1) & ~thumb
        assert ruled == pytest.approx(np.min(dist[between], initial=0.0))
        assert every <= ruled
        changed += every < ruled
    assert changed
