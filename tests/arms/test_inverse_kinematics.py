"""Inverse kinematics: what forward kinematics gives back, half turns, limits, order and engines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from bidexdata.arms.chain import Chain, chain_forward
from bidexdata.arms.ik_reference import descend_reference
from bidexdata.arms.inverse_kinematics import (
    IkConfig,
    follow,
    solve_first,
    solve_ik,
    start_postures,
)
from bidexdata.arms.registry import load_rig, rig_names
from bidexdata.arms.robot import mount_robot
from bidexdata.frames import (
    matrix_from_quat,
    quat_from_matrix,
    quat_from_rotation_vector,
    rotation_vector_from_quat,
    rotation_with_z,
)
from bidexdata.hands import load_hands

CONFIG = IkConfig()
HALF = np.radians(0.5)


def targets(chain: Chain, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    return chain_forward(chain, rng.uniform(chain.lower, chain.upper, (count, chain.joints)))


def true_errors(chain, q, pos, rot):
    at, turned = chain_forward(chain, q)
    turn = quat_from_matrix(rot @ np.swapaxes(turned, -1, -2))
    angle = np.linalg.norm(rotation_vector_from_quat(turn), axis=-1)
    return np.linalg.norm(at - pos, axis=-1), angle


def test_99_of_100_reachable_poses_are_solved_to_1_mm_and_half_a_degree(robot, rng, device):
    for arm in robot.arms:
        pos, rot = targets(arm.chain, rng, 500)
        found = solve_first(arm.chain, pos, rot, CONFIG, device=device)
        off, angle = true_errors(arm.chain, found.q, pos, rot)
        assert np.mean((off < 1e-3 + 1e-6) & (angle < HALF + 1e-5)) >= 0.99
        # What the kernel says of its errors is true.
        np.testing.assert_allclose(found.error_pos, off, atol=1e-5)
        np.testing.assert_allclose(found.error_rot, angle, atol=2e-3)
        assert np.all((found.q >= arm.chain.lower) & (found.q <= arm.chain.upper))


@pytest.mark.slow
@pytest.mark.parametrize("name", rig_names())
def test_every_rig_of_the_package_solves_99_of_100_reachable_poses_with_16_starts(
    name, rng, menagerie, real_hands
):
    assert CONFIG.starts == 16
    robot = mount_robot(load_rig(name), load_hands(real_hands[name]))
    for arm in robot.arms:
        pos, rot = targets(arm.chain, rng, 4000)
        found = solve_first(arm.chain, pos, rot, CONFIG)
        off, angle = true_errors(arm.chain, found.q, pos, rot)
        inside = ((found.q >= arm.chain.lower) & (found.q <= arm.chain.upper)).all(axis=1)
        assert np.mean((off < 1e-3 + 1e-6) & (angle < HALF + 1e-5) & inside) >= 0.99


def test_the_wrist_joints_of_the_shadow_hand_belong_to_the_chain(robot):
    if robot.rig.spec.name == "made":
        pytest.skip("the capsule hand has no wrist")
    assert [arm.chain.joint_names[-2:] for arm in robot.arms] == [
        ("lh_WRJ2", "lh_WRJ1"),
        ("rh_WRJ2", "rh_WRJ1"),
    ]


def edge_turns() -> np.ndarray:
    turns = [np.diag(d) for d in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
    axes = [rotation_with_z(s * e) for e in np.eye(3) for s in (1.0, -1.0)]
    return np.array([np.eye(3), *turns, *axes], np.float64)


def test_targets_an_exact_half_turn_away_are_solved(robot, rng):
    # The error's logarithm has no direction of its own there: an engine that takes the sign of a
    # zero for it stands still. The roll of the flange from -90 to 90 degrees is such a turn.
    for arm in robot.arms:
        chain = arm.chain
        roll = chain.joints - chain.wrist - 1
        q = chain.rest + 0.2 * rng.uniform(-1, 1, (40, chain.joints))
        q = np.clip(q, chain.lower, chain.upper)
        q[:, roll] = np.pi / 2
        pos, rot = chain_forward(chain, q)
        q[:, roll] = -np.pi / 2
        there = chain_forward(chain, q)[1]
        angle = np.arccos(np.clip((np.einsum("nij,nij->n", rot, there) - 1) / 2, -1, 1))
        np.testing.assert_allclose(angle, np.pi, atol=1e-7)
        alone = [
            solve_ik(chain, pos[k : k + 1], rot[k : k + 1], CONFIG, starts=q[k : k + 1])
            for k in range(len(q))
        ]
        assert all(found.iterations[0, 0] > 1 for found in alone)
        # One way round may end at a limit, and either is right; the hand turns in any case.
        assert all(found.error_rot[0, 0] < np.pi - 0.1 for found in alone)
        assert solve_first(chain, pos, rot, CONFIG).ok.all()


def test_the_logarithm_of_the_kernels_is_that_of_the_frames(rng):
    from bidexdata.arms.chain_kernels import take_logarithms

    near = [0.0, 1e-9, 1e-6, 1e-4, 1e-3, 0.1, 1.0, 3.0, np.pi - 1e-2, np.pi - 1e-4, np.pi]
    axes = np.concatenate(
        [rng.normal(size=(20, 3)), np.eye(3), -np.eye(3), [[1, 1, 0], [1, -1, 0]]]
    )
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    vectors = (axes[:, None] * np.array(near)[:, None]).reshape(-1, 3)
    rot = np.concatenate([matrix_from_quat(quat_from_rotation_vector(vectors)), edge_turns()])
    log = wp.full(len(rot), wp.vec3(np.nan, np.nan, np.nan), dtype=wp.vec3)
    given = wp.array(rot.astype(np.float32), dtype=wp.mat33, shape=(len(rot),))
    wp.launch(take_logarithms, dim=len(rot), inputs=[given, log])
    expected = rotation_vector_from_quat(quat_from_matrix(rot))
    found = log.numpy()
    # At a half turn both signs of the axis are right; near it float32 decides.
    same = np.linalg.norm(found - expected, axis=1)
    opposite = np.linalg.norm(found + expected, axis=1)
    turn = np.linalg.norm(expected, axis=1)
    off = np.where(turn > np.pi - 1e-3, np.minimum(same, opposite), same)
    assert off.max() < 3e-3
    assert off[turn < 3.0].max() < 1e-5


def test_poses_at_the_limits_are_solved(robot):
    for arm in robot.arms:
        chain = arm.chain
        corners = np.array([chain.lower, chain.upper])
        pos, rot = chain_forward(chain, corners)
        starts = np.concatenate([start_postures(chain, 256), 0.9 * corners + 0.1 * chain.rest])
        found = solve_first(chain, pos, rot, CONFIG, starts=starts)
        assert found.ok.all()
        assert np.all((found.q >= chain.lower) & (found.q <= chain.upper))


def test_a_target_2_m_away_is_refused_with_finite_numbers(robot):
    for arm in robot.arms:
        pos, rot = chain_forward(arm.chain, arm.chain.rest)
        far = (pos + np.array([2.0, 0, 0]))[None]
        found = solve_ik(arm.chain, far, rot[None], CONFIG)
        assert not found.ok.any()
        assert all(np.isfinite(np.asarray(x)).all() for x in found)
        assert solve_first(arm.chain, far, rot[None], CONFIG).tried == CONFIG.starts


@pytest.mark.parametrize("count", [0, 1, 7, 33])
def test_a_batch_gives_what_its_rows_give_in_any_order(made, rng, count, device):
    chain = made.arms[0].chain
    pos, rot = targets(chain, rng, count)
    whole = solve_ik(chain, pos, rot, CONFIG, device=device)
    assert whole.q.shape == (count, CONFIG.starts, chain.joints)
    order = rng.permutation(count)
    turned = solve_ik(chain, pos[order], rot[order], CONFIG, device=device)
    for name in whole._fields:
        np.testing.assert_array_equal(getattr(turned, name), getattr(whole, name)[order])
    for k in range(min(count, 5)):
        one = solve_ik(chain, pos[k : k + 1], rot[k : k + 1], CONFIG, device=device)
        np.testing.assert_array_equal(one.q[0], whole.q[k])
    first = solve_first(chain, pos, rot, CONFIG, device=device)
    for k in np.flatnonzero(first.ok):
        np.testing.assert_array_equal(first.q[k], whole.q[k, first.tried[k] - 1])


def test_the_kernels_do_what_the_float64_reference_does(robot, rng, device):
    chain = robot.arms[0].chain
    pos, rot = targets(chain, rng, 40)
    start = 0.5 * (chain.lower + chain.upper)
    # Tight, so that both come to rest at the same place of a branch.
    config = replace(CONFIG, tolerance_pos=1e-5, tolerance_rot=1e-4, rest_gain=0.0, iterations=40)
    found = solve_ik(chain, pos, rot, config, starts=start[None], device=device)
    same = 0
    for k in range(len(pos)):
        expected = descend_reference(chain, pos[k], rot[k], start, config)
        good = expected.error_pos < 1e-3 and expected.error_rot < HALF
        same += good == bool(found.ok[k, 0])
        if good and found.ok[k, 0] and expected.iterations == found.iterations[k, 0]:
            # Where joints are redundant float32 drifts along the set of solutions.
            assert np.abs(expected.q - found.q[k, 0]).max() < 0.02
    # A path that passes close to a singularity may end elsewhere in float32.
    assert same >= 0.9 * len(pos)


def test_from_the_solution_itself_there_is_nothing_to_do(robot, rng):
    chain = robot.arms[0].chain
    q = rng.uniform(chain.lower, chain.upper, (10, chain.joints))
    pos, rot = chain_forward(chain, q)
    for k in range(len(q)):
        found = solve_ik(chain, pos[k : k + 1], rot[k : k + 1], CONFIG, starts=q[k : k + 1])
        assert found.iterations[0, 0] <= 1
        assert found.ok[0, 0]


def test_manipulability_is_the_root_of_the_determinant(made, rng):
    from bidexdata.arms.chain import chain_jacobian

    chain = made.arms[0].chain
    found = solve_first(chain, *targets(chain, rng, 20), CONFIG)
    J = chain_jacobian(chain, found.q)
    J[:, 3:] *= CONFIG.length
    expected = np.sqrt(np.linalg.det(J @ np.swapaxes(J, 1, 2)))
    np.testing.assert_allclose(found.manipulability, expected, rtol=0.02, atol=2e-5)


def test_the_pull_to_rest_brings_redundant_joints_nearer_to_rest(robot, rng):
    chain = robot.arms[0].chain
    if chain.joints < 7:
        pytest.skip("no redundant joint")
    pos, rot = targets(chain, rng, 200)
    apart = []
    for gain in (0.0, 0.3):
        found = solve_ik(chain, pos, rot, replace(CONFIG, rest_gain=gain, iterations=60))
        distance = np.linalg.norm(found.q - chain.rest, axis=-1)
        apart.append(np.where(found.ok, distance, np.inf).min(axis=1))
    both = np.isfinite(apart[0]) & np.isfinite(apart[1])
    assert apart[1][both].mean() < apart[0][both].mean()


def test_following_reaches_every_waypoint_without_a_jump_near_a_good_posture(robot, device):
    for arm in robot.arms:
        chain = arm.chain
        pos, rot = chain_forward(chain, chain.rest)
        lift = pos + np.linspace(0, 0.1, 6)[1:, None] * [0, 0, 1.0]
        turns = np.tile(rot, (1, 5, 1, 1))
        paths = follow(chain, chain.rest[None, None], lift[None], turns, CONFIG, device=device)
        assert paths.reached[0, 0] == 5
        assert paths.step.max() < CONFIG.jump
        off, angle = true_errors(chain, paths.q[0, 0], lift, np.tile(rot, (5, 1, 1)))
        assert off.max() < 1e-3
        assert angle.max() < HALF


def test_following_stops_at_the_first_waypoint_out_of_reach_and_says_where(made, device):
    chain = made.arms[0].chain
    pos, rot = chain_forward(chain, chain.rest)
    line = pos + np.array([0.01, 0.02, 3.0, 0.03])[:, None] * [0, 0, 1.0]
    q = np.stack([chain.rest, chain.rest])[None]
    paths = follow(chain, q, line[None], np.tile(rot, (1, 4, 1, 1)), CONFIG, device=device)
    assert paths.reached.tolist() == [[2, 2]]
    assert np.isfinite(paths.q[0, :, :3]).all()
    assert np.isnan(paths.q[0, :, 3]).all()
    np.testing.assert_array_equal(paths.q[0, 0], paths.q[0, 1])


def test_starts_lie_in_the_limits_and_the_first_of_many_are_those_of_few(robot):
    chain = robot.arms[1].chain
    many = start_postures(chain, 256)
    assert np.all((many >= chain.lower) & (many <= chain.upper))
    np.testing.assert_array_equal(many[:16], start_postures(chain, 16))
    np.testing.assert_array_equal(many[0], chain.rest)
    assert len(np.unique(many, axis=0)) == 256


def mink_solutions(robot, pos, rot, start) -> np.ndarray:
    """Which poses mink brings the left hand to from one posture, by daqp, in 60 iterations at most."""
    mink = pytest.importorskip("mink", reason="needs mink, of the extra dev")
    pytest.importorskip("daqp", reason="needs daqp, of the extra dev")
    from bidexdata.arms.assembly import arm_spec

    arm, hand = robot.arms[0], robot.hands[0]
    model = arm_spec(robot.rig.spec, 0, arm.model, hand, arm.mount).compile()
    names = [model.joint(j).name.rpartition("/")[2] for j in range(model.njnt)]
    address = [names.index(n) for n in arm.chain.joint_names]
    still = [j for j in range(model.nv) if j not in address]
    task = mink.FrameTask(
        f"hand0/{hand.root_body}", "body", position_cost=1.0, orientation_cost=0.3, lm_damping=1e-6
    )
    solved = np.zeros(len(pos), bool)
    for k in range(len(pos)):
        configuration = mink.Configuration(model)
        q = np.zeros(model.nq)
        q[address] = start[k]
        configuration.update(q)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rot[k], pos[k]
        task.set_target(mink.SE3.from_matrix(T))
        for _ in range(60):
            error = task.compute_error(configuration)
            if np.linalg.norm(error[:3]) < 1e-3 and np.linalg.norm(error[3:]) < HALF:
                solved[k] = True
                break
            limits = [mink.ConfigurationLimit(model)]
            frozen = mink.DofFreezingTask(model, dof_indices=still)
            speed = mink.solve_ik(
                configuration, [task], 1.0, solver="daqp", limits=limits, constraints=[frozen]
            )
            configuration.integrate_inplace(speed, 1.0)
    return solved


def test_mink_comes_back_to_what_we_solve(robot, rng):
    chain = robot.arms[0].chain
    pos, rot = targets(chain, rng, 30)
    ours = solve_first(chain, pos, rot, CONFIG)
    shaken = ours.q + 0.05 * rng.normal(size=ours.q.shape)
    theirs = mink_solutions(robot, pos, rot, np.clip(shaken, chain.lower, chain.upper))
    assert (theirs & ours.ok).sum() >= 0.9 * ours.ok.sum()


def test_we_solve_whatever_mink_solves_from_the_rest_posture(robot, rng):
    chain = robot.arms[0].chain
    pos, rot = targets(chain, rng, 40)
    theirs = mink_solutions(robot, pos, rot, np.tile(chain.rest, (len(pos), 1)))
    ours = solve_first(chain, pos, rot, CONFIG)
    assert theirs.sum() >= 8  # one start does not solve them all, and none would say nothing
    assert ours.ok[theirs].all()
