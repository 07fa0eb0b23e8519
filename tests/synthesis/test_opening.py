"""Laws of pre-grasps that are made of grasps."""

import numpy as np
import pytest
from made_objects import box_object

from bidexdata.config import fingerprint, to_plain, with_overrides
from bidexdata.errors import BadConfig
from bidexdata.frames import matrix_from_quat
from bidexdata.record import Scene
from bidexdata.synthesis.forces import BaseGive
from bidexdata.synthesis.opening import LEAST_CLOSING, closing_joints, opened, within_limits
from bidexdata.synthesis.pipeline import synthesize
from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.presets import load_preset
from bidexdata.synthesis.staging import Press, StagingConfig, squeeze

PALM, JOINTS = 0.01, 0.1
FLOAT32 = 1e-5
SHORT = ("regions.anchors=40", "optimise.approach.steps=20", "optimise.grasp.steps=10")


@pytest.fixture(scope="module")
def batches(hands):
    obj = box_object()
    short = with_overrides(load_preset("paper"), SHORT)
    configs = (short, with_overrides(short, [f"staging.opened=[{PALM}, {JOINTS}]"]))
    scenes = [Scene(obj.object_id, 300)]
    return [synthesize(obj, hands, scenes, c, grasps=4) for c in configs]


def test_the_grasps_stay_and_their_pregrasps_and_squeezes_are_others(batches):
    """Each one is: palms turn on the way to an optimised grasp, not to one that was opened."""
    optimised, made_of_grasps = batches
    for name in ("hand_pos", "hand_quat_wxyz", "joints"):
        one, other = optimised[name], made_of_grasps[name]
        np.testing.assert_array_equal(one[:, :, 1], other[:, :, 1])
        for stage in (0, 2):
            apart = np.abs(one[:, :, stage] - other[:, :, stage])
            assert np.all(apart.max(axis=(1, 2)) > 10 * FLOAT32), (name, stage)


def test_palms_go_back_and_on_and_closing_joints_open_and_close(batches, hands):
    pos, quat, joints = (batches[1][n] for n in ("hand_pos", "hand_quat_wxyz", "joints"))
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
        on = joints[:, h, 2] - joints[:, h, 1]
        np.testing.assert_allclose(on, wanted + 0 * way, atol=FLOAT32)


def test_a_joint_at_its_stop_cannot_open_but_closes_by_the_whole_angle(hands):
    stops = [
        np.where(closing_joints(h, LEAST_CLOSING) > 0, h.joint_lower, h.joint_upper) for h in hands
    ]
    grasp = Pose(
        np.zeros((1, 2, 3)), np.tile([1.0, 0, 0, 0], (1, 2, 1)), (stops[0][None], stops[1][None])
    )
    before = opened(grasp, hands, palm=PALM, joints=JOINTS)
    none = [np.zeros((1, hand.coupling.shape[1])) for hand in hands]
    still = Press(none, BaseGive(np.zeros((1, 2, 3)), np.zeros((1, 2, 3))))
    target = squeeze(before, grasp, still, hands, StagingConfig(extrapolate=1.0))
    for h, hand in enumerate(hands):
        sense = closing_joints(hand, LEAST_CLOSING)
        assert np.count_nonzero(sense) >= 12
        np.testing.assert_array_equal(within_limits(before, hands).joints[h], grasp.joints[h])
        np.testing.assert_allclose(target.joints[h] - grasp.joints[h], [JOINTS * sense])


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
