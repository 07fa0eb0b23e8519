"""Laws of pre-grasps that are made of grasps."""

import numpy as np
import pytest
from made_objects import box_object

from bidexdata.config import fingerprint, to_plain, with_overrides
from bidexdata.errors import BadConfig
from bidexdata.frames import matrix_from_quat
from bidexdata.hands import load_hands
from bidexdata.record import Scene
from bidexdata.synthesis.opening import LEAST_CLOSING, closing_joints
from bidexdata.synthesis.pipeline import synthesize
from bidexdata.synthesis.presets import load_preset

PALM, JOINTS = 0.01, 0.1
FLOAT32 = 1e-5
SHORT = ("regions.anchors=40", "optimise.approach.steps=20", "optimise.grasp.steps=10")


@pytest.fixture(scope="module")
def hands():
    return load_hands("capsule")


@pytest.fixture(scope="module")
def batches(hands):
    obj = box_object()
    short = with_overrides(load_preset("paper"), SHORT)
    configs = (short, with_overrides(short, [f"staging.opened=[{PALM}, {JOINTS}]"]))
    scenes = [Scene(obj.object_id, 300)]
    return [synthesize(obj, hands, scenes, c, grasps=4) for c in configs]


def test_the_grasps_stay_and_their_pregrasps_are_others(batches):
    optimised, opened = batches
    for name in ("hand_pos", "hand_quat_wxyz", "joints"):
        np.testing.assert_array_equal(optimised[name][:, :, 1], opened[name][:, :, 1])
        assert not np.array_equal(optimised[name][:, :, 2], opened[name][:, :, 2]) or "quat" in name
    assert np.abs(optimised["joints"][:, :, 0] - opened["joints"][:, :, 0]).max() > 0.01


def test_palms_go_back_and_on_and_closing_joints_open_and_close(batches, hands):
    opened = batches[1]
    pos, quat, joints = (opened[n] for n in ("hand_pos", "hand_quat_wxyz", "joints"))
    np.testing.assert_allclose(quat[:, :, 0], quat[:, :, 1], atol=FLOAT32)
    np.testing.assert_allclose(quat[:, :, 2], quat[:, :, 1], atol=FLOAT32)
    for h, hand in enumerate(hands):
        out = matrix_from_quat(quat[:, h, 1].astype(float)) @ hand.T_hand_palm[:3, 2]
        np.testing.assert_allclose(pos[:, h, 1] - pos[:, h, 0], PALM * out, atol=FLOAT32)
        np.testing.assert_allclose(pos[:, h, 2] - pos[:, h, 1], PALM * out, atol=FLOAT32)
        way = joints[:, h, 1] - joints[:, h, 0]
        wanted = JOINTS * closing_joints(hand, LEAST_CLOSING)
        at_limit = np.isclose(joints[:, h, 0], hand.joint_lower) | np.isclose(
            joints[:, h, 0], hand.joint_upper
        )
        np.testing.assert_allclose(np.where(at_limit, wanted, way), wanted + 0 * way, atol=FLOAT32)
        np.testing.assert_allclose(joints[:, h, 2] - joints[:, h, 1], way, atol=FLOAT32)


def test_a_configuration_without_it_keeps_its_fingerprint_and_says_nothing_of_it():
    config = load_preset("default")
    assert "opened" not in to_plain(config)["staging"]
    changed = with_overrides(config, ["staging.opened=[0.01, 0.1]"])
    assert fingerprint(changed) != fingerprint(config)
    assert with_overrides(changed, ["staging.opened=null"]) == config


@pytest.mark.parametrize("value", ["[0.5, 0.1]", "[0.01, -1]", "[0.01]", "far"])
def test_impossible_ways_are_refused(value):
    with pytest.raises(BadConfig, match=r"staging\.opened"):
        with_overrides(load_preset("default"), [f"staging.opened={value}"])
