"""The probe and the rule that end a load early."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from box_solids import box_solid
from grasps import batch_of, squeeze

from bidexdata.simulation.scene import build_scene
from bidexdata.simulation.state import set_pose
from bidexdata.validation import Execution, load_protocol
from bidexdata.validation.rest import LIFT_RULES, Grip, RestRules, probe, rests
from bidexdata.validation.stages import close_hands
from bidexdata.validation.validate import grasp_of

PAPER = load_protocol("paper-1")
RULES = RestRules()
LOADS = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
STATE = mujoco.mjtState.mjSTATE_INTEGRATION


def closed(hands, protocol=PAPER, **how):
    """A scene in which the hands have closed as `squeeze` says."""
    scene = build_scene(hands, box_solid(), 0.3, protocol.scene)
    grasp = grasp_of(batch_of(hands, [squeeze(hands, **how)]), 0)
    set_pose(
        *(scene, grasp.object_pos, grasp.object_quat),
        *(grasp.hand_pos[:, 0], grasp.hand_quat[:, 0], grasp.joints[:, 0]),
    )
    close_hands(scene, protocol, grasp, Execution())
    return scene


def state_of(scene):
    state = np.empty(mujoco.mj_stateSize(scene.model, STATE))
    mujoco.mj_getState(scene.model, scene.data, state, STATE)
    return np.concatenate([state, scene.model.geom_friction.ravel()])


def test_a_probe_leaves_no_trace(hands):
    scene = closed(hands)
    before = state_of(scene)
    probe(scene, PAPER, RULES, LOADS)
    np.testing.assert_array_equal(state_of(scene), before)
    mujoco.mj_step(scene.model, scene.data, 20)
    after = state_of(scene)
    again = closed(hands)
    mujoco.mj_step(again.model, again.data, 20)
    np.testing.assert_array_equal(state_of(again), after)


def test_the_less_friction_a_grasp_needs_the_firmer_it_is(hands):
    grips = []
    for friction in (0.6, 0.01, 0.002):
        scene = closed(hands)
        scene.model.geom_friction[:, 0] = friction
        heavy = replace(PAPER, gravity=3.0 * PAPER.gravity)
        grips.append(list(Grip).index(probe(scene, heavy, RULES, LOADS)))
    assert grips == sorted(grips)
    assert grips[0] == 0
    assert list(Grip)[grips[-1]] is Grip.LOOSE


@pytest.mark.parametrize("grip", list(Grip))
def test_a_load_ends_only_for_objects_that_are_slow_and_near(hands, grip):
    scene = closed(hands)
    at = scene.object_qvel

    def ends(speed=0.0, turn=0.0, moved=0.001, turned=0.01, lasted=1.0):
        scene.data.qvel[at : at + 6] = (speed, 0, 0, turn, 0, 0)
        where = {"moved": moved, "turned": turned}
        return rests(scene, PAPER, RULES, grip, **where, lasted=lasted, left=3.0 - lasted)

    if grip is Grip.LOOSE:
        assert not ends(lasted=2.9)
        return
    assert ends()
    assert ends(speed=0.0005)
    assert ends(speed=0.0012) is (grip is not Grip.UNKNOWN)
    assert ends(speed=0.005) is (grip in {Grip.FIRM, Grip.SETTLED})
    assert ends(speed=0.011, turn=0.05) is (grip is Grip.FIRM)
    assert not ends(speed=0.013)
    assert not ends(turn=0.07)
    assert ends(lasted=0.5) is (grip is not Grip.UNKNOWN)
    assert not ends(moved=0.95 * PAPER.limit_pos)
    assert not ends(turned=0.95 * PAPER.limit_rot)
    # What ends with much time left ends with less of it too.
    assert all(ends(lasted=t) for t in (2.0, 2.9))


def test_one_load_is_believed_less_than_six(hands):
    scene = closed(hands)
    down = [np.array([0.0, 0.0, -1.0])]
    for heavier in (1.0, 10.0, 40.0, 200.0):
        heavy = replace(PAPER, gravity=heavier * PAPER.gravity)
        order = [list(Grip).index(probe(scene, heavy, r, down)) for r in (RULES, LIFT_RULES)]
        assert order == sorted(order)
    assert LIFT_RULES.fair == RULES.fair


def test_without_stops_the_probe_is_not_run(hands, monkeypatch):
    from bidexdata.validation import force_closure

    def fail(*_):
        raise AssertionError

    monkeypatch.setattr(force_closure, "probe", fail)
    scene = build_scene(hands, box_solid(), 0.3, PAPER.scene)
    grasp = grasp_of(batch_of(hands, [squeeze(hands)]), 0)
    short = replace(PAPER, hold=0.2)
    plain = Execution(plain=True)
    assert force_closure.force_closure(scene, short, grasp, plain).status == 0
    with pytest.raises(AssertionError):
        force_closure.force_closure(scene, short, grasp, Execution())
