"""The back end on MuJoCo Warp: against the C engine, and by itself on every device present.

Compiling the engine's kernels takes 75 s of CPU once (Warp's CPU device). After that, on a busy
2-core machine, the tests with the engine that are not marked slow take 20 s and 10 s, the slow ones
3 minutes.
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

from bidexdata import Run
from bidexdata.cli.main import run
from bidexdata.devices import start_warp
from bidexdata.errors import BadConfig, MissingExtra, NotUsable
from bidexdata.record import Status
from bidexdata.record.fields import columns_written_by
from bidexdata.runs.shards import read_mark, shard_path
from bidexdata.simulation.scene import build_scene
from bidexdata.simulation.state import set_pose
from bidexdata.validation import (
    Execution,
    load_protocol,
    validate_grasps,
    warp_backend,
    warp_closing,
    warp_holding,
    warp_worlds,
)
from bidexdata.validation.force_closure import force_closure
from bidexdata.validation.stages import close_hands
from bidexdata.validation.validate import grasp_of
from bidexdata.validation.verdict import UNSTABLE
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
    """Same status and direction; drifts up to the digits that differ between the engines.

    What passes may be accepted at another time, so its drift says nothing.
    """
    assert [v[:3] for v in found] == [v[:3] for v in wanted]
    for a, b in zip(found, wanted, strict=True):
        if a.status != Status.OK:
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
    close_hands(scene, PAPER, grasp, Execution(plain=True))
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
def test_grips_of_graded_strength_fail_in_the_same_direction_at_the_same_time(
    hands, device, monkeypatch
):
    """And it changes nothing when the last loads go on among themselves."""
    gaps = (0.009, 0.007, 0.0)
    grasps = grasps_of(hands, [squeeze(hands, (0.02, 0.01, g), offset=(0.0, 0.04)) for g in gaps])
    heavy = replace(PAPER, hold=1.0, scene=replace(PAPER.scene, density=120.0))
    scene = build_scene(hands, BOX, 0.3, heavy.scene)
    found = warp_verdicts(scene, heavy, grasps, device=device)
    wanted = [force_closure(scene, heavy, g, Execution()) for g in grasps]
    assert 0 < sum(v.status is Status.OK for v in found) < len(grasps)
    assert [(v.status, v.direction) for v in found] == [(v.status, v.direction) for v in wanted]
    np.testing.assert_array_equal([v.time for v in found], [v.time for v in wanted])
    monkeypatch.setattr(warp_holding, "SMALL", 1)
    counts = _counts_of_worlds(monkeypatch)
    apart = warp_verdicts(scene, heavy, grasps, device=device)
    assert len(counts) > 2  # closing, all loads, and fewer
    assert counts[-1] < counts[1]
    agree(apart, found)


def _counts_of_worlds(monkeypatch):
    """A list that gets the number of worlds whenever some are made."""
    counts = []

    class Counted(warp_worlds.Worlds):
        def __init__(self, scene, parked, count, contacts, device):
            counts.append(count)
            super().__init__(scene, parked, count, contacts, device)

    monkeypatch.setattr(warp_closing, "Worlds", Counted)
    return counts


@needs_engine
@pytest.mark.slow
@on_devices
def test_order_and_company_change_no_verdict(scene, hands, device):
    """Three grasps: twice, backwards, in four worlds, and one alone.

    One of them blows up, and fills the buffers of contacts that all share.
    """
    blown = squeeze(hands)
    blown[0][0, 2] += (900.0, 0, 0)
    grasps = grasps_of(hands, [squeeze(hands), blown, squeeze(hands, offset=(0.03, 0.05))])
    together = warp_verdicts(scene, PAPER, grasps, device=device)
    assert together[1].status in UNSTABLE  # float32 ends at infinity where float64 is fast
    assert [v.status for v in (together[0], together[2])] == [Status.OK, Status.OK]
    assert together[1].time == pytest.approx(PAPER.closing_time)
    again = warp_verdicts(scene, PAPER, grasps, device=device)
    if device == "cpu":
        same_bits(again, together)
    agree(again, together)
    # From here on the last digits differ.
    agree(warp_verdicts(scene, PAPER, grasps[::-1], device=device)[::-1], together)
    agree(warp_verdicts(scene, PAPER, grasps, device=device, most_worlds=4), together)
    agree(warp_verdicts(scene, PAPER, grasps[2:], device=device), together[2:])


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
    agree(warp_verdicts(scene, PAPER, grasps, device=device), wanted)
    monkeypatch.setattr(warp_backend, "MOST_CONTACTS", 9)
    with pytest.raises(warp_worlds.ContactOverflow, match="9 a world"):
        warp_verdicts(scene, PAPER, grasps, device=device)


@needs_engine
@on_devices
def test_a_world_that_blows_up_under_a_load_is_no_success(scene, hands, device, monkeypatch):
    """Buffers that it fills are those of all: it is parked, and its neighbour goes on."""
    grasps = grasps_of(hands, [squeeze(hands), squeeze(hands)])
    advance = warp_holding.advance

    def blow_up(scene, protocol, worlds, steps):
        blown = advance(scene, protocol, worlds, steps)
        if not looks:
            blown[0] = Status.BLOWN_UP
            worlds.park(np.array([0]))
        looks.append(steps)
        return blown

    looks = []
    monkeypatch.setattr(warp_holding, "advance", blow_up)
    broken, held = warp_verdicts(scene, PAPER, grasps, device=device)
    assert (broken.status, broken.direction) == (Status.BLOWN_UP, 0)
    assert broken.time == pytest.approx(PAPER.check_every)
    assert held.status is Status.OK


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
@on_devices
def test_a_run_has_the_verdicts_of_both_engines_side_by_side(device, tmp_path, capsys):
    """Through the command line: the same columns, metrics of the C engine, another name."""
    library, folder = str(tmp_path / "library"), str(tmp_path / "run")
    quiet = ("--executor", "inline", "--quiet")
    fast = ("--set", "regions.anchors=60", "--set", "optimise.approach.steps=40")
    few = ("--hand", "capsule", "--sizes", "0.3", "--grasps", "2", "--candidates", "2")
    assert run(["prepare", "shapes:box", "--out", library, *quiet]) == 0
    assert run(["synth", library, "--out", folder, *few, *fast, *quiet]) == 0
    brief = ("name=brief-1", "hold=0.2", "segment_changes=3", "segment_steps=5")
    validate = ["validate", folder, *(w for s in brief for w in ("--set", s)), *quiet]
    assert run(validate) == 0
    assert run([*validate, "--backend", "mujoco_warp", "--device", device]) == 0
    opened = Run.open(folder)
    assert opened.verdict_tests() == [("brief-1", "f"), ("brief-1-warp", "f")]
    engine = opened.protocol("brief-1-warp").engine
    assert engine == warp_worlds.engine_identity(device)
    (task,) = opened.tasks
    c, gpu = (opened.task_batch(task, name) for name in ("brief-1", "brief-1-warp"))
    assert list(gpu.columns) == list(c.columns)
    judged = ("verdict_status", "success", "drift_pos", "drift_rot", "time", "direction")
    for name in set(columns_written_by("validate")) - {*judged, "failed_stage"}:
        np.testing.assert_array_equal(gpu[name], c[name])
    np.testing.assert_array_equal(gpu.success, c.success)
    np.testing.assert_allclose(gpu.drift_pos, c.drift_pos, atol=0.001)
    mark = read_mark(shard_path(opened.stage_folder("validate", "brief-1-warp", "f"), task.task_id))
    assert mark.made_with["device"] == engine.device
    capsys.readouterr()
    assert run([*validate[:-1], "--backend", "mujoco_warp", "--device", device]) == 0
    assert "of brief-1-warp: 1 task done before, none open" in capsys.readouterr().out


@needs_engine
@pytest.mark.slow
@on_devices
def test_rows_of_several_sizes_and_rows_without_a_grasp_are_one_call(hands, device):
    rows = [squeeze(hands), squeeze(hands, gaps=(0.1,) * 3), squeeze(hands), squeeze(hands)]
    status = np.array([Status.OK, Status.OK, Status.NO_REGION_PAIR, Status.OK])
    batch = batch_of(hands, rows, size_mm=[300, 300, 300, 310], synth_status=status)
    c = validate_grasps(batch, BOX, hands, PAPER)
    gpu = validate_grasps(batch, BOX, hands, PAPER, backend="mujoco_warp", device=device)
    assert list(gpu) == list(c)
    for name in ("verdict_status", "success", "direction", "failed_stage", "pd", "spd", "cdc"):
        np.testing.assert_array_equal(gpu[name], c[name])
    assert gpu["verdict_status"][2] == Status.NOT_RUN
