"""Left is the mirror image of right: x -> -x of the hand frame, y -> -y of the palm frame."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from bidexdata.hands import load_hand
from bidexdata.hands.kinematics import forward_kinematics, hand_points

MIRROR = np.array([-1.0, 1.0, 1.0])


def test_same_joints_give_the_mirrored_hand(hands, edge_joints):
    left, right = hands
    joints = edge_joints(right, 100)
    pos, _ = forward_kinematics(left, joints)
    expected, _ = forward_kinematics(right, joints)
    np.testing.assert_allclose(pos, expected * MIRROR, atol=1e-6)
    # 1e-6: Menagerie writes its quaternions with six digits.
    for mine, theirs in zip(hand_points(left, joints), hand_points(right, joints), strict=True):
        np.testing.assert_allclose(mine, theirs * MIRROR, atol=3e-6)


def test_sides_share_limits_coupling_postures_and_sphere_sizes(hands):
    left, right = hands
    for field in ("joint_lower", "joint_upper", "coupling", "posture_open", "posture_curved",
                  "sphere_radius", "self_pairs", "contact_radius"):  # fmt: skip
        np.testing.assert_array_equal(getattr(left, field), getattr(right, field), err_msg=field)
    assert left.spec_hash != right.spec_hash
    assert left.contact_names == right.contact_names


def test_masses_are_mirrored(hands):
    models = [hand.make_spec().compile() for hand in hands]
    np.testing.assert_allclose(models[0].body_mass, models[1].body_mass, atol=1e-9)
    assert models[0].body_mass.sum() == pytest.approx(0.694, abs=1e-3)


def test_built_in_collision_geometry_is_mirrored():
    points = []
    for side in ("left", "right"):
        model = load_hand("capsule", side).make_spec().compile()
        data = mujoco.MjData(model)
        data.qpos[:] = 0.3
        mujoco.mj_forward(model, data)
        points.append(data.geom_xpos.copy())
    np.testing.assert_allclose(points[0], points[1] * MIRROR, atol=1e-6)


def test_palm_frame_faces_out_of_the_palm_with_x_along_the_fingers(hand):
    R, p = hand.T_hand_palm[:3, :3], hand.T_hand_palm[:3, 3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    # +z towards the pads of the closed fingers, +x towards the tips of the straight ones.
    straight = hand_points(hand, np.zeros(len(hand.joint_names))).contact
    bent = np.zeros(len(hand.joint_names))
    bent[[n.endswith(("FJ3", "FJ2")) for n in hand.joint_names]] = 0.8
    closed = hand_points(hand, bent).contact
    four = [i for i in range(hand.fingertips) if hand.contact_finger[i] != "th"]
    in_palm = (straight - p) @ R
    assert np.all(in_palm[four, 0] > 0.05)
    assert np.all(((closed - straight) @ R)[four, 2] > 0.02)
    # +y completes it: towards the little finger of the right hand, away from it on the left.
    lf, ff = hand.contact_names.index("lf"), hand.contact_names.index("ff")
    assert np.sign(in_palm[lf, 1] - in_palm[ff, 1]) == (1 if hand.side == "right" else -1)


def test_both_palm_frames_are_mirror_images(hands):
    left, right = hands
    M = np.diag([-1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(
        left.T_hand_palm, M @ right.T_hand_palm @ np.diag([1.0, -1.0, 1.0, 1.0]), atol=1e-12
    )
