"""Honesty of test f: grasps whose outcome physics decides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from box_solids import box_solid
from grasps import batch_of, squeeze, turned

from bidexdata.frames import quat_from_rotation_vector, random_quat
from bidexdata.record import Status
from bidexdata.record.fields import columns_written_by
from bidexdata.record.status import TestStage
from bidexdata.simulation.distances import measure_distances
from bidexdata.simulation.scene import build_scene
from bidexdata.simulation.state import object_pose, set_pose
from bidexdata.validation import Execution, load_protocol, stages, validate_grasps
from bidexdata.validation.checks import instability, reference
from bidexdata.validation.force_closure import force_closure
from bidexdata.validation.loads import clear_load, set_load
from bidexdata.validation.rest import Grip
from bidexdata.validation.stages import closing_path, hold
from bidexdata.validation.validate import grasp_of

PAPER = load_protocol("paper-1")
PLAIN = Execution(plain=True)
BOX = box_solid()


def verdicts(hands, grasps, protocol=PAPER, execution=None, solid=BOX, **kwargs):
    batch = batch_of(hands, grasps, **kwargs)
    return validate_grasps(batch, solid, hands, protocol, execution=execution)


def same_columns(a, b):
    for name in columns_written_by("validate"):
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


@pytest.fixture(scope="module")
def squeezed(hands):
    return verdicts(hands, [squeeze(hands)])


def test_two_palms_that_squeeze_a_box_hold_it(squeezed):
    assert squeezed["success"].tolist() == [True]
    assert squeezed["verdict_status"][0] == Status.OK
    assert squeezed["direction"][0] == -1
    assert squeezed["failed_stage"][0] == TestStage.NONE
    assert squeezed["drift_pos"][0] < 0.02
    assert squeezed["drift_rot"][0] < 0.1
    assert np.isnan(squeezed["time"][0])
    assert np.isnan(squeezed["load_margin"][0])


def test_hands_far_from_the_object_fail_when_it_has_fallen_five_centimetres(hands):
    far = squeeze(hands, gaps=(0.1, 0.1, 0.1))
    out = verdicts(hands, [far])
    assert out["verdict_status"][0] == Status.NO_CONTACT
    assert not out["success"][0]
    assert out["failed_stage"][0] == TestStage.HOLD
    assert out["direction"][0] == 0
    assert out["time"][0] == pytest.approx(0.1)
    # 25 semi-implicit steps: g h^2 25 26 / 2
    assert out["drift_pos"][0] == pytest.approx(9.8 * 0.004**2 * 325, rel=1e-5)
    assert out["drift_rot"][0] == pytest.approx(0, abs=1e-6)
    assert out["pd"][0] == 0
    assert out["contact_number"][0] == 0
    assert out["contact_distance"][0] == pytest.approx(PAPER.metrics.reach)
    assert out["cdc"][0] == 0


def test_hands_that_merely_touch_fail_under_load(hands):
    scene = build_scene(hands, BOX, 0.3)
    pos, quat, joints = squeeze(hands, gaps=(0.012,) * 3)
    at = (pos[:, 1], quat[:, 1], joints[:, 1])
    gap = measure_distances(scene, np.zeros(3), [1.0, 0, 0, 0], *at, reach=0.05).hand_object
    touching = squeeze(hands, gaps=(0.02, 0.012 - gap, 0.012 - gap))
    out = verdicts(hands, [touching])
    assert out["verdict_status"][0] in (Status.SLIP, Status.TURNED, Status.NO_CONTACT)


def test_without_friction_the_same_squeeze_loses_the_box(hands):
    slippery = replace(PAPER, scene=replace(PAPER.scene, friction_slide=0.0, friction_spin=0.0))
    out = verdicts(hands, [squeeze(hands)], protocol=slippery)
    assert out["verdict_status"][0] in (Status.SLIP, Status.TURNED, Status.THROWN)


def test_a_push_from_one_side_throws_the_object(hands):
    pos, quat, joints = squeeze(hands, gaps=(0.02, -0.04, -0.1))
    pos[0] += (-0.5, 0, 0)  # the other hand stays away
    out = verdicts(hands, [(pos, quat, joints)])
    assert out["verdict_status"][0] == Status.THROWN
    assert out["direction"][0] == -1
    assert out["failed_stage"][0] == TestStage.CLOSING
    assert out["time"][0] == pytest.approx(PAPER.closing_time)
    assert out["drift_pos"][0] > PAPER.limit_pos


def test_a_start_inside_the_object_is_not_simulated(hands):
    inside = squeeze(hands, gaps=(-0.03, -0.03, -0.03))
    out = verdicts(hands, [inside])
    assert out["verdict_status"][0] == Status.START_PENETRATION
    assert out["time"][0] == 0
    assert out["failed_stage"][0] == TestStage.START
    assert np.isnan(out["drift_pos"][0])
    assert out["pd"][0] > 0.03 - 1e-3


def test_hands_inside_each_other_at_the_start_are_not_simulated(hands):
    pos, quat, joints = squeeze(hands, gaps=(0.1, 0.1, 0.1))
    pos[1], quat[1] = pos[0] + (0, 0.005, 0), quat[0]
    out = verdicts(hands, [(pos, quat, joints)])
    assert out["verdict_status"][0] == Status.START_PENETRATION
    assert out["spd"][0] > PAPER.start_depth
    assert out["pd"][0] == 0


def test_a_hand_that_jumps_away_at_absurd_speed_is_unstable(hands):
    pos, quat, joints = squeeze(hands)
    pos[0, 2] += (900.0, 0, 0)
    out = verdicts(hands, [(pos, quat, joints)])
    assert out["verdict_status"][0] in (Status.UNSTABLE, Status.BLOWN_UP)
    assert out["failed_stage"][0] == TestStage.CLOSING


def test_the_order_of_the_rows_changes_no_bit(hands):
    rows = [squeeze(hands), squeeze(hands, gaps=(0.1,) * 3), squeeze(hands, offset=(0.03, 0.05))]
    out = verdicts(hands, rows, size_mm=[300, 300, 300])
    back = verdicts(hands, rows[::-1])
    same_columns({k: v[::-1] for k, v in back.items()}, out)


def test_twice_the_same_bits_and_sizes_do_not_mix(hands, squeezed):
    out = verdicts(hands, [squeeze(hands), squeeze(hands)], size_mm=[310, 300])
    same_columns({k: v[1:] for k, v in out.items()}, squeezed)
    assert out["pd"][0] > out["pd"][1]


def test_the_size_in_metres_decides_and_whole_millimetres_are_exact(hands, squeezed):
    rows = [squeeze(hands)] * 3
    size = np.array([0.31, 0.3, np.nan], np.float32)
    out = verdicts(hands, rows, size_mm=[300, 310, 300], size=size)
    same_columns({k: v[1:2] for k, v in out.items()}, squeezed)
    assert out["pd"][0] > out["pd"][1] + 0.001
    assert out["verdict_status"][2] == Status.NO_SCENE


def test_which_hand_comes_first_changes_no_verdict(hands, squeezed):
    pos, quat, joints = squeeze(hands)
    swapped = verdicts(hands[::-1], [(pos[::-1], quat[::-1], joints[::-1])])
    assert swapped["success"][0] == squeezed["success"][0]
    assert swapped["pd"][0] == pytest.approx(squeezed["pd"][0], abs=1e-6)
    assert swapped["cdc"][0] == pytest.approx(squeezed["cdc"][0], abs=1e-6)
    assert swapped["drift_pos"][0] == pytest.approx(squeezed["drift_pos"][0], abs=2e-3)


def test_a_turned_scene_with_turned_loads_gives_the_same_verdict(hands, squeezed):
    rng = np.random.default_rng(0)
    far = squeeze(hands, gaps=(0.1,) * 3)
    for quat in [random_quat(rng), np.array([0.0, 0, 1, 0])]:
        shift = rng.normal(size=3)
        grasps = [turned(g, quat, shift) for g in (squeeze(hands), far)]
        out = verdicts(
            hands, grasps, object_pos=np.tile(shift, (2, 1)), object_quat=np.tile(quat, (2, 1))
        )
        assert out["success"].tolist() == [True, False]
        assert out["verdict_status"][1] == Status.NO_CONTACT
        assert out["drift_pos"][0] == pytest.approx(squeezed["drift_pos"][0], abs=2e-3)


def test_early_stops_change_no_verdict_on_grips_of_graded_strength(hands):
    grasps = [squeeze(hands, gaps=(0.02, 0.01, g), offset=(0.0, 0.04)) for g in (0.009, 0.007, 0.0)]
    # heavy enough that the weak grips fail
    heavy = replace(PAPER, hold=1.0, scene=replace(PAPER.scene, density=120.0))
    plain = verdicts(hands, grasps, protocol=heavy, execution=PLAIN)
    early = verdicts(hands, grasps, protocol=heavy)
    assert 0 < plain["success"].sum() < len(grasps)
    for name in ("success", "verdict_status", "direction", "time"):
        np.testing.assert_array_equal(early[name], plain[name], err_msg=name)


def test_one_hand_alone_is_judged_too(hands):
    alone = hands[:1]
    push = squeeze(alone, gaps=(0.02, 0.01, 0.0))
    far = squeeze(alone, gaps=(0.1,) * 3)
    out = verdicts(alone, [push, far])
    assert out["success"].tolist() == [False, False]
    assert out["verdict_status"][1] == Status.NO_CONTACT
    assert np.isfinite(out["cdc"]).all()


def test_without_hands_a_load_drops_the_object_and_no_load_leaves_it():
    scene = build_scene((), BOX, 0.3, PAPER.scene)
    nothing = np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 0))
    start = np.zeros(3), np.array([1.0, 0, 0, 0])
    set_pose(scene, *start, *nothing)
    wanted = reference(scene, PAPER)
    still = hold(scene, PAPER, PAPER.checks, wanted, PLAIN, rules=PLAIN.rest, grip=Grip.UNKNOWN)
    assert still.status is Status.OK
    assert (still.drift_pos, still.drift_rot) == (0, 0)
    assert still.time == pytest.approx(3.0)
    np.testing.assert_array_equal(object_pose(scene)[0], 0)
    set_pose(scene, *start, *nothing)
    set_load(scene, PAPER, np.array([0, 0, 1.0]), 1.0)
    fallen = hold(
        scene, PAPER, PAPER.checks, wanted, Execution(), rules=PLAIN.rest, grip=Grip.UNKNOWN
    )
    clear_load(scene)
    assert fallen.status is Status.SLIP
    np.testing.assert_array_equal(scene.model.opt.gravity, 0)


def test_loads_begin_as_late_as_the_protocol_says(hands):
    seen = {}
    for after in (None, 0.2):
        scene = build_scene(hands, BOX, 0.3, PAPER.scene)
        times = []
        rules = replace(PAPER, load_after=after)
        force_closure(
            *(scene, rules, grasp_of(batch_of(hands, [squeeze(hands)]), 0), PLAIN),
            watch=lambda phase, lasted, s, times=times: times.append((phase, lasted)),
        )
        seen[after] = max(t for phase, t in times if phase == "closing")
    assert seen[None] == pytest.approx(PAPER.closing_time)
    assert seen[0.2] - seen[None] == pytest.approx(0.2)


def test_a_watch_hears_how_long_each_load_has_lasted(hands):
    scene, heard = build_scene(hands, BOX, 0.3, PAPER.scene), {}

    def watch(phase, lasted, s):
        heard.setdefault(phase, []).append((lasted, s.data.time))

    grasp = grasp_of(batch_of(hands, [squeeze(hands)]), 0)
    assert force_closure(scene, PAPER, grasp, Execution(), watch).status is Status.OK
    assert list(heard) == ["closing", *(f"load {name}" for name in PAPER.directions)]
    for phase, looks in heard.items():
        lasted, clock = np.array(looks).T
        began = 0.0 if phase == "closing" else PAPER.closing_time  # of the copied state
        np.testing.assert_allclose(lasted, clock - began, atol=1e-9)


@pytest.mark.parametrize("plain", [True, False])
def test_who_looks_on_moves_no_check(hands, plain, monkeypatch):
    """The simulation is looked at for signs of breaking at the same instants, watched or not."""
    looked = []

    def noted(scene, protocol):
        looked.append(float(scene.data.time))
        return instability(scene, protocol)

    monkeypatch.setattr(stages, "instability", noted)
    rules = replace(PAPER, hold=0.5, directions=("+x",), load_after=0.1)
    grasp = grasp_of(batch_of(hands, [squeeze(hands)]), 0)
    scene, found = build_scene(hands, BOX, 0.3, rules.scene), []
    for watch in (None, lambda phase, lasted, s: None):
        looked.clear()
        verdict = force_closure(scene, rules, grasp, Execution(plain=plain), watch)
        found.append((verdict._replace(load_margin=0.0), list(looked)))
    assert found[0] == found[1]


def test_a_speed_that_is_no_number_is_unstable(hands):
    scene = build_scene(hands, BOX, 0.3, PAPER.scene)
    assert instability(scene, PAPER) is None
    scene.data.qvel[-1] = np.nan
    assert instability(scene, PAPER) is Status.UNSTABLE


def test_closing_passes_through_the_grasp_in_equal_steps(hands):
    pos, quat, joints = squeeze(hands)
    turn = quat_from_rotation_vector([0.0, 0.3, 0.0])
    quat[0, 2] = turned((pos, quat, joints), turn, 0)[1][0, 2]
    joints[:, 2] += 0.2
    scene = build_scene(hands, BOX, 0.3)
    path = closing_path(scene, PAPER, grasp_of(batch_of(hands, [(pos, quat, joints)]), 0))
    assert len(path.pos) == 2 * PAPER.segment_changes
    np.testing.assert_allclose(path.pos[9], pos[:, 1], atol=1e-7)
    np.testing.assert_allclose(path.pos[19], pos[:, 2], atol=1e-7)
    steps = np.diff(path.pos[:10], axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=1e-7)
    np.testing.assert_allclose(path.pos[0], pos[:, 0] + (pos[:, 1] - pos[:, 0]) / 10, atol=1e-7)
    np.testing.assert_allclose(np.abs((path.quat[19, 0] * quat[0, 2]).sum()), 1, atol=1e-7)
    angles = 2 * np.arccos(np.abs((path.quat[9:19, 0] * path.quat[10:20, 0]).sum(-1)))
    np.testing.assert_allclose(angles, 0.03, atol=1e-6)
    commanded = scene.hands[1].actuator_moment @ np.full(len(scene.hands[1].joint_names), 0.2)
    np.testing.assert_allclose(path.ctrl[19, scene.actuators[1]], commanded, atol=1e-7)
    np.testing.assert_array_equal(path.ctrl[9], 0)


def test_loads_follow_the_axes_of_the_object_not_of_the_world(hands):
    """Palms along the world's x hold loads along x and lose a heavy cube under others."""
    weak = [squeeze(hands, gaps=(0.02, 0.01, 0.009))] * 2
    heavy = replace(PAPER, scene=replace(PAPER.scene, density=120.0))
    half = np.sqrt(0.5)
    quats = [(1.0, 0, 0, 0), (half, 0, 0, half)]  # the cube itself looks the same
    out = verdicts(hands, weak, protocol=heavy, object_quat=quats)
    assert out["success"].tolist() == [False, False]
    assert out["direction"].tolist() == [2, 0]
