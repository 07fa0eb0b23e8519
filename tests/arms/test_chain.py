"""Kinematics of chains against MuJoCo, pytorch-kinematics and finite differences."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from made_rig import arm_xml

from bidexdata.arms.assembly import arm_spec
from bidexdata.arms.chain import Chain, chain_forward, chain_frames, chain_jacobian, read_chain
from bidexdata.arms.inverse_kinematics import forward_on_device
from bidexdata.arms.robot import Arm, Robot
from bidexdata.arms.twisted_chain import twisted
from bidexdata.frames import (
    matrix_from_quat,
    quat_from_matrix,
    quat_from_rotation_vector,
    rotation_vector_from_quat,
)
from bidexdata.simulation.assembly import hand_prefix

EXACT = 1e-9  # both engines count in float64
SINGLE = 3e-6  # float32 at a reach of 1.5 m


def postures(arm: Arm, rng: np.random.Generator, count: int = 40) -> np.ndarray:
    chain = arm.chain
    random = rng.uniform(chain.lower, chain.upper, (count, chain.joints))
    zero = np.clip(0.0, chain.lower, chain.upper)
    return np.concatenate([random, [chain.lower, chain.upper, zero, chain.rest]])


def by_mujoco(robot: Robot, index: int, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    arm, hand = robot.arms[index], robot.hands[index]
    model = arm_spec(robot.rig.spec, index, arm.model, hand, arm.mount).compile()
    data = mujoco.MjData(model)
    names = {model.joint(j).name.rpartition("/")[2]: j for j in range(model.njnt)}
    address = [model.jnt_qposadr[names[n]] for n in arm.chain.joint_names]
    root = model.body(hand_prefix(index) + hand.root_body).id
    pos, rot = [], []
    for angles in q:
        data.qpos[:] = 0.0
        data.qpos[address] = angles
        mujoco.mj_kinematics(model, data)
        pos.append(data.xpos[root].copy())
        rot.append(data.xmat[root].reshape(3, 3).copy())
    return np.array(pos), np.array(rot)


@pytest.mark.parametrize("index", [0, 1])
def test_the_end_of_the_chain_is_the_hands_root_body_in_mujoco(robot, index, rng):
    q = postures(robot.arms[index], rng)
    pos, rot = chain_forward(robot.arms[index].chain, q)
    expected = by_mujoco(robot, index, q)
    np.testing.assert_allclose(pos, expected[0], atol=EXACT)
    np.testing.assert_allclose(rot, expected[1], atol=EXACT)


@pytest.mark.parametrize("index", [0, 1])
def test_the_kernels_place_the_hand_where_the_reference_does(robot, index, rng):
    chain = robot.arms[index].chain
    q = postures(robot.arms[index], rng)
    pos, rot = forward_on_device(chain, q)
    expected = chain_forward(chain, q)
    np.testing.assert_allclose(pos, expected[0], atol=SINGLE)
    np.testing.assert_allclose(rot, expected[1], atol=SINGLE)


def turns(axis: str, angles: np.ndarray) -> np.ndarray:
    return matrix_from_quat(
        quat_from_rotation_vector(angles[..., None] * np.eye(3)["xyz".index(axis)])
    )


def assert_twisted_is_the_same(chain: Chain, q: np.ndarray) -> None:
    form = twisted(chain)
    pos, rot = np.zeros((len(q), 3)), np.tile(form.first_rot, (len(q), 1, 1))
    for j in range(chain.joints):
        pos = pos + rot @ form.before_pos[j]
        rot = rot @ turns("x", form.twist[j : j + 1]) @ turns("z", q[:, j] + form.offset[j])
    expected = chain_forward(chain, q)
    np.testing.assert_allclose(pos + rot @ form.end_pos, expected[0], atol=EXACT)
    np.testing.assert_allclose(rot @ form.end_rot, expected[1], atol=EXACT)


def test_a_twisted_chain_places_the_hand_where_the_chain_does(robot, rng):
    for arm in robot.arms:
        assert_twisted_is_the_same(arm.chain, postures(arm, rng))


@pytest.mark.parametrize("slant", [0.0, 1e-12, 1e-8, 1e-3, 1.0])
def test_a_twisted_chain_may_have_axes_of_any_direction(made, rng, slant):
    chain = made.arms[0].chain
    edges = [[0, 0, 1], [0, 0, 1], [0, 0, -1], [1, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0]]
    axis = np.array(edges) + slant * rng.normal(size=(7, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    random = matrix_from_quat(quat_from_rotation_vector(rng.normal(size=(7, 3))))
    for before in (np.tile(np.eye(3), (7, 1, 1)), turns("y", np.full(7, np.pi / 2)), random):
        some = replace(chain, axis=axis, before_rot=before)
        assert_twisted_is_the_same(some, postures(made.arms[0], rng))


def test_the_jacobian_is_the_central_difference(robot, rng):
    chain, step = robot.arms[0].chain, 1e-6
    for q in postures(robot.arms[0], rng, 8):
        ahead, back = (chain_forward(chain, q + s * step * np.eye(chain.joints)) for s in (1, -1))
        linear = (ahead[0] - back[0]) / (2 * step)
        turn = quat_from_matrix(ahead[1] @ np.swapaxes(back[1], -1, -2))
        angular = rotation_vector_from_quat(turn) / (2 * step)
        expected = np.concatenate([linear, angular], axis=1).T
        np.testing.assert_allclose(chain_jacobian(chain, q), expected, atol=1e-7)


def test_pytorch_kinematics_places_and_moves_the_hand_in_the_same_way(robot, rng):
    import pytorch_kinematics as pk
    import torch
    from chain_urdf import chain_urdf

    chain = robot.arms[1].chain
    theirs = pk.build_serial_chain_from_urdf(chain_urdf(chain), "end").to(dtype=torch.float64)
    q = postures(robot.arms[1], rng)
    T = theirs.forward_kinematics(torch.as_tensor(q)).get_matrix().numpy()
    pos, rot = chain_forward(chain, q)
    np.testing.assert_allclose(T[:, :3, 3], pos, atol=2e-6)
    np.testing.assert_allclose(T[:, :3, :3], rot, atol=2e-6)
    # Both Jacobians are of the hand's origin in the frame that the chain begins in.
    J = theirs.jacobian(torch.as_tensor(q)).numpy()
    np.testing.assert_allclose(J, chain_jacobian(chain, q), atol=5e-6)


def test_a_batch_is_its_rows(robot, rng):
    chain = robot.arms[0].chain
    q = postures(robot.arms[0], rng, 5)
    whole = chain_frames(chain, q.reshape(3, -1, chain.joints))
    for k, row in enumerate(q):
        pos, rot = chain_frames(chain, row)
        np.testing.assert_array_equal(whole[0].reshape(-1, chain.joints, 3)[k], pos)
        np.testing.assert_array_equal(whole[1].reshape(-1, chain.joints, 3, 3)[k], rot)


def test_a_joint_beside_its_bodys_origin_turns_about_its_own_axis(rng):
    xml = arm_xml().replace('name="j3"', 'name="j3" pos="0.05 0.02 -0.03"')
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    chain = read_chain(model, "link7", np.zeros(7), np.ones(7))
    for q in rng.uniform(chain.lower, chain.upper, (20, 7)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        pos, rot = chain_forward(chain, q)
        np.testing.assert_allclose(pos, data.body("link7").xpos, atol=EXACT)
        np.testing.assert_allclose(rot, data.body("link7").xmat.reshape(3, 3), atol=EXACT)


def test_the_made_up_arms_are_mirror_images(made, rng):
    left, right = (arm.chain for arm in made.arms)
    sign = np.array([-1, 1, -1, 1, -1, 1, -1.0])
    q = rng.uniform(left.lower, left.upper, (20, 7))
    there, here = chain_forward(left, q)[0], chain_forward(right, sign * q)[0]
    np.testing.assert_allclose(there * [1, -1, 1], here, atol=1e-6)
