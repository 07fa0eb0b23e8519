"""Test a: what test l asks for, of hands that two arms carry; on made-up arms that face each other."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from box_solids import box_solid
from grasps import HALF
from made_rig import rig_data, write_rig
from motions import CONFIG, beside_box, with_arms

from bidexdata.arms.arm_scene import build_arm_scene, set_arms
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.config import PathConfig
from bidexdata.arms.registry import load_rig
from bidexdata.arms.robot import mount_robot
from bidexdata.errors import NotUsable
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import PHASES
from bidexdata.record.status import TestStage
from bidexdata.simulation.state import object_pose
from bidexdata.validation import Execution, load_protocol, validate_grasps
from bidexdata.validation.arm_lift import approach_targets, lift_with_arms, phase_targets
from bidexdata.validation.validate import arm_test_of_rows, grasp_of

PAPER = load_protocol("paper-1")
BOX = box_solid()


@pytest.fixture(scope="module")
def rows(made):
    return with_arms(made, beside_box(made.hands))


def changed(batch, **columns) -> GraspBatch:
    """Rows with other values in some columns."""
    return GraspBatch(batch.header, {**batch.columns, **columns})


def judged(robot, batch, protocol=PAPER, **execution):
    how = Execution(**execution)
    return validate_grasps(batch, BOX, robot.hands, protocol, "a", robot=robot, execution=how)


def moments(robot, batch):
    """Verdict of the first row, and (phase, height of the object, root poses) over time."""
    scenes, seen = arm_test_of_rows(batch, BOX, robot, PAPER), []

    def watch(phase, lasted, scene):
        roots = [scene.data.body(f"hand{i}/{hand.root_body}") for i, hand in enumerate(robot.hands)]
        pose = [(b.xpos.copy(), b.xmat.reshape(3, 3).copy()) for b in roots]
        seen.append((phase, lasted, object_pose(scene)[0][2], pose))

    return lift_with_arms(scenes, PAPER, grasp_of(batch, 0), Execution(), watch), seen


def test_two_arms_lift_a_box_and_hold_it(made, rows):
    out = judged(made, rows)
    assert out["verdict_status"][0] == Status.OK
    assert out["success"][0]
    assert out["failed_stage"][0] == TestStage.NONE
    assert out["drift_pos"][0] < 0.02
    floating = validate_grasps(rows, BOX, made.hands, PAPER, "l")
    for name in ("pd", "spd", "cdc", "contact_number", "contact_distance"):
        np.testing.assert_array_equal(out[name], floating[name])


def test_the_object_waits_rises_by_the_lift_and_stays(made, rows):
    verdict, seen = moments(made, rows)
    assert verdict.status is Status.OK
    heights = {phase: [h for p, _, h, _ in seen if p == phase] for phase, *_ in seen}
    assert list(heights) == ["approach", "closing", "lift", "hold"]
    assert np.ptp(heights["approach"]) < 1e-3
    assert max(heights["closing"]) - HALF < 0.01
    assert heights["lift"][-1] - HALF == pytest.approx(PAPER.lift.height, abs=5e-3)
    assert np.all(np.diff(heights["lift"]) > -2e-3)


def test_arms_bring_the_hands_to_the_pre_grasp_without_sag(made, rows):
    # Gravity is on; it is compensated, so that servos without an integral part hold the pose.
    _, seen = moments(made, rows)
    pose = [found for phase, *_, found in seen if phase == "approach"][-1]
    for h, (pos, _) in enumerate(pose):
        assert np.linalg.norm(pos - rows["hand_pos"][0, h, 0]) < 2e-3
    without = replace(PAPER, name="sagging", arm=replace(PAPER.arm, gravity_compensation=0.0))
    assert judged(made, rows, without)["drift_pos"][0] > 1.5 * judged(made, rows)["drift_pos"][0]


def test_a_row_that_the_arms_do_not_reach_fails_with_their_status_unsimulated(made, rows):
    far = changed(
        rows,
        arm_status=np.array([Status.IK_GRASP], np.int8),
        arm_path=np.full_like(rows["arm_path"], np.nan),
    )
    out = judged(made, far, load_margin=True)
    assert out["verdict_status"][0] == Status.IK_GRASP
    assert out["failed_stage"][0] == TestStage.NONE
    assert not out["success"][0]
    assert np.isnan(out["drift_pos"][0])
    assert out["load_margin"][0] == 0.0
    assert np.isfinite(out["pd"][0])


def test_a_hand_that_throws_the_object_on_its_way_fails_in_the_approach(made, rows):
    # From rest straight to the stand-off leads through the object.
    path = rows["arm_path"].copy()
    first = CONFIG.path.knots[0]
    share = np.linspace(0, 1, first + 1)[:, None]
    for h, arm in enumerate(made.arms):
        path[0, h, : first + 1] = (1 - share) * arm.chain.rest + share * path[0, h, first]
    out = judged(made, changed(rows, arm_path=path))
    assert out["verdict_status"][0] == Status.THROWN
    assert out["failed_stage"][0] == TestStage.APPROACH
    assert out["time"][0] == pytest.approx(
        rows["arm_time"][0, sum(CONFIG.path.knots[:2])] + PAPER.arm.settle, abs=0.03
    )


def test_hands_that_close_beside_the_object_leave_it_on_the_table(made):
    beside = with_arms(made, beside_box(made.hands, gaps=(0.05,) * 3))
    out = judged(made, beside)
    assert out["verdict_status"][0] == Status.NO_CONTACT
    assert out["failed_stage"][0] == TestStage.HOLD
    assert out["drift_pos"][0] == pytest.approx(PAPER.lift.height, abs=2e-3)


def test_a_pre_grasp_in_the_object_fails_before_arms_move(made):
    inside = with_arms(made, beside_box(made.hands, gaps=(-0.015,) * 3))
    out = judged(made, inside)
    assert out["verdict_status"][0] == Status.START_PENETRATION
    assert out["failed_stage"][0] == TestStage.START


def test_arms_that_overlap_something_do_not_succeed_and_say_when(tmp_path, made, rows):
    # A post into which a link reaches by some millimetres while the hand stands off.
    scene = build_arm_scene(made, BOX, 0.3)
    _, joints = rows["arm_path"], rows["joints"][0, :, 0].astype(float)
    set_arms(scene, np.array([0, 0, HALF]), np.array([1.0, 0, 0, 0]),
             rows["arm_path"][0, :, 0].astype(float), joints)  # fmt: skip
    import mujoco

    mujoco.mj_kinematics(scene.scene.model, scene.scene.data)
    link = scene.scene.data.body("arm0/link6")
    reach, half = 0.05, 0.03
    post = {"pos": [float(link.xpos[0]), float(link.xpos[1]) + reach + half - 0.006,
                    float(link.xpos[2])], "half": [half] * 3}  # fmt: skip
    rig = load_rig(write_rig(tmp_path, fixtures=[*rig_data()["fixtures"], post]))
    robot = mount_robot(rig, made.hands)
    header = dataclasses.replace(
        rows.header,
        arms=tuple(replace(a, rig_hash=robot.digest) for a in rows.header.arms),
    )
    blocked = GraspBatch(header, rows.columns)
    out = judged(robot, blocked, load_margin=True)
    assert out["verdict_status"][0] == Status.COLLISION_SELF
    assert out["load_margin"][0] == 0.0  # at least 1 is another word for success
    assert out["failed_stage"][0] == TestStage.APPROACH
    assert not out["success"][0]
    assert np.isfinite(out["drift_pos"][0])
    allowed = replace(PAPER, name="blunt", arm=replace(PAPER.arm, depth=0.2))
    assert judged(robot, blocked, allowed)["success"][0]


def test_neither_order_nor_watching_nor_early_ends_change_a_verdict(made, rows):
    shifted = with_arms(made, beside_box(made.hands, shift=(0.05, 0.02)))
    beside = with_arms(made, beside_box(made.hands, gaps=(0.05,) * 3))
    batch = GraspBatch.concat([rows, shifted, beside])
    out = judged(made, batch)
    back = judged(made, batch.select(np.array([2, 1, 0])))
    for name, values in out.items():
        np.testing.assert_array_equal(values, back[name][::-1], err_msg=name)
    plain = judged(made, batch, plain=True)
    np.testing.assert_array_equal(out["verdict_status"], plain["verdict_status"])
    verdict, _ = moments(made, rows)
    assert np.float32(verdict.drift_pos) == out["drift_pos"][0]


def test_the_load_margin_counts_the_object_alone(made, rows):
    out = judged(made, rows, load_margin=True)
    assert out["load_margin"][0] > 1.0


def test_targets_pass_every_knot_and_end_where_the_phase_does(made, rows):
    motion = grasp_of(rows, 0).motion
    ends = np.cumsum(motion.knots)
    for phase, end, knots in zip(PHASES, ends, motion.knots, strict=True):
        targets = phase_targets(motion, phase, 4 * knots)
        assert len(targets) == 4 * knots
        np.testing.assert_allclose(targets[-1], motion.path[:, end], atol=1e-12)
        np.testing.assert_allclose(targets[3], motion.path[:, end - knots + 1], atol=1e-12)
    for every in (0.02, 0.013, 10.0):
        way = approach_targets(motion, every)
        assert len(way) == max(1, int(np.ceil(motion.time[ends[1]] / every - 1e-9)))
        np.testing.assert_allclose(way[-1], motion.path[:, ends[1]], atol=1e-12)


def test_the_hands_rise_straight_up_along_the_lift(made, rows):
    motion = grasp_of(rows, 0).motion
    for h, arm in enumerate(made.arms):
        pos = [
            chain_forward(arm.chain, q[h, : arm.chain.joints])[0]
            for q in phase_targets(motion, "lift", PAPER.lift.changes)
        ]
        rise = np.array(pos) - rows["hand_pos"][0, h, 2]
        expected = np.linspace(0, PAPER.lift.height, PAPER.lift.changes + 1)[1:]
        np.testing.assert_allclose(rise[:, :2], 0, atol=2e-3)
        np.testing.assert_allclose(rise[:, 2], expected, atol=2e-3)


def test_motions_of_other_arms_or_none_or_of_another_height_are_refused(made, rows, tmp_path):
    with pytest.raises(NotUsable, match="needs the arms' motions and their robot"):
        validate_grasps(beside_box(made.hands), BOX, made.hands, PAPER, "a", robot=made)
    with pytest.raises(NotUsable, match="needs the arms' motions and their robot"):
        validate_grasps(rows, BOX, made.hands, PAPER, "a")
    other = mount_robot(load_rig(write_rig(tmp_path, description="another")), made.hands)
    with pytest.raises(NotUsable, match="made with another rig"):
        judged(other, rows)
    low = replace(CONFIG, path=PathConfig(lift=0.05))
    with pytest.raises(NotUsable, match=r"lift by 0\.050 m .*path\.lift=0\.1"):
        judged(made, with_arms(made, beside_box(made.hands), low))
    with pytest.raises(NotUsable, match="has no test 'a'"):
        judged(made, rows, load_protocol("dexgraspbench-1"))
