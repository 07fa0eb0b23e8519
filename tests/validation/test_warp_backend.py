"""The back end on MuJoCo Warp: against the C engine, and by itself on every device present.

Compiling the engine's kernels takes 75 s of CPU once (Warp's CPU device); after that the test that
is not marked slow takes 5 s, the slow ones 60 s.
"""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import warp as wp
from box_solids import box_solid
from grasps import HALF, batch_of, squeeze, turned

from bidexdata.devices import start_warp
from bidexdata.errors import BadConfig, MissingExtra, NotUsable
from bidexdata.record import Status
from bidexdata.simulation.scene import build_scene
from bidexdata.simulation.state import set_pose
from bidexdata.validation import Execution, load_protocol, warp_backend, warp_worlds
from bidexdata.validation.force_closure import force_closure
from bidexdata.validation.stages import close_hands
from bidexdata.validation.validate import grasp_of
from bidexdata.validation.warp_backend import warp_verdicts

start_warp()
PAPER = load_protocol("paper-1")
BOX = box_solid()
DEVICES = [d.alias for d in wp.get_devices()]
FLOAT32 = 1e-4  # [m], [rad]: what float32 and a looser solver leave after a second of simulation

needs_engine = pytest.mark.skipif(
    importlib.util.find_spec("mujoco_warp") is None,
    reason="needs mujoco-warp: pip install 'bidexdata[gpu]'",
)
on_devices = pytest.mark.parametrize("device", DEVICES)


@pytest.fixture(scope="module")
def scene(hands):
    return build_scene(hands, BOX, 0.3, PAPER.scene)


def grasps_of(hands, rows, **kwargs):
    batch = batch_of(hands, rows, **kwargs)
    return [grasp_of(batch, n) for n in range(len(rows))]


def same_bits(first, second):
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(np.array(a), np.array(b))


def agree(found, wanted):
    """Same status and direction; drifts up to the digits that differ between the engines."""
    assert [v[:3] for v in found] == [v[:3] for v in wanted]
    for a, b in zip(found, wanted, strict=True):
        np.testing.assert_allclose(a[3:5], b[3:5], atol=FLOAT32)
        np.testing.assert_allclose(a.time, b.time)


