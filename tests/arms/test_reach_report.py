"""Generic pairs and what a robot makes of them; the checks of a rig."""

from __future__ import annotations

import json

import numpy as np
import pytest
from made_rig import rig_data, write_rig

from bidexdata.arms.chain import chain_forward
from bidexdata.arms.generic_pairs import (
    GAP,
    OPPOSED,
    distance,
    draw_pairs,
    generic_shapes,
    shape_grid,
)
from bidexdata.arms.inverse_kinematics import IkConfig
from bidexdata.arms.mount_gap import mount_gaps
from bidexdata.arms.reach_report import REASONS, reach_report, report_pairs
from bidexdata.arms.registry import load_rig
from bidexdata.arms.robot import mount_robot, robot_spec
from bidexdata.arms.views import axis_parts, footprint_radius
from bidexdata.cli.main import COMMANDS, run
from bidexdata.hands import load_hands
from bidexdata.objects.distance_field import signed_distance
from bidexdata.runs import check_rig


def test_palms_of_generic_pairs_stand_off_the_surface_and_look_at_it(rng):
    pairs = draw_pairs(0.5, 60, rng)
    for k in range(60):
        shape = generic_shapes()[pairs.shape[k]]
        local = (pairs.palm_pos[k] - pairs.object_pos[k]) @ pairs.object_rot[k] / 0.5
        # Ellipsoids are to first order.
        np.testing.assert_allclose(0.5 * distance(shape, local), GAP, atol=2e-3)
        ahead = pairs.palm_pos[k] + 2 * GAP * pairs.palm_rot[k, :, :, 2]
        inside = (ahead - pairs.object_pos[k]) @ pairs.object_rot[k] / 0.5
        assert np.all(distance(shape, inside) < 0)
        assert pairs.palm_pos[k, 0, 1] + GAP >= pairs.palm_pos[k, 1, 1] - GAP
        assert pairs.palm_rot[k, 0, :, 2] @ pairs.palm_rot[k, 1, :, 2] < OPPOSED
    turned = pairs.palm_rot @ np.swapaxes(pairs.palm_rot, -1, -2)
    np.testing.assert_allclose(turned, np.broadcast_to(np.eye(3), turned.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(pairs.palm_rot), 1.0)


@pytest.mark.parametrize("number", range(9))
def test_the_grid_of_a_shape_is_its_distance(number, rng):
    shape = generic_shapes()[number]
    assert abs(2 * np.linalg.norm(shape.half) - 1) < 1e-12
    points = rng.uniform(-0.4, 0.4, (200, 3))
    found = signed_distance(shape_grid(number), 1.0, points)[0]
    near = np.abs(distance(shape, points)) < 0.15
    assert np.abs(found - distance(shape, points))[near].max() < 0.03


def test_what_is_reached_is_reached_and_every_pair_has_one_reason(made):
    report = reach_report(made, report_pairs(10))
    assert sum(report.share(reason) for reason in REASONS) == pytest.approx(1.0)
    assert report.share() > 0.5
    good = report.reason == 0
    assert np.isfinite(report.q[good]).all()
    assert np.isnan(report.q[~good]).all()
    for h, (arm, hand) in enumerate(zip(made.arms, made.hands, strict=True)):
        pos, rot = chain_forward(arm.chain, report.q[good, h])
        palm = pos + rot @ hand.T_hand_palm[:3, 3]
        assert np.linalg.norm(palm - report.pairs.palm_pos[good, h], axis=1).max() < 2e-3


def test_a_report_does_not_depend_on_the_order_of_its_pairs(made, rng):
    pairs = report_pairs(4)
    order = rng.permutation(len(pairs.size))
    turned = type(pairs)(*(column[order] for column in pairs))
    first, second = reach_report(made, pairs), reach_report(made, turned)
    np.testing.assert_array_equal(second.reason, first.reason[order])
    np.testing.assert_array_equal(second.q, first.q[order])


def test_bases_far_away_reach_nothing(tmp_path):
    places = {
        side: {**rig_data()[side], "pos": [0.0, 3.0 * sign, 0.2]}
        for side, sign in (("left", 1), ("right", -1))
    }
    robot = mount_robot(load_rig(write_rig(tmp_path, **places)), load_hands("capsule"))
    assert reach_report(robot, report_pairs(3), IkConfig(starts=4)).share("reach") == 1.0


@pytest.mark.slow
def test_a_rig_that_works_passes_every_check_and_is_drawn(tmp_path, capsys):
    out = tmp_path / "rig.png"
    assert run(["rigs", "check", str(write_rig(tmp_path)), "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["passed"]
    assert all(check["passed"] for check in said["checks"])
    assert said["hand"] == "capsule"
    assert out.stat().st_size > 10_000


def test_a_rig_that_cannot_be_loaded_fails_one_check_with_exit_code_3(tmp_path, capsys):
    path = write_rig(tmp_path)
    (tmp_path / "arm.xml").unlink()
    out = tmp_path / "rig.png"
    assert run(["rigs", "check", str(path), "--out", str(out)]) == 3
    said = capsys.readouterr()
    assert "arm.xml: no such file" in said.out
    assert "rig made does not pass 1 check: model" in said.err
    assert not out.exists()
    for how in ("--quiet", "--json"):  # nobody reads the table of checks then
        assert run(["rigs", "check", str(path), "--out", str(out), how]) == 3
        assert "arm.xml: no such file" in capsys.readouterr().err


def test_a_hand_in_the_air_is_measured_from_the_last_link(tmp_path):
    def gaps(forward: float):
        mount = {**rig_data()["mounts"]["*"], "pos": [0.04, 0, forward]}
        folder = tmp_path / f"{forward:g}"
        folder.mkdir()
        path = write_rig(folder, mounts={"*": mount})
        robot = mount_robot(load_rig(path), load_hands("capsule"))
        return np.array(mount_gaps(robot, robot_spec(robot).compile()))

    near, far = gaps(0.12), gaps(0.22)
    np.testing.assert_allclose(far - near, 0.1, atol=0.01)  # along the flange's axis
    assert near[0] == pytest.approx(near[1], abs=1e-3)
    robot = mount_robot(load_rig(tmp_path / "0.22" / "made.yaml"), load_hands("capsule"))
    (said,) = check_rig._hanging(robot, robot_spec(robot).compile())
    assert said.passed
    assert f"left {1e3 * far[0]:.0f} mm" in said.says


def test_the_map_has_a_tick_at_every_place_and_a_footprint_of_the_largest_objects():
    low = [np.min([p.vertices[:, k].min() for p in axis_parts(0.3)]) for k in range(2)]
    assert low[0] < -0.5
    assert low[1] < -0.6  # outside of the balls
    ticks = len(axis_parts(0.3)) - 2
    assert ticks == 11 + 13
    pairs = report_pairs(3)
    radius = footprint_radius(pairs)
    assert 0.2 < radius <= pairs.size.max() / 2 + 1e-6


@pytest.mark.slow
def test_weak_arms_a_bad_rest_and_far_bases_fail_their_checks(tmp_path, capsys):
    changes = {
        "arm": rig_data()["arm"] | {"payload": 0.3},
        "left": {**rig_data()["left"], "pos": [0.0, 2.5, 0.2]},
        "right": {**rig_data()["right"], "rest": [0.0, 2.0, 0.0, -2.0, 0.0, -2.0, 0.0]},
    }
    path = write_rig(tmp_path, **changes)
    assert run(["rigs", "check", str(path), "--out", str(tmp_path / "r.png"), "--json"]) == 3
    failed = {c["check"]: c["says"] for c in json.loads(capsys.readouterr().out)["checks"]
              if c["passed"] is False}  # fmt: skip
    assert {"payload", "reach"} <= set(failed)
    assert "carries 0.3 kg" in failed["payload"]


def test_rigs_are_listed_and_an_unknown_one_is_one_sentence(tmp_path, capsys):
    assert run(["rigs", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["rigs"]
    assert {"ur10e_post", "iiwa14_facing", "xarm7_leap"} <= {rig["name"] for rig in listed}
    assert run(["rigs", "check", "nothing", "--out", str(tmp_path / "x.png")]) == 3
    assert "no rig is called 'nothing'" in capsys.readouterr().err
    assert run(["rigs", "check", "ur10e_post", "--object-mass", "-1"]) == 2
    assert "rigs" in COMMANDS
