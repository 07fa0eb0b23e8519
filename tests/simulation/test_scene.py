"""Laws of the compiled scene: it is the object and the hands that were asked for."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
import pytest
from box_solids import angle_solid, box_mesh, box_solid

from bidexdata.errors import BadConfig
from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.simulation.assembly import OBJECT_BODY, hand_prefix
from bidexdata.simulation.scene import SceneNotBuilt, build_scene
from bidexdata.simulation.settings import SceneSettings
from bidexdata.simulation.state import object_pose, object_speed, set_pose

SIZE = 0.3
SETTINGS = SceneSettings()


@pytest.fixture(scope="module")
def scene(hands):
    return build_scene(hands, box_solid(), SIZE, SETTINGS)


def random_pose(hands, rng):
    joints = max(len(h.joint_names) for h in hands)
    q = np.full((len(hands), joints), np.nan)
    for i, h in enumerate(hands):
        q[i, : len(h.joint_names)] = rng.uniform(h.joint_lower, h.joint_upper)
    return rng.normal(size=(len(hands), 3)), random_quat(rng, (len(hands),)), q


@pytest.mark.parametrize("solid", [box_solid((1, 2, 3)), box_solid((1, 1, 0.01)), angle_solid()])
@pytest.mark.parametrize("size", [0.3, 0.8])
def test_the_compiled_object_has_the_mass_and_inertia_of_the_solid(solid, size):
    scene = build_scene((), solid, size, SETTINGS)
    body = scene.model.body(OBJECT_BODY)
    R = matrix_from_quat(body.iquat)
    inertia = R @ np.diag(body.inertia) @ R.T
    expected = solid.inertia_at(size, SETTINGS.density)
    np.testing.assert_allclose(body.mass, solid.mass(size, SETTINGS.density), rtol=1e-12)
    np.testing.assert_allclose(inertia, expected, atol=1e-9 * np.trace(expected))
    np.testing.assert_array_equal(body.ipos, 0)


def test_the_compiled_pieces_have_the_vertices_of_the_solid():
    solid = angle_solid()
    scene = build_scene((), solid, SIZE, SETTINGS)
    model = scene.model
    for number, piece in enumerate(solid.pieces):
        geom = model.geom(f"piece{number}")
        mesh = model.mesh(geom.dataid[0])
        first, count = mesh.vertadr[0], mesh.vertnum[0]
        local = model.mesh_vert[first : first + count]
        placed = local @ matrix_from_quat(geom.quat).T + geom.pos
        order = [np.lexsort(np.round(v, 6).T) for v in (placed, piece.vertices * SIZE)]
        np.testing.assert_allclose(
            placed[order[0]], piece.vertices[order[1]] * SIZE, atol=1e-7
        )  # mesh vertices are float32


def test_options_and_contacts_are_those_of_the_settings_whatever_the_hand_says(scene):
    model = scene.model
    assert model.opt.timestep == 0.004
    assert model.opt.impratio == 10
    assert model.opt.noslip_iterations == 2
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    np.testing.assert_array_equal(model.opt.gravity, 0)
    np.testing.assert_array_equal(model.geom_condim, 4)
    np.testing.assert_allclose(model.geom_friction[:, :2], np.tile((0.6, 0.02), (model.ngeom, 1)))
    of_hand = scene.geom_owner < scene.object_owner
    np.testing.assert_allclose(model.geom_solref[of_hand], [[0.005, 1]] * of_hand.sum())
    np.testing.assert_allclose(model.geom_solimp[of_hand, :3], [[0.5, 0.99, 1e-4]] * of_hand.sum())
    np.testing.assert_allclose(model.geom_solref[~of_hand], [[0.02, 1]] * (~of_hand).sum())
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], 5)
    np.testing.assert_allclose(model.actuator_biasprm[:, :3], [[0, -5, 0]] * model.nu)
    np.testing.assert_allclose(model.actuator_forcerange, [[-3, 3]] * model.nu)
    assert not model.actuator_ctrllimited.any()
    assert model.neq == 2
    np.testing.assert_allclose(model.eq_solimp, [[0.9, 0.95, 0.001, 0.5, 2]] * 2)
    np.testing.assert_allclose(model.eq_solref, [[0.02, 1]] * 2)
    np.testing.assert_allclose(model.eq_data[:, 10], 1)


def test_the_six_pairs_of_the_protocol_do_not_collide_in_either_hand(scene):
    model = scene.model
    excluded = {(s >> 16, s & 0xFFFF) for s in model.exclude_signature}
    for i, hand in enumerate(scene.hands):
        for names in SETTINGS.excluded_bodies:
            found = [next(b for b in hand.body_names if b.endswith(n)) for n in names]
            ids = tuple(sorted(model.body(hand_prefix(i) + b).id for b in found))
            assert ids in excluded


def test_every_geom_belongs_to_a_hand_the_object_or_the_table(hands):
    scene = build_scene(hands, box_solid(), SIZE, SETTINGS, table=True)
    owners = scene.geom_owner
    assert set(owners) == {-1, 0, 1, 2}
    assert list(np.flatnonzero(owners == -1)) == [scene.model.geom("table").id]
    assert len(scene.finger_names) == sum(len(h.fingers) for h in hands)
    assert set(scene.geom_finger) == set(range(-1, len(scene.finger_names)))


def test_the_scene_puts_bodies_where_the_hand_alone_has_them(hands, scene):
    rng = np.random.default_rng(0)
    pos, quat, joints = random_pose(hands, rng)
    set_pose(scene, [0, 0, 5.0], [1, 0, 0, 0], pos, quat, joints)
    mujoco.mj_kinematics(scene.model, scene.data)
    for i, hand in enumerate(hands):
        alone = hand.make_spec().compile()
        data = mujoco.MjData(alone)
        for name, value in zip(hand.joint_names, joints[i], strict=False):
            data.qpos[alone.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(alone, data)
        root = alone.body(hand.root_body).id
        R_root, R = data.xmat[root].reshape(3, 3), matrix_from_quat(quat[i])
        for name in hand.body_names:
            local = R_root.T @ (data.xpos[alone.body(name).id] - data.xpos[root])
            placed = scene.data.xpos[scene.model.body(hand_prefix(i) + name).id]
            np.testing.assert_allclose(placed, pos[i] + R @ local, atol=1e-12)


def test_controls_are_the_actuator_lengths_of_the_commanded_joints(hands, scene):
    rng = np.random.default_rng(1)
    set_pose(scene, [0, 0, 5.0], [1, 0, 0, 0], *random_pose(hands, rng))
    mujoco.mj_forward(scene.model, scene.data)
    np.testing.assert_allclose(scene.data.ctrl, scene.data.actuator_length, atol=1e-12)


def test_hands_that_are_told_to_stay_stay(hands, scene):
    pos = np.array([[-0.5, 0, 0], [0.5, 0, 0]])
    quat = np.tile([1.0, 0, 0, 0], (2, 1))
    joints = np.stack([h.posture_open for h in hands])
    set_pose(scene, [0, 0, 5.0], [1, 0, 0, 0], pos, quat, joints)
    mujoco.mj_step(scene.model, scene.data, 250)
    for i, address in enumerate(scene.root_qpos):
        np.testing.assert_allclose(scene.data.qpos[address : address + 3], pos[i], atol=1e-4)
        np.testing.assert_allclose(scene.data.qpos[scene.joint_qpos[i]], joints[i], atol=0.02)


def test_an_object_alone_falls_as_gravity_says_and_stays_without_it():
    scene = build_scene((), box_solid(), SIZE, SETTINGS)
    nothing = np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 0))
    turn = np.array([0.5, 0.5, 0.5, 0.5])
    set_pose(scene, [0, 0, 1.0], turn, *nothing)
    mujoco.mj_step(scene.model, scene.data, 250)
    pos, quat = object_pose(scene)
    np.testing.assert_array_equal(pos, [0, 0, 1.0])
    np.testing.assert_array_equal(quat, turn)
    scene.model.opt.gravity[:] = (0, -9.8, 0)
    mujoco.mj_step(scene.model, scene.data, 250)
    # semi-implicit Euler: g h^2 (1 + 2 + ... + n)
    np.testing.assert_allclose(object_pose(scene)[0][1], -9.8 * 0.004**2 * 250 * 251 / 2, rtol=1e-9)
    np.testing.assert_allclose(object_speed(scene), (9.8, 0), atol=1e-9)


def test_a_flat_object_of_no_volume_is_refused_in_one_sentence():
    flat = dataclasses.replace(
        box_solid(), pieces=(box_mesh((0, 0, 0), (1, 1, 0)),), volume=0.0, inertia=np.zeros((3, 3))
    )
    with pytest.raises(SceneNotBuilt, match=r"box at 0\.3 m"):
        build_scene((), flat, SIZE, SETTINGS)


@pytest.mark.parametrize(
    "change",
    [
        *({"timestep": value} for value in (0.0, math.nan, math.inf)),
        *({"density": value} for value in (-1.0, math.inf)),
        *({"friction_slide": value} for value in (-0.1, math.nan, math.inf)),
        *({"mass": value} for value in (0.0, math.inf)),
        *({"actuator_kp": value} for value in (0.0, math.inf)),
        *({"actuator_force": value} for value in (-3.0, math.inf)),
        {"condim": 2},
        {"solver_iterations": 0},
        {"tolerance": math.inf},
        *({"hand_solref": value} for value in ((0.0, 1.0), (0.005, math.nan))),
        *({"weld_solref": value} for value in ((-0.02, 1.0), (0.02, math.inf))),
        *(
            {"hand_solimp": value}
            for value in ((0.0, 0.9, 1e-4), (0.5, 1.0, 1e-4), (0.5, 0.9, -1.0))
        ),
        *({"weld_solimp": (0.9, 0.95, 0.001, *shape)} for shape in ((1.0, 2.0), (0.5, 0.5))),
        {"weld_solimp": (0.9, math.nan, 0.001, 0.5, 2.0)},
        *({"weld_torque_scale": value} for value in (0.0, math.inf)),
        {"weld_anchor": (0.0, math.nan, 0.0)},
        *({"slide_gains": value} for value in ((0.0, 100.0), (1000.0, -1.0))),
        {"hinge_gains": (math.inf, 10.0)},
        *({"hand_gravity_compensation": value} for value in (-0.1, 1.1, math.nan)),
    ],
    ids=str,
)
def test_impossible_settings_are_refused_in_one_sentence(change):
    (name,) = change
    with pytest.raises(BadConfig, match=rf"^SceneSettings\.{name} must be .*, not .*$"):
        SceneSettings(**change)