def test_a_missing_package_is_named_with_the_line_that_installs_it(scene, hands, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    with pytest.raises(MissingExtra, match=r"mujoco-warp.*pip install 'bidexdata\[gpu\]'"):
        warp_verdicts(scene, PAPER, grasps_of(hands, [squeeze(hands)]), device="cpu")


def test_no_grasps_give_no_verdicts_and_other_tests_are_refused(scene):
    assert warp_verdicts(scene, PAPER, [], device="cpu") == []
    with pytest.raises(NotUsable, match="'a'"):
        warp_verdicts(scene, PAPER, [], "a")
    with pytest.raises(BadConfig, match="most_worlds"):
        warp_verdicts(scene, PAPER, [], most_worlds=0)
    with pytest.raises(NotUsable, match="'dexgraspbench-1' sets load"):
        warp_verdicts(scene, load_protocol("dexgraspbench-1"), [], device="cpu")


def test_no_step_of_a_grip_has_more_rows_than_there_is_room_for(scene, hands):
    """The rows beside those of contacts are all there when every joint is at a limit."""
    model, data = scene.model, scene.data
    grasp = grasps_of(hands, [squeeze(hands)])[0]
    at = (grasp.hand_pos[:, 0], grasp.hand_quat[:, 0], grasp.joints[:, 0])
    set_pose(scene, grasp.object_pos, grasp.object_quat, *at)
    close_hands(scene, PAPER, grasp)
    room = warp_worlds.constraint_rows
    assert data.ncon > 0
    assert data.nefc <= room(scene, data.ncon)
    limited = model.jnt_limited.astype(bool)
    data.qpos[model.jnt_qposadr[limited]] = model.jnt_range[limited, 1] + 0.01
    mujoco.mj_forward(model, data)
    assert data.nefc == room(scene, data.ncon)


@needs_engine
@on_devices
def test_verdicts_are_those_of_the_c_engine(scene, hands, device):
    rows = [
        squeeze(hands),
        squeeze(hands, gaps=(0.1,) * 3),  # nothing is touched
        squeeze(hands, gaps=(-0.03,) * 3),  # inside at the start
    ]
    grasps = grasps_of(hands, rows)
    found = warp_verdicts(scene, PAPER, grasps, device=device)
    agree(found, [force_closure(scene, PAPER, g, Execution()) for g in grasps])
    assert [v.status for v in found] == [
        Status.OK,
        Status.NO_CONTACT,
        Status.START_PENETRATION,
    ]


@needs_engine
@pytest.mark.slow
@on_devices
def test_grips_of_graded_strength_fail_in_the_same_direction_at_the_same_time(hands, device):
    gaps = (0.009, 0.007, 0.0)
    grasps = grasps_of(hands, [squeeze(hands, (0.02, 0.01, g), offset=(0.0, 0.04)) for g in gaps])
    heavy = replace(PAPER, hold=1.0, scene=replace(PAPER.scene, density=120.0))
    scene = build_scene(hands, BOX, 0.3, heavy.scene)
    found = warp_verdicts(scene, heavy, grasps, device=device)
    wanted = [force_closure(scene, heavy, g, Execution()) for g in grasps]
    assert 0 < sum(v.status is Status.OK for v in found) < len(grasps)
    assert [(v.status, v.direction) for v in found] == [(v.status, v.direction) for v in wanted]
    np.testing.assert_array_equal([v.time for v in found], [v.time for v in wanted])


@needs_engine
@pytest.mark.slow
@on_devices
def test_company_order_and_room_change_no_verdict(scene, hands, device):
    """Seven grasps in five worlds, backwards, and one alone; one of them blows up."""
    rows = [squeeze(hands, offset=(0.0, y)) for y in (0.0, 0.03, 0.06, 0.09)]
    blown = squeeze(hands)
    blown[0][0, 2] += (900.0, 0, 0)
    rows += [squeeze(hands, gaps=(0.1,) * 3), blown, squeeze(hands, offset=(0.03, 0.05))]
    grasps = grasps_of(hands, rows)
    together = warp_verdicts(scene, PAPER, grasps, device=device)
    assert together[4].status is Status.NO_CONTACT
    assert together[5].status is Status.UNSTABLE
    assert together[5].time == pytest.approx(PAPER.closing_time)
    few = warp_verdicts(scene, PAPER, grasps[::-1], device=device, most_worlds=5)[::-1]
    alone = warp_verdicts(scene, PAPER, grasps[2:3], device=device)
    if device == "cpu":
        same_bits(few, together)
        same_bits(alone, together[2:3])
    else:
        agree(few, together)
        agree(alone, together[2:3])


@needs_engine
@pytest.mark.slow
@on_devices
def test_a_push_from_one_side_throws_the_object(scene, hands, device):
    pos, quat, joints = squeeze(hands, gaps=(0.02, -0.04, -0.1))
    pos[0] += (-0.5, 0, 0)  # the other hand stays away
    grasps = grasps_of(hands, [(pos, quat, joints)])
    (verdict,) = warp_verdicts(scene, PAPER, grasps, device=device)
    assert verdict.status is Status.THROWN
    assert verdict.direction == -1
    assert verdict.time == pytest.approx(PAPER.closing_time)
    assert verdict.drift_pos > PAPER.limit_pos


@needs_engine
@pytest.mark.slow
@on_devices
def test_full_buffers_are_noticed_grown_and_at_last_reported(scene, hands, device, monkeypatch):
    grasps = grasps_of(hands, [squeeze(hands)])
    wanted = warp_verdicts(scene, PAPER, grasps, device=device)
    monkeypatch.setattr(warp_backend, "CONTACTS", 9)
    grown = warp_verdicts(scene, PAPER, grasps, device=device)
    if device == "cpu":
        same_bits(grown, wanted)
    else:
        agree(grown, wanted)
    monkeypatch.setattr(warp_backend, "MOST_CONTACTS", 9)
    with pytest.raises(warp_worlds.ContactOverflow, match="9 a world"):
        warp_verdicts(scene, PAPER, grasps, device=device)


@needs_engine
@pytest.mark.slow
@on_devices
def test_what_two_palms_squeeze_is_lifted_and_what_they_do_not_touch_stays(hands, device):
    scene = build_scene(hands, BOX, 0.3, PAPER.scene, table=True)
    up = np.array([0.0, 0.0, HALF])
    rows = [
        turned(squeeze(hands, gaps, offset=(0.0, 0.03)), [1.0, 0, 0, 0], up)
        for gaps in ((0.02, 0.01, 0.0), (0.1,) * 3)
    ]
    grasps = grasps_of(hands, rows, object_pos=np.tile(up, (2, 1)))
    held, left = warp_verdicts(scene, PAPER, grasps, "l", device=device)
    assert held.status is Status.OK
    assert held.direction == -1
    assert np.isnan(held.time)
    assert held.drift_pos < 0.005
    assert left.status is Status.NO_CONTACT
    assert left.direction == -1
    assert left.time == pytest.approx(PAPER.check_every)
    # It stays 10 cm below where it should be, a little sunk into the table.
    assert left.drift_pos == pytest.approx(0.1, abs=5e-4)


@needs_engine
def test_the_identity_names_versions_and_the_kind_of_device():
    identity = warp_worlds.engine_identity("cpu")
    assert identity["backend"] == "mujoco_warp"
    assert identity["device"] == "cpu"
    assert identity["warp"] == wp.__version__
    assert set(identity) == {"backend", "device", "mujoco_warp", "warp"}
