"""Test l: objects on a table whose fate physics decides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from box_solids import box_solid
from grasps import HALF, batch_of, squeeze, turned

from bidexdata.record import Status
from bidexdata.record.status import TestStage
from bidexdata.simulation.scene import build_scene
from bidexdata.simulation.state import object_pose
from bidexdata.validation import Execution, load_protocol, validate_grasps
from bidexdata.validation.lift import lift
from bidexdata.validation.stages import lift_path
from bidexdata.validation.validate import grasp_of

PAPER = load_protocol("paper-1")
IDENTITY = np.array([1.0, 0, 0, 0])
BOX = box_solid()


def on_table(hands, height=HALF, **kwargs):
    """A squeeze round the cube that stands on the table, as rows with its pose."""
    grasp = turned(squeeze(hands, **kwargs), IDENTITY, np.array([0.0, 0.0, height]))
    return batch_of(hands, [grasp], object_pos=[(0.0, 0.0, height)])


def verdict(hands, batch, protocol=PAPER, execution=None):
    return validate_grasps(batch, BOX, hands, protocol, "l", execution=execution)


def test_two_palms_lift_a_box_and_hold_it(hands):
    out = verdict(hands, on_table(hands))
    assert out["success"].tolist() == [True]
    assert out["verdict_status"][0] == Status.OK
    assert out["failed_stage"][0] == TestStage.NONE
    assert out["direction"][0] == -1
    assert out["drift_pos"][0] < 0.03


def test_the_object_rises_by_the_way_of_the_hands(hands):
    scene = build_scene(hands, BOX, 0.3, PAPER.scene, table=True)
    grasp = grasp_of(on_table(hands), 0)
    heights = []
    seen = lift(
        scene,
        PAPER,
        grasp,
        Execution(),
        lambda phase, _, s: heights.append((phase, object_pose(s)[0][2])),
    )
    assert seen.status is Status.OK
    closing, up = ([h for p, h in heights if p == phase] for phase in ("closing", "lift"))
    assert max(closing) - HALF < 0.01
    assert up[-1] - HALF == pytest.approx(PAPER.lift.height, abs=0.02)
    assert np.all(np.diff(up) > -1e-3)
    np.testing.assert_array_equal(scene.model.opt.gravity, 0)


def test_targets_rise_in_steps_of_two_millimetres_over_a_second(hands):
    grasp = grasp_of(on_table(hands), 0)
    path = lift_path(PAPER, grasp)
    steps = np.diff(np.concatenate([grasp.hand_pos[None, :, 2], path]), axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to([0, 0, 0.002], steps.shape), atol=1e-9)
    assert len(path) * PAPER.lift.steps * PAPER.scene.timestep == pytest.approx(1.0)


@pytest.mark.parametrize("gap", [0.1, 0.05])
def test_hands_that_close_beside_the_object_leave_it_on_the_table(hands, gap):
    out = verdict(hands, on_table(hands, gaps=(gap,) * 3))
    assert out["verdict_status"][0] == Status.NO_CONTACT
    assert out["failed_stage"][0] == TestStage.HOLD
    assert out["time"][0] == pytest.approx(PAPER.check_every)
    assert out["drift_pos"][0] == pytest.approx(PAPER.lift.height, abs=2e-3)


def test_a_grip_without_friction_leaves_the_object_behind(hands):
    slippery = replace(PAPER, scene=replace(PAPER.scene, friction_slide=0.0, friction_spin=0.0))
    out = verdict(hands, on_table(hands), slippery)
    assert not out["success"][0]
    assert out["verdict_status"][0] == Status.NOT_LIFTED


def test_an_object_too_heavy_to_lift_says_so(hands):
    heavy = replace(PAPER, scene=replace(PAPER.scene, density=40000.0))
    out = verdict(hands, on_table(hands), heavy)
    assert out["verdict_status"][0] in (Status.NOT_LIFTED, Status.SLIP)


def test_hands_inside_the_table_are_not_simulated(hands):
    batch = on_table(hands, offset=(0.0, -HALF))
    out = verdict(hands, batch)
    assert out["verdict_status"][0] == Status.START_PENETRATION
    assert out["failed_stage"][0] == TestStage.START


def test_mirrored_scenes_give_mirrored_results(hands):
    """Swap the palms: each hand does what the other did."""
    plain = verdict(hands, on_table(hands, offset=(0.02, 0.0)))
    mirror = verdict(hands, on_table(hands, offset=(0.02, 0.0), towards=(-1.0, 1.0)))
    assert plain["success"][0] == mirror["success"][0]
    assert plain["drift_pos"][0] == pytest.approx(mirror["drift_pos"][0], abs=3e-3)
    assert plain["pd"][0] == pytest.approx(mirror["pd"][0], abs=1e-5)


def test_a_lift_judged_at_its_end_runs_no_hold(hands):
    bench = load_protocol("dexgraspbench-1")
    out = verdict(hands, on_table(hands), bench)
    assert out["success"][0]
    far = verdict(hands, on_table(hands, gaps=(0.1,) * 3), bench)
    assert far["failed_stage"][0] == TestStage.LIFT
    assert far["time"][0] == pytest.approx(0.4)


def test_early_stops_change_no_lift(hands):
    batch = on_table(hands)
    plain = verdict(hands, batch, execution=Execution(plain=True))
    early = verdict(hands, batch)
    for name in ("success", "verdict_status", "failed_stage"):
        np.testing.assert_array_equal(early[name], plain[name], err_msg=name)
