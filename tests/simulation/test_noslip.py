"""Laws of our noslip pass: the engine's forces, and minima of a convex problem on a ball."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
import warp as wp
from box_solids import box_solid
from grasps import squeeze

from bidexdata.hands import load_hands
from bidexdata.simulation.noslip_kernels import friction_force
from bidexdata.simulation.scene import SimScene, build_scene
from bidexdata.simulation.settings import SceneSettings
from bidexdata.simulation.state import (
    object_pose,
    restore_state,
    saved_state,
    set_pose,
    set_targets,
)

SETTINGS = SceneSettings()
SIZE = 0.3
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def squeezed(hands, settings=SETTINGS) -> SimScene:
    """Palms pressed against two sides of a box, fingers bent a little."""
    scene = build_scene(hands, box_solid(), SIZE, settings)
    pos, quat, joints = squeeze(hands, gaps=(0.004, 0.002, -0.004))
    set_pose(scene, np.zeros(3), UPRIGHT, pos[:, 0], quat[:, 0], joints[:, 0] + 0.2)
    for i in range(len(hands)):
        scene.data.ctrl[scene.actuators[i]] = scene.controls(i, joints[i, 2] + 0.5)
    set_targets(scene, pos[:, 2], quat[:, 2])
    return scene


def forces_of_both(scene, iterations=2):
    """Joint-space constraint forces of the engine's pass and of ours from one state."""
    model, data = scene.model, scene.data
    assert scene.noslip.applies()
    state = saved_state(scene)
    found = []
    for ours in (False, True):
        restore_state(scene, state)
        model.opt.noslip_iterations = 0 if ours else iterations
        mujoco.mj_forward(model, data)
        plain = data.qfrc_constraint.copy()
        if ours:
            scene.noslip.correct(iterations)
            assert np.abs(data.qfrc_constraint - plain).max() > 1e-9 * np.abs(plain).max()
        found.append(data.qfrc_constraint.copy())
    model.opt.noslip_iterations = iterations
    restore_state(scene, state)
    return found


@pytest.fixture(params=["capsule", "shadow"])
def each_hands(request):
    if request.param == "shadow":
        request.getfixturevalue("menagerie")
    return load_hands(request.param)


def test_the_pass_gives_the_engine_s_forces(each_hands):
    scene = squeezed(each_hands)
    rng = np.random.default_rng(0)
    touched = 0
    for _ in range(25):
        scene.step(8, plain=True)
        scene.data.xfrc_applied[scene.object_body] = rng.normal(size=6) * 0.3
        engine, ours = forces_of_both(scene)
        np.testing.assert_allclose(ours, engine, atol=1e-7 * np.abs(engine).max())
        touched += scene.data.ncon
    assert touched > 100


def test_a_hundred_steps_lead_where_the_engine_s_lead(hands):
    scene = squeezed(hands)
    scene.step(60, plain=True)
    state, ends = saved_state(scene), []
    for plain in (True, False):
        restore_state(scene, state)
        scene.step(100, plain=plain)
        ends.append(object_pose(scene))
    np.testing.assert_allclose(ends[0][0], ends[1][0], atol=2e-5)
    np.testing.assert_allclose(ends[0][1], ends[1][1], atol=2e-4)


def test_the_past_of_the_buffers_changes_nothing(hands):
    """A scene that has grown its buffers steps to the bits of a new one."""
    used, new = squeezed(hands), squeezed(hands)
    used.step(120)
    start = saved_state(squeezed(hands))
    for scene in (used, new):
        restore_state(scene, start)
        scene.step(90)
    assert new.data.ncon > 0
    np.testing.assert_array_equal(used.data.qpos, new.data.qpos)
    np.testing.assert_array_equal(used.data.qvel, new.data.qvel)


@pytest.mark.parametrize(
    "change", [{"noslip_iterations": 0}, {"elliptic": False}, {"condim": 3}, {"plain": True}]
)
def test_what_the_pass_does_not_know_is_left_to_the_engine(hands, change):
    change = dict(change)
    plain = change.pop("plain", False)
    ours, engine = (squeezed(hands, dataclasses.replace(SETTINGS, **change)) for _ in range(2))
    ours.step(80, plain=plain)
    mujoco.mj_step(engine.model, engine.data, 80)
    assert engine.data.ncon > 0
    np.testing.assert_array_equal(ours.data.qpos, engine.data.qpos)


def test_options_of_the_model_are_as_before(hands):
    scene = squeezed(hands)
    scene.step(3)
    assert scene.model.opt.noslip_iterations == SETTINGS.noslip_iterations > 0


