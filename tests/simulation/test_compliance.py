"""The weld's stiffness in closed form is that of the engine."""

import mujoco
import numpy as np
import pytest

from bidexdata.simulation.compliance import weld_stiffness
from bidexdata.simulation.scene import build_scene

# Of the displacement, at rest after 1.6 s: the hand's own joints sag a little.
TOLERANCE = 0.03


def at_rest_under(hand, force, torque):
    """Displacement [m] and rotation vector [rad] of a welded hand under a load at its origin."""
    scene = build_scene((hand,), None, 1.0)
    model, data = scene.model, scene.data
    first = int(scene.root_qpos[0])
    data.qpos[first : first + 7] = [0, 0, 0, 1, 0, 0, 0]
    data.qpos[scene.joint_qpos[0]] = hand.posture_curved
    data.ctrl[scene.actuators[0]] = scene.controls(0, hand.posture_curved)
    data.mocap_quat[scene.mocap[0]] = [1, 0, 0, 0]
    root = int(model.jnt_bodyid[model.dof_jntid[scene.root_qvel[0]]])
    mujoco.mj_forward(model, data)
    # The engine takes loads at the body's centre of mass.
    arm = data.xipos[root] - data.xpos[root]
    data.xfrc_applied[root] = np.concatenate([force, torque - np.cross(arm, force)])
    mujoco.mj_step(model, data, 400)
    turn = np.zeros(3)
    mujoco.mju_quat2Vel(turn, data.qpos[first + 3 : first + 7], 1.0)
    return data.qpos[first : first + 3].copy(), turn


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [0, 1])
def test_a_welded_hand_gives_way_as_the_closed_form_says(hands, side, axis):
    hand = hands[side]
    stiffness = weld_stiffness(hand)
    load = 60.0 * np.eye(3)[axis]
    shift, turn = at_rest_under(hand, load, np.zeros(3))
    np.testing.assert_allclose(shift, load / stiffness.shift, atol=TOLERANCE * 60 / stiffness.shift)
    load = 1.0 * np.eye(3)[axis]
    shift, turn = at_rest_under(hand, np.zeros(3), load)
    np.testing.assert_allclose(turn, load / stiffness.turn, atol=TOLERANCE * 1 / stiffness.turn)
