"""Laws of joint trajectories: of what is written of one motion."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from made_arms import KNOTS, made_rig
from made_release import made_rows

from bidexdata.formats.exporters.trajectories import (
    csv_text,
    finger_path,
    joint_groups,
    phase_of_knots,
    ros_messages,
)
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import KEY_FRAMES, PHASES

ENDS = np.cumsum([0, *KNOTS])


@pytest.fixture(scope="module")
def rows() -> GraspBatch:
    batch = made_rows("box-aaaaaaaa", setting="tabletop", arms=True).batch
    return batch.select(batch["arm_status"] == Status.OK)


def table(batch: GraspBatch, row: int) -> tuple[list[str], list[list[str]]]:
    head, *lines = csv.reader(io.StringIO(csv_text(batch, row)))
    return head, lines


def test_a_table_gives_every_stored_angle_back_to_the_bit(rows):
    for row in range(len(rows)):
        head, lines = table(rows, row)
        time = np.array([line[0] for line in lines], np.float32)
        np.testing.assert_array_equal(time, rows["arm_time"][row])
        assert (np.diff(time) > 0).all()
        assert [line[1] for line in lines] == phase_of_knots(KNOTS)
        columns = dict(zip(head, np.array(lines).T, strict=True))
        for h, arm in enumerate(rows.header.arms):
            for j, name in enumerate(arm.joint_names):
                found = columns[f"{arm.side}/{name}"].astype(np.float32)
                np.testing.assert_array_equal(found, rows["arm_path"][row, h, :, j])
        names = [f"{a.side}/{n}" for a in rows.header.arms for n in a.joint_names]
        names += [f"{h.side}/{n}" for h in rows.header.hands for n in h.joint_names]
        assert head == ["time", "phase", *names]


def test_the_last_row_is_the_end_of_the_lift_and_key_frames_end_their_phases(rows):
    for row in range(len(rows)):
        _, lines = table(rows, row)
        left = len(made_rig().arms[0].joint_names)
        for k, frame in enumerate(KEY_FRAMES):
            angles = np.array(lines[ENDS[k]][2 : 2 + left], np.float32)
            np.testing.assert_array_equal(angles, rows["arm_joints"][row, 0, k, :left])
            if frame != "home":
                assert lines[ENDS[k]][1] == PHASES[k - 1]
                assert ENDS[k] == len(lines) - 1 or lines[ENDS[k] + 1][1] == PHASES[k]
        assert lines[-1][1] == "lift"


def test_fingers_are_at_the_stages_when_their_phases_end(rows):
    joints = rows["joints"][0]
    path = finger_path(joints, KNOTS)
    reach, close, squeeze = ENDS[2], ENDS[3], ENDS[4]
    still = np.repeat(joints[:, :1], reach + 1, axis=1)
    np.testing.assert_array_equal(path[:, : reach + 1], still)
    np.testing.assert_array_equal(path[:, close], joints[:, 1])
    np.testing.assert_array_equal(
        path[:, squeeze:], np.repeat(joints[:, 2:], KNOTS[-1] + 1, axis=1)
    )
    half = (joints[:, 0] + joints[:, 1]) / 2
    np.testing.assert_allclose(path[:, reach + KNOTS[2] // 2], half, atol=1e-6)


def test_messages_name_the_joints_of_each_controller_and_hold_the_same_angles(rows):
    groups = joint_groups(rows, 0)
    messages = dict(ros_messages(rows, 0))
    assert list(messages) == ["left_arm", "right_arm", "left_hand", "right_hand"]
    for group, message in zip(groups, messages.values(), strict=True):
        assert message["header"]["frame_id"] == "world"
        assert message["joint_names"] == list(group.joint_names)
        positions = np.array([p["positions"] for p in message["points"]], np.float32)
        np.testing.assert_array_equal(positions, group.path)
        stamps = [p["time_from_start"] for p in message["points"]]
        assert all(0 <= s["nanosec"] < 10**9 for s in stamps)
        whole = np.array([s["sec"] * 10**9 + s["nanosec"] for s in stamps])
        assert whole[0] == 0
        assert (np.diff(whole) > 0).all()
        np.testing.assert_allclose(whole * 1e-9, rows["arm_time"][0], atol=1e-8)


def test_a_controller_of_ros2_control_goes_in_straight_lines_between_the_points(rows):
    # It takes a cubic where both ends of a segment give velocities, a quintic where also
    # accelerations, and else a line. A message gives none, so that no segment is curved.
    for _, message in ros_messages(rows, 0):
        for point in message["points"]:
            assert point["velocities"] == point["accelerations"] == point["effort"] == []


def test_one_knot_per_phase_is_enough():
    joints = np.arange(6, dtype=np.float32).reshape(1, 3, 2)
    path = finger_path(joints, (1, 1, 1, 1, 1))
    np.testing.assert_array_equal(path[0], joints[0, [0, 0, 0, 1, 2, 2]])