def test_to_ask_whether_the_pass_applies_changes_nothing(hands):
    """A number of passes set between two steps counts, whether or not anybody asked before."""
    asked, silent = squeezed(hands), squeezed(hands)
    for scene in (asked, silent):
        scene.step(60)
        before = scene.model.opt.noslip_iterations
        scene.model.opt.noslip_iterations = 5
        if scene is asked:
            assert scene.noslip.applies()
            scene.model.opt.noslip_iterations = 0
            assert not scene.noslip.applies()
            scene.model.opt.noslip_iterations = 5
        scene.noslip.step(20)
        assert scene.model.opt.noslip_iterations == 5 != before
    assert asked.data.ncon > 0
    np.testing.assert_array_equal(asked.data.qpos, silent.data.qpos)


def test_a_state_that_is_no_number_is_noticed_as_by_the_engine(hands):
    ours, engine = squeezed(hands), squeezed(hands)
    for scene, plain in ((ours, False), (engine, True)):
        scene.data.qpos[scene.object_qpos] = np.nan
        scene.step(2, plain=plain)
    assert ours.data.warning.number.sum() > 0
    np.testing.assert_array_equal(ours.data.warning.number, engine.data.warning.number)
    np.testing.assert_allclose(ours.data.qpos, engine.data.qpos, atol=1e-6)


def test_a_falling_object_that_touches_nothing_is_the_engine_s(hands):
    ours, engine = (build_scene(hands, box_solid(), SIZE, SETTINGS) for _ in range(2))
    for scene, plain in ((ours, False), (engine, True)):
        far = np.array([[0.0, 2.0, 0.0], [0.0, -2.0, 0.0]])
        joints = np.array([(h.joint_lower + h.joint_upper) / 2 for h in hands])
        set_pose(scene, np.zeros(3), UPRIGHT, far, np.array([UPRIGHT] * 2), joints)
        scene.model.opt.gravity[2] = -9.8
        scene.step(40, plain=plain)
        assert object_pose(scene)[0][2] < -0.1
    np.testing.assert_allclose(ours.data.qpos, engine.data.qpos, atol=1e-7)


@wp.kernel
def _friction_forces(
    A: wp.array[wp.mat33d],
    b: wp.array[wp.vec3d],
    mu: wp.array[wp.vec3d],
    normal: wp.array[wp.float64],
    force_out: wp.array[wp.vec3d],
):
    i = wp.tid()
    force_out[i] = friction_force(A[i], b[i], mu[i], normal[i])


def friction_forces(A, b, mu, normal):
    out = wp.full(len(b), wp.vec3d(wp.inf, wp.inf, wp.inf), dtype=wp.vec3d, device="cpu")
    arrays = [
        wp.array(x, dtype=t, device="cpu")
        for x, t in ((A, wp.mat33d), (b, wp.vec3d), (mu, wp.vec3d), (normal, wp.float64))
    ]
    wp.launch(_friction_forces, dim=len(b), inputs=[*arrays, out], device="cpu")
    return out.numpy()


def problems():
    rng = np.random.default_rng(3)
    n = 2000
    root = rng.normal(size=(n, 3, 3)) * 10 ** rng.uniform(-1, 2, size=(n, 1, 3))
    A = root @ root.transpose(0, 2, 1) + 1e-3 * np.eye(3)
    b = rng.normal(size=(n, 3)) * 10 ** rng.uniform(-3, 4, size=(n, 1))
    mu = np.stack([np.full(n, 0.6), np.full(n, 0.6), rng.uniform(0.001, 0.1, n)], axis=1)
    normal = 10 ** rng.uniform(-4, 2, n)
    b[:20] = 0.0
    mu[20:40] = 1e-5
    return A, b, mu, normal


def test_friction_is_the_minimum_over_the_ellipsoid():
    """Inside it the gradient vanishes; on it the gradient points straight out of it, backwards."""
    A, b, mu, normal = problems()
    f = friction_forces(A, b, mu, normal)
    u = f / mu
    size = np.linalg.norm(u, axis=1) / normal
    assert (size <= 1 + 1e-12).all()
    gradient = (np.einsum("nij,nj->ni", A, f) + b) * mu
    scaled = A * mu[:, :, None] * mu[:, None, :]
    scale = np.linalg.norm(b * mu, axis=1) + np.linalg.norm(scaled, axis=(1, 2)) * normal
    inside = size < 1 - 1e-9
    assert inside.sum() > 100
    assert (~inside).sum() > 100
    assert (np.linalg.norm(gradient[inside], axis=1) <= 1e-8 * scale[inside]).all()
    g, out = gradient[~inside], u[~inside] / np.linalg.norm(u[~inside], axis=1, keepdims=True)
    along = (g * out).sum(axis=1)
    assert (along <= 1e-8 * scale[~inside]).all()
    assert (np.linalg.norm(g - along[:, None] * out, axis=1) <= 1e-6 * scale[~inside]).all()


def test_a_singular_block_gives_no_number_that_is_none():
    f = friction_forces(
        np.zeros((1, 3, 3)), np.array([[1.0, 0.0, 0.0]]), np.full((1, 3), 0.6), np.ones(1)
    )
    assert np.isfinite(f).all()
    assert (np.abs(f) <= 0.6).all()
