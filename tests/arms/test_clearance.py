"""Spheres against the geometry that they stand for, and clearance kernels against NumPy."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from bidexdata.arms.arm_spheres import TOLERANCE, place_spheres, shape_spheres
from bidexdata.arms.assembly import arm_spec
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.clearance import (
    FAR,
    apart_at,
    clear_at,
    clear_together,
    clearance_between,
    clearances,
    room_of_ways,
)
from bidexdata.arms.clearance_reference import clearances_reference, held_spheres
from bidexdata.arms.surroundings import HeldHands, Placed, Surroundings
from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.hands.geometry import body_shapes, surface_samples
from bidexdata.hands.kinematics import hand_points
from bidexdata.objects.distance_field import signed_distance
from bidexdata.objects.prepared import SignedDistanceGrid

SINGLE = 2e-5  # float32 at a metre, through a grid


def ball(radius: float = 0.3) -> SignedDistanceGrid:
    """The signed distance of a ball, exact at the nodes."""
    axis = np.linspace(-0.5, 0.5, 41)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    values = (np.linalg.norm(points, axis=-1) - radius).astype(np.float32)
    return SignedDistanceGrid(values, np.full(3, -0.5), 0.025)


def configurations(arm, rng, shape):
    chain = arm.chain
    return rng.uniform(chain.lower, chain.upper, (*shape, chain.joints))


def held_hands(hand, rng, count: int) -> HeldHands:
    joints = rng.uniform(hand.joint_lower, hand.joint_upper, (count, len(hand.joint_names)))
    return HeldHands(hand_points(hand, joints).sphere, hand.sphere_radius)


def placed(rng, count: int) -> Placed:
    rot = matrix_from_quat(random_quat(rng, (count,)))
    pos = rng.uniform(-0.3, 0.3, (count, 3)) + np.array([0, 0, 0.3])
    return Placed(ball(), rng.uniform(0.3, 0.8, count), pos, rot)


def test_no_part_of_a_link_stands_farther_out_of_its_spheres_than_the_tolerance(robot):
    for index, arm in enumerate(robot.arms):
        hand = robot.hands[index]
        model = arm_spec(robot.rig.spec, index, arm.model, hand, arm.mount).compile()
        for body, shapes in enumerate(body_shapes(model), start=1):
            name = model.body(body).name.rpartition("/")[2]
            if name not in arm.spheres.part or not shapes:
                continue
            centre, radius = shape_spheres(shapes)
            points = surface_samples(shapes, 0.01)[0]
            apart = np.linalg.norm(points[:, None] - centre, axis=-1) - radius
            assert apart.min(axis=1).max() < TOLERANCE, name


def test_spheres_move_with_their_links(robot, rng):
    arm = robot.arms[1]
    model = arm_spec(robot.rig.spec, 1, arm.model, robot.hands[1], arm.mount).compile()
    data = mujoco.MjData(model)
    names = [model.joint(j).name.rpartition("/")[2] for j in range(model.njnt)]
    bodies = {model.body(b).name.rpartition("/")[2]: b for b in range(model.nbody)}
    home = place_spheres(arm.chain, arm.spheres, np.zeros(arm.chain.joints))
    mujoco.mj_kinematics(model, data)
    local = [
        data.xmat[bodies[p]].reshape(3, 3).T @ (home[k] - data.xpos[bodies[p]])
        for k, p in enumerate(arm.spheres.part)
    ]
    for q in configurations(arm, rng, (5,)):
        data.qpos[[names.index(n) for n in arm.chain.joint_names]] = q
        mujoco.mj_kinematics(model, data)
        expected = [
            data.xpos[bodies[p]] + data.xmat[bodies[p]].reshape(3, 3) @ local[k]
            for k, p in enumerate(arm.spheres.part)
        ]
        found = place_spheres(arm.chain, arm.spheres, q)
        np.testing.assert_allclose(found, np.array(expected), atol=1e-9)


@pytest.mark.parametrize("shape", [(1,), (7, 3), (5, 2, 4), (0, 3)])
def test_the_kernels_give_what_the_reference_gives(robot, rng, shape, device):
    for arm in robot.arms:
        q = configurations(arm, rng, shape)
        around = placed(rng, shape[0])
        found, expected = (
            clearances(arm, q, around, device=device),
            clearances_reference(arm, q, around),
        )
        for name in found._fields:
            np.testing.assert_allclose(
                getattr(found, name), getattr(expected, name), atol=SINGLE, err_msg=name
            )


@pytest.mark.parametrize("shape", [(1,), (5, 3), (4, 2, 3)])
def test_hands_count_where_they_are_given(robot, rng, shape, device):
    for arm, hand in zip(robot.arms, robot.hands, strict=True):
        q, around = configurations(arm, rng, shape), placed(rng, shape[0])
        held = held_hands(hand, rng, shape[0])
        found = clearances(arm, q, around, held, device=device)
        expected = clearances_reference(arm, q, around, held)
        for name in found._fields:
            np.testing.assert_allclose(
                getattr(found, name), getattr(expected, name), atol=SINGLE, err_msg=name
            )
        alone = clearances(arm, q, around, device=device)
        assert np.all(found.obj <= alone.obj)
        assert np.all(found.table <= alone.table)


def test_clearances_that_need_not_be_known_are_given_as_the_most(made, rng, device):
    left, right = (configurations(arm, rng, (30,)) for arm in made.arms)
    held = tuple(held_hands(hand, rng, 30) for hand in made.hands)
    around, rows = Surroundings(placed(rng, 30), held, rows=30, device=device), np.arange(30)
    whole = clear_at(made.arms[0], left, rows, around)
    between = apart_at(made.arms, left, right, (rows, rows), around)
    for most in (-0.05, 0.0, 0.03, 0.2):
        near = clear_at(made.arms[0], left, rows, around, most=most)
        np.testing.assert_allclose(near, np.minimum(whole, most), atol=1e-7)
        near = apart_at(made.arms, left, right, (rows, rows), around, most=most)
        np.testing.assert_allclose(near, np.minimum(between, most), atol=1e-7)


def test_room_along_a_way_is_that_of_the_hands_spheres(made, rng, device):
    count, checks = 7, 6
    held = held_hands(made.hands[0], rng, count)
    around = placed(rng, count)
    near = Surroundings(around, (held, None), rows=count, device=device)
    pos = around.pos + rng.uniform(-0.4, 0.4, (count, 3))
    rot, lines = matrix_from_quat(random_quat(rng, (count,))), rng.normal(size=(count, 3, 3)) * 0.1
    rows = np.arange(count)
    room, start = room_of_ways(near, 0, rows, pos, rot, lines, checks)
    at = np.linspace(0, 1, checks + 1)[:, None, None]
    for n, k in np.ndindex(count, 3):
        balls = held.pos[n] @ rot[n].T + pos[n] + at * lines[n, k]
        x = (balls - around.pos[n]) @ around.rot[n]
        distance = signed_distance(around.field, float(around.size[n]), x.reshape(-1, 3))[0]
        gaps = (distance.reshape(len(at), -1) - held.radius).min(axis=1)
        assert abs(start[n, k] - gaps[0]) < SINGLE
        assert abs(room[n, k] - gaps[1:].min()) < SINGLE


def test_spheres_of_hands_move_as_the_hand_does(robot, rng):
    arm, hand = robot.arms[0], robot.hands[0]
    q, held = configurations(arm, rng, (3, 2)), held_hands(hand, rng, 3)
    pos, rot = chain_forward(arm.chain, q)
    for n, k in np.ndindex(3, 2):
        expected = held.pos[n] @ rot[n, k].T + pos[n, k]
        np.testing.assert_allclose(held_spheres(arm, q, held)[n, k], expected, atol=1e-12)


def test_between_two_arms_hands_count_where_they_are_given(robot, rng, device):
    shapes = ((4, 2), (3, 1))
    qs = [configurations(arm, rng, n) for arm, n in zip(robot.arms, shapes, strict=True)]
    held = tuple(held_hands(h, rng, n[0]) for h, n in zip(robot.hands, shapes, strict=True))
    pairs = np.array([[0, 0], [7, 2], [3, 1], [6, 1]], np.int32)
    found = clearance_between(robot.arms, qs[0], qs[1], pairs, held, device=device)
    centre, radius = [], []
    for arm, q, hand in zip(robot.arms, qs, held, strict=True):
        balls = [place_spheres(arm.chain, arm.spheres, q), held_spheres(arm, q, hand)]
        centre.append(np.concatenate(balls, axis=-2).reshape(q.shape[0] * q.shape[1], -1, 3))
        radius.append(np.concatenate([arm.spheres.radius, hand.radius]))
    for k, (a, b) in enumerate(pairs):
        gaps = np.linalg.norm(centre[0][a][:, None] - centre[1][b], axis=-1)
        assert abs(found[k] - (gaps - radius[0][:, None] - radius[1]).min()) < SINGLE


def test_without_an_object_it_is_far(made, rng):
    q = configurations(made.arms[0], rng, (3,))
    assert np.all(clearances(made.arms[0], q, None).obj == FAR)


def test_between_two_arms_it_is_the_least_gap_of_two_spheres(robot, rng, device):
    left, right = (
        configurations(arm, rng, (n,)) for arm, n in zip(robot.arms, (4, 3), strict=True)
    )
    pairs = np.array([[0, 0], [3, 2], [1, 2], [1, 0]], np.int32)
    found = clearance_between(robot.arms, left, right, pairs, device=device)
    centre = [
        place_spheres(arm.chain, arm.spheres, q)
        for arm, q in zip(robot.arms, (left, right), strict=True)
    ]
    radius = [arm.spheres.radius for arm in robot.arms]
    for k, (a, b) in enumerate(pairs):
        gaps = np.linalg.norm(centre[0][a][:, None] - centre[1][b], axis=-1)
        expected = (gaps - radius[0][:, None] - radius[1]).min()
        assert abs(found[k] - expected) < SINGLE


def test_links_that_mujoco_sees_overlap_are_not_clear_by_spheres(robot, rng):
    # The spheres' word is cheaper, not kinder: a self-collision deeper than what spheres leave
    # uncovered is never called clear.
    arm = robot.arms[0]
    hand = robot.hands[0]
    model = arm_spec(robot.rig.spec, 0, arm.model, hand, arm.mount).compile()
    data = mujoco.MjData(model)
    names = [model.joint(j).name.rpartition("/")[2] for j in range(model.njnt)]
    own = np.array([model.body(b).name.rpartition("/")[2] in arm.spheres.part
                    for b in range(model.nbody)])  # fmt: skip
    # Many joints at their limits, where arms are folded.
    share = np.clip(3 * rng.random((2000, arm.chain.joints)) - 1, 0, 1)
    q = arm.chain.lower + share * (arm.chain.upper - arm.chain.lower)
    gaps = clearances(arm, q, None).itself
    seen = 0
    for k in range(len(q)):
        data.qpos[[names.index(n) for n in arm.chain.joint_names]] = q[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        bodies = model.geom_bodyid[data.contact.geom]
        depth = -data.contact.dist[own[bodies].all(axis=1)]
        if len(depth) and depth.max() > TOLERANCE:
            seen += 1
            assert gaps[k] < 0.0
    assert seen > 0


def test_a_lower_table_is_farther_by_as_much(made, rng, device):
    arm = made.arms[0]
    q = configurations(arm, rng, (6,))
    raised = arm.chain.before_pos.copy()
    raised[0, 2] += 0.1
    higher = replace(arm, chain=replace(arm.chain, before_pos=raised))
    np.testing.assert_allclose(
        clearances(higher, q, None, device=device).table,
        clearances(arm, q, None, device=device).table + 0.1,
        atol=1e-5,
    )


@pytest.mark.parametrize("hands", [True, False])
@pytest.mark.parametrize("count", [0, 1, 7])
def test_two_arms_together_have_the_least_clearance_of_each_and_of_both(robot, rng, count, hands):
    """Whatever the cap, bit for bit: the spheres are the same."""
    held = tuple(held_hands(hand, rng, 3) for hand in robot.hands)
    around = Surroundings(placed(rng, 3), held, rows=3)
    left, right = (configurations(arm, rng, (count,)) for arm in robot.arms)
    rows = rng.integers(0, 3, count)
    for most in (FAR, 0.03):
        found = clear_together(
            robot.arms, left, right, rows, around, with_hands=hands, most=(most, 0.5 * most)
        )
        apart = apart_at(robot.arms, left, right, (rows, rows), around, with_hands=hands, most=most)
        np.testing.assert_array_equal(found.apart, apart)
        alone = [
            clear_at(arm, q, rows, around, side, with_hand=hands, most=0.5 * most).min(axis=0)
            for side, (arm, q) in enumerate(zip(robot.arms, (left, right), strict=True))
        ]
        np.testing.assert_array_equal(found.alone, np.min(alone, axis=0))


def test_no_sphere_goes_farther_than_the_way_and_one_goes_as_far(robot, rng):
    held = tuple(held_hands(hand, rng, 1) for hand in robot.hands)
    around = Surroundings(None, held, rows=1)
    left, right = (configurations(arm, rng, (5,)) for arm in robot.arms)
    rows = np.zeros(5, np.int64)
    found = clear_together(robot.arms, left, right, rows, around).way
    for side, (arm, q) in enumerate(zip(robot.arms, (left, right), strict=True)):
        one = HeldHands(np.repeat(held[side].pos, 5, axis=0), held[side].radius)
        centre = np.concatenate(
            [place_spheres(arm.chain, arm.spheres, q), held_spheres(arm, q[:, None], one)[:, 0]], 1
        )
        ways = np.linalg.norm(np.diff(centre, axis=0), axis=2).max(axis=1)
        # The balls round groups of spheres go with them.
        assert np.all(found[side] >= ways - SINGLE)
        assert np.all(found[side] <= 1.05 * ways + SINGLE)
