"""Real hands through specs alone: every law of `hands check`, and grasps that hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bidexdata.hands import load_hands
from bidexdata.hands.mirror import twin_joints
from bidexdata.hands.registry import hand_spec
from bidexdata.runs.check_hand import inspect_hand, try_grasps

FOLDERS = {"leap": "leap_hand", "allegro": "wonik_allegro"}


@pytest.fixture(params=FOLDERS)
def name(request: pytest.FixtureRequest, menagerie: Path) -> str:
    folder = FOLDERS[request.param]
    if not (menagerie / folder).is_dir():
        pytest.skip(f"needs {folder} in MENAGERIE_ROOT (a local copy of MuJoCo Menagerie)")
    return request.param


def test_the_spec_fits_its_models(name):
    findings, hands = inspect_hand(name)
    assert [f for f in findings if f.passed is not True] == []
    assert len(hands) == 2
    for hand in hands:
        assert (len(hand.joint_names), len(hand.actuator_names)) == (16, 16)
        assert len(hand.fingers) == hand.fingertips == 4
        assert hand.contact_part == ("fingertip",) * 4 + ("palm",) * 5


def test_joints_that_spread_the_fingers_turn_the_other_way_on_the_other_side(name):
    left, right = load_hands(name)
    _, factor = twin_joints(hand_spec(name), right, left)
    spread = [joint.endswith(("_rot", "j0")) for joint in right.joint_names]
    fingers = np.array(spread) & ~np.char.startswith(right.joint_names, "th")
    assert fingers.sum() == 3
    assert np.all(factor[fingers] == -1)
    flexing = ~np.array(spread) & ~np.char.startswith(right.joint_names, "th")
    assert np.all(factor[flexing] == 1)


def test_both_hands_hold_a_box(name):
    trial = try_grasps(load_hands(name), 0)
    assert trial.batch["contact_force"].shape[2] == 9
    assert trial.success.sum() >= 3
