"""Forward kinematics: four engines agree; gradients are differences."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
import warp as wp

from bidexdata.frames import matrix_from_quat, quat_from_rotation_vector, quat_multiply, random_quat
from bidexdata.hands.device import (
    allocate,
    backward,
    device_hand,
    forward,
    free_limits,
)
from bidexdata.hands.kinematics import forward_kinematics, hand_points
from bidexdata.hands.torch_layer import HandModel
from bidexdata.synthesis.workspace import free_variables

METRES = 1e-5  # the bound; float32 at a metre resolves 1e-7
HALF_TURNS = np.eye(4)  # identity and the half turns about x, y, z
DEVICES = ["cpu", *(["cuda:0"] if torch.cuda.is_available() else [])]


def test_reference_places_every_body_where_mujoco_does(hand, edge_joints):
    model = hand.make_spec().compile()
    data = mujoco.MjData(model)
    joints = edge_joints(hand, 50)
    pos, rot = forward_kinematics(hand, joints)
    for i, q in enumerate(joints):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(pos[i], data.xpos[1:], atol=1e-12)
        np.testing.assert_allclose(rot[i].reshape(-1, 9), data.xmat[1:], atol=1e-12)


def test_arrays_name_what_the_model_names(hand):
    model = hand.make_spec().compile()
    assert hand.body_names == tuple(model.body(i).name for i in range(1, model.nbody))
    assert hand.joint_names == tuple(model.jnt(i).name for i in range(model.njnt))
    assert hand.actuator_names == tuple(model.actuator(i).name for i in range(model.nu))
    np.testing.assert_array_equal(hand.joint_lower, model.jnt_range[:, 0])
    np.testing.assert_array_equal(hand.joint_upper, model.jnt_range[:, 1])


def test_actuator_length_is_moment_times_joints(hand, edge_joints):
    model = hand.make_spec().compile()
    data = mujoco.MjData(model)
    for q in edge_joints(hand, 5):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(hand.actuator_moment @ q, data.actuator_length, atol=1e-12)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("count", [0, 1, 301])
def test_kernel_agrees_with_mujoco(hand, rng, device, count, edge_joints):
    # Without coupling, so that J1 and J2 differ too.
    uncoupled = replace(hand, coupling=np.eye(len(hand.joint_names)))
    joints = edge_joints(hand, 300)[::-1][:count]
    pos, quat = _bases(rng, count)
    state, _ = _run(uncoupled, device, pos, quat, joints)
    _assert_mujoco_agrees(hand, pos, quat, joints, state.body_pos.numpy(), state.body_rot.numpy())
    expected = hand_points(hand, joints, pos, quat)
    np.testing.assert_allclose(state.contact.numpy(), expected.contact, atol=METRES)
    np.testing.assert_allclose(state.normal.numpy(), expected.normal, atol=METRES)
    np.testing.assert_allclose(state.sphere.numpy(), expected.sphere, atol=METRES)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_torch_layer_agrees_with_mujoco(hand, rng, dtype, edge_joints):
    joints = edge_joints(hand, 60)
    pos, quat = _bases(rng, len(joints))
    inputs = [torch.as_tensor(x, dtype=dtype) for x in (pos, quat, joints)]
    pose = HandModel(hand)(*inputs)
    _assert_mujoco_agrees(hand, pos, quat, joints, pose.body_pos.numpy(), pose.body_rot.numpy())
    expected = hand_points(hand, joints, pos, quat)
    np.testing.assert_allclose(pose.contact_point.numpy(), expected.contact, atol=METRES)
    np.testing.assert_allclose(pose.contact_normal.numpy(), expected.normal, atol=METRES)
    np.testing.assert_allclose(pose.sphere_pos.numpy(), expected.sphere, atol=METRES)


def test_torch_layer_takes_any_batch_and_its_gradient_is_the_difference(rng):
    from bidexdata.hands import load_hand

    hand = load_hand("capsule", "left")
    model = HandModel(hand)
    joints = torch.tensor(np.tile(hand.posture_open, (1, 2, 1)), requires_grad=True)
    pos = torch.zeros(1, 2, 3, dtype=torch.float64, requires_grad=True)
    quat = torch.tensor(random_quat(rng, (1, 2)), requires_grad=True)
    weight = torch.tensor(rng.standard_normal((1, 2, len(hand.contact_names), 3)))

    def value(pos, quat, joints):
        return (model(pos, quat, joints).contact_point * weight).sum()

    assert model(pos, quat, joints).sphere_pos.shape == (1, 2, len(hand.sphere_body), 3)
    assert torch.autograd.gradcheck(value, (pos, quat, joints))


@pytest.mark.parametrize("device", DEVICES)
def test_kernel_gradient_is_the_central_difference_of_the_reference(hand, rng, device):
    count, step = 4, 1e-6
    lower, upper = free_limits(hand)
    free = rng.uniform(lower, upper, (count, len(lower)))
    pos, quat = _bases(rng, count)
    weights = [rng.standard_normal((count, n, 3)) for n in _point_counts(hand)]
    _, gradient = _run(hand, device, pos, quat, free, weights)

    def value(pos, quat, free):
        points = hand_points(hand, free @ hand.coupling.T, pos, quat)
        return sum((p * w).sum(axis=(1, 2)) for p, w in zip(points, weights, strict=True))

    def turned(axis, angle):
        return quat_multiply(quat_from_rotation_vector(angle * axis), quat)

    for column in range(6 + len(lower)):
        unit = np.eye(6 + len(lower))[column]
        ends = []
        for sign in (step, -step):
            moved = pos + sign * unit[:3], turned(unit[3:6], sign), free + sign * unit[6:]
            ends.append(value(*moved))
        expected = (ends[0] - ends[1]) / (2 * step)
        # Gradients reach about 100 with 70 points; float32 sums keep five digits.
        np.testing.assert_allclose(gradient[:, column], expected, rtol=1e-4, atol=2e-4)


def test_free_variables_and_joints_convert_both_ways(hand, rng):
    lower, upper = free_limits(hand)
    free = rng.uniform(lower, upper, (7, len(lower)))
    joints = free @ hand.coupling.T
    assert np.all(joints >= hand.joint_lower - 1e-12)
    assert np.all(joints <= hand.joint_upper + 1e-12)
    np.testing.assert_allclose(free_variables(hand, joints), free, atol=1e-12)


def _bases(rng, count):
    quat = np.concatenate([HALF_TURNS, random_quat(rng, (count,))])[:count]
    return rng.uniform(-0.5, 0.5, (count, 3)), quat


def _point_counts(hand):
    contacts = len(hand.contact_names)
    return contacts, contacts, len(hand.sphere_body)


def _run(hand, device, pos, quat, free, weights=None):
    """Launch both kernels on poisoned buffers."""
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    dev = device_hand(hand, device)
    state = allocate(dev, len(pos))
    for array in (state.body_pos, state.body_rot, state.contact, state.normal, state.sphere):
        array.fill_(np.nan)
    state.gradient.fill_(np.nan)
    rot = matrix_from_quat(quat).astype(np.float32)
    base_pos = wp.array(pos.astype(np.float32), dtype=wp.vec3, shape=(len(pos),), device=device)
    base_rot = wp.array(rot, dtype=wp.mat33, shape=(len(pos),), device=device)
    free = wp.array(free.astype(np.float32), dtype=float, shape=free.shape, device=device)
    forward(dev, state, base_pos, base_rot, free)
    gradients = (state.contact_grad, state.normal_grad, state.sphere_grad)
    for array, weight in zip(gradients, weights or (), strict=bool(weights)):
        array.assign(weight.astype(np.float32))
    backward(dev, state)
    return state, state.gradient.numpy()


def _assert_mujoco_agrees(hand, pos, quat, joints, body_pos, body_rot):
    model = hand.make_spec().compile()
    data = mujoco.MjData(model)
    R = matrix_from_quat(quat)
    assert len(body_pos) == len(joints)
    for n, q in enumerate(joints):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(body_pos[n], data.xpos[1:] @ R[n].T + pos[n], atol=METRES)
        expected = R[n] @ data.xmat[1:].reshape(-1, 3, 3)
        np.testing.assert_allclose(body_rot[n], expected, atol=METRES)
