"""Servos of the arms come to rest: no motor swings between its torque limits at the time step of `paper-1`."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from box_solids import box_solid
from made_rig import rig_data, write_rig
from test_arm_scene import at_rest

from bidexdata.arms.arm_scene import build_arm_scene, command_arms, set_arms
from bidexdata.arms.registry import load_rig
from bidexdata.arms.robot import mount_robot
from bidexdata.config import to_plain
from bidexdata.errors import BadConfig
from bidexdata.hands import load_hands
from bidexdata.record.settings import differing_settings, settings_of_test
from bidexdata.validation import load_protocol
from bidexdata.validation.arm_lift import servo_settings
from bidexdata.validation.arm_rules import ArmRules

PAPER = load_protocol("paper-1")
assert PAPER.arm is not None
RULES: ArmRules = PAPER.arm
UNBOUND = replace(RULES, servo_bound=None)
STEP = 0.05
"""By which all targets jump at once [rad]; it drives the motors into their limits."""
STILL = 0.03
"""Slower than this is at rest [rad/s]."""
SWINGS = {
    "weak": True,
    "made": False,
    "ur10e_post+shadow": True,
    "ur10e_post+leap": True,
    "iiwa14_facing+shadow": False,
    "iiwa14_facing+leap": True,
    "xarm7_leap+leap": False,
}
"""Robots, and whether the servos of the arm's model alone keep them swinging."""


def weak_rig(folder):
    """The made-up rig with motors that their servos drive into their limits."""
    arm = rig_data()["arm"]
    joints = {name: {**joint, "torque": 80.0} for name, joint in arm["joints"].items()}
    return load_rig(write_rig(folder, arm={**arm, "joints": joints}))


@pytest.fixture(scope="module", params=SWINGS)
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def robot(name, request, tmp_path_factory):
    if name == "made":
        return request.getfixturevalue("made")
    if name == "weak":
        return mount_robot(weak_rig(tmp_path_factory.mktemp("weak")), load_hands("capsule"))
    request.getfixturevalue("menagerie")
    rig, hand = name.split("+")
    return mount_robot(load_rig(rig), load_hands(hand))


def fastest_after_a_step(robot, rules: ArmRules, step: float) -> float:
    """Speed of the fastest arm joint 1 s after a step of all targets, gravity on [rad/s]."""
    arms = build_arm_scene(robot, None, 1.0, servos=servo_settings(rules))
    q, joints = at_rest(robot)
    set_arms(arms, np.zeros(3), np.array([1.0, 0, 0, 0]), q, joints)
    command_arms(arms, q + step)
    model, data = arms.scene.model, arms.scene.data
    model.opt.gravity[2] = -9.8
    arms.scene.step(round(1.0 / model.opt.timestep))
    return max(float(np.abs(data.qvel[v]).max()) for v in arms.arm_qvel)


@pytest.mark.parametrize("step", [STEP, -STEP])
def test_arms_are_at_rest_a_second_after_a_step(robot, step):
    assert fastest_after_a_step(robot, RULES, step) < STILL


def test_servos_as_in_the_model_swing_for_good_where_damping_is_beyond_the_bound(robot, name):
    swings = fastest_after_a_step(robot, UNBOUND, STEP) > 10 * STILL
    assert swings == SWINGS[name]


def test_damping_is_at_most_inertia_per_step_and_stiffness_falls_with_it(robot):
    bound, free = (build_arm_scene(robot, None, 1.0, servos=servo_settings(r)).scene.model
                   for r in (RULES, UNBOUND))  # fmt: skip
    arms = build_arm_scene(robot, box_solid(), 0.3, servos=servo_settings(RULES))
    model, data = arms.scene.model, arms.scene.data
    np.testing.assert_array_equal(data.qvel, 0.0)
    q, joints = at_rest(robot)
    set_arms(arms, np.array([5.0, 0, 1]), np.array([1.0, 0, 0, 0]), q, joints)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    felt, dt = 1 / np.diag(np.linalg.inv(mass)), model.opt.timestep
    for u, v in zip(arms.arm_actuators, arms.arm_qvel, strict=True):
        names = [model.actuator(k).name for k in u]
        mine, own = ([m.actuator(n).id for n in names] for m in (bound, free))
        was = free.actuator_gainprm[own, 0], -free.actuator_biasprm[own, 2]
        for found, ids in ((model, u), (bound, mine)):  # with an object or without
            kp, kd = found.actuator_gainprm[ids, 0], -found.actuator_biasprm[ids, 2]
            np.testing.assert_allclose(kd, np.minimum(was[1], felt[v] / dt), rtol=1e-6)
            np.testing.assert_allclose(kp * was[1], kd * was[0], rtol=1e-12)
            np.testing.assert_array_equal(kp[was[1] == 0], was[0][was[1] == 0])
            np.testing.assert_array_equal(found.actuator_biasprm[ids, 1], -kp)
            np.testing.assert_array_equal(
                found.actuator_forcerange[ids], free.actuator_forcerange[own]
            )


def test_a_bound_that_is_not_positive_is_refused():
    for bound in (0.0, -1.0, np.inf):
        with pytest.raises(BadConfig, match="servo_bound"):
            ArmRules(servo_bound=bound)


def test_verdicts_from_before_the_bound_keep_their_mark_and_are_not_those_of_today():
    old, new = (to_plain(replace(PAPER, arm=rules)) for rules in (UNBOUND, RULES))
    assert "servo_bound" not in old["arm"]
    assert differing_settings(old, new) == ["arm.servo_bound: None -> 1.0"]
    assert settings_of_test(old, "a") != settings_of_test(new, "a")
    assert settings_of_test(old, "l") == settings_of_test(new, "l")
