"""HandModel: links, keypoints and surface from joints, with and without the hand's meshes."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest
import torch
from made_release import OBJECTS, made_release

from bidexdata.errors import BadConfig, Contradiction, MissingExtra, PathNotFound, UnknownName
from bidexdata.formats.hand_files import write_hand
from bidexdata.formats.release import Release
from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.hands import load_hand, load_hands
from bidexdata.hands.kinematics import forward_kinematics, hand_points
from bidexdata.hands.torch_layer import HandModel
from bidexdata.hands.tree_file import read_hand
from bidexdata.hands.urdf import hand_urdf

EXACT = 1e-6  # pytorch-kinematics reads a tree into float32
METRES = 1e-5


def posed(hand, rng, edge_joints, dtype=torch.float64):
    joints = edge_joints(hand, 20)
    pos, quat = rng.uniform(-0.5, 0.5, (len(joints), 3)), random_quat(rng, (len(joints),))
    model = HandModel(hand)
    pose = model(*(torch.as_tensor(x, dtype=dtype) for x in (pos, quat, joints)))
    return model, pose, pos, quat, joints


def test_links_are_where_both_other_engines_put_them(hand, rng, edge_joints):
    model, pose, pos, quat, joints = posed(hand, rng, edge_joints)
    T = model.link_poses(pose).numpy()
    R = matrix_from_quat(quat)[:, None]
    body_pos, body_rot = forward_kinematics(hand, joints)
    np.testing.assert_allclose(T[..., :3, :3], R @ body_rot, atol=EXACT)
    expected = (R @ body_pos[..., None])[..., 0] + pos[:, None]
    np.testing.assert_allclose(T[..., :3, 3], expected, atol=EXACT)
    assert np.array_equal(T[..., 3, :], np.broadcast_to([0, 0, 0, 1], T[..., 3, :].shape))
    import pytorch_kinematics

    chain = pytorch_kinematics.build_chain_from_urdf(hand_urdf(hand)).to(dtype=torch.float64)
    angles = {n: torch.as_tensor(joints[:, k]) for k, n in enumerate(hand.joint_names)}
    placed = chain.forward_kinematics(angles)
    for name in hand.body_names[1:]:
        theirs = placed[name].get_matrix().numpy()
        mine = model.link_poses(pose, [name]).numpy()[:, 0]
        np.testing.assert_allclose(mine[:, :3, :3], R[:, 0] @ theirs[:, :3, :3], atol=EXACT)


def test_keypoints_are_contact_points_and_bodies_by_name(hand, rng, edge_joints):
    model, pose, pos, quat, joints = posed(hand, rng, edge_joints)
    names = [hand.contact_names[1], hand.body_names[2], hand.contact_names[0]]
    found = model.keypoints(pose, names).numpy()
    contact = hand_points(hand, joints, pos, quat).contact
    np.testing.assert_allclose(found[:, 0], contact[:, 1], atol=EXACT)
    np.testing.assert_allclose(found[:, 2], contact[:, 0], atol=EXACT)
    np.testing.assert_allclose(found[:, 1], pose.body_pos[:, 2], atol=EXACT)
    assert set(names) <= set(model.keypoint_names)
    for read in (model.keypoints, model.link_poses):
        with pytest.raises(UnknownName, match="elbow"):
            read(pose, ["elbow"])


def test_surface_points_lie_on_a_sphere_and_in_none_of_their_body(hand, rng, edge_joints):
    model, pose, *_ = posed(hand, rng, edge_joints)
    points, normals = model.surface_points(pose), model.surface_normals(pose)
    assert points.shape == (len(pose.body_pos), 512, 3)
    gap = torch.cdist(points, pose.sphere_pos) - torch.as_tensor(hand.sphere_radius)
    assert gap.abs().amin(-1).max() < 1e-9
    torch.testing.assert_close(normals.norm(dim=-1), torch.ones(points.shape[:2], dtype=torch.float64))  # fmt: skip
    # A step along the normal leaves the sphere that the point is on.
    out = torch.cdist(points + 0.001 * normals, pose.sphere_pos) - torch.as_tensor(hand.sphere_radius)  # fmt: skip
    nearest = gap.abs().argmin(-1, keepdim=True)
    torch.testing.assert_close(out.gather(-1, nearest), torch.full_like(nearest, 0.001, dtype=torch.float64), atol=1e-9, rtol=0)  # fmt: skip
    again = HandModel(hand, surface_points=7)
    assert again.surface_points(pose).shape == (len(points), 7, 3)


def test_everything_is_differentiable_in_pose_and_joints(rng):
    hand = load_hand("capsule", "right")
    model = HandModel(hand, surface_points=9)
    inputs = (
        torch.zeros(2, 3, dtype=torch.float64, requires_grad=True),
        torch.tensor(random_quat(rng, (2,)), requires_grad=True),
        torch.tensor(np.tile(hand.posture_curved, (2, 1)), requires_grad=True),
    )

    def values(pos, quat, joints):
        pose = model(pos, quat, joints)
        parts = (model.surface_points(pose), model.keypoints(pose, ["ff", "rh_palm"]))
        return sum((p * torch.sin(torch.arange(p.numel()).reshape(p.shape))).sum() for p in parts)

    assert torch.autograd.gradcheck(values, inputs)
    pose = model(*inputs)
    (gradient,) = torch.autograd.grad(model.link_poses(pose)[..., :3, 3].sum(), inputs[0])
    torch.testing.assert_close(gradient, torch.full_like(gradient, len(hand.body_names)))


def test_padded_joints_are_left_out_and_too_few_are_refused(rng):
    hand = load_hand("capsule", "left")
    model = HandModel(hand)
    pos, quat = torch.zeros(3), torch.tensor([1.0, 0, 0, 0])
    joints = torch.as_tensor(hand.posture_curved, dtype=torch.float32)
    padded = torch.cat([joints, torch.full((2,), float("nan"))])
    assert torch.equal(model(pos, quat, padded).body_pos, model(pos, quat, joints).body_pos)
    with pytest.raises(ValueError, match="this hand has 22 joints, and 21 are given"):
        model(pos, quat, joints[:-1])


def test_the_hand_of_a_release_is_the_hand_it_was_made_with(hand, tmp_path, rng, edge_joints):
    write_hand(tmp_path, hand)
    model = HandModel.from_release(tmp_path, hand.side)
    for field in fields(hand):
        if field.name in ("make_spec", "make_mounted", "licence_text"):
            continue
        mine, theirs = getattr(model.hand, field.name), getattr(hand, field.name)
        np.testing.assert_array_equal(mine, theirs, err_msg=field.name)
    joints = torch.as_tensor(edge_joints(hand, 5))
    pos, quat = torch.zeros(len(joints), 3, dtype=torch.float64), torch.tensor([1.0, 0, 0, 0]).double()  # fmt: skip
    pose, other = (m(pos, quat.expand(len(joints), 4), joints) for m in (model, HandModel(hand)))
    assert all(torch.equal(a, b) for a, b in zip(pose, other, strict=True))
    with pytest.raises(BadConfig, match="without its meshes"):
        model.hand.make_spec()


def test_rows_of_a_release_put_the_pads_on_their_contact_points(tmp_path):
    root = made_release(tmp_path / "r", OBJECTS[:1], hands=load_hands("capsule"))
    batch = Release.open(root).grasps()
    for h, side in enumerate(("left", "right")):
        model = HandModel.from_release(Release.open(root), side)
        inputs = (batch[n][:, h, 1] for n in ("hand_pos", "hand_quat_wxyz", "joints"))
        pose = model(*(torch.as_tensor(x) for x in inputs))
        radius = model.hand.contact_radius[:, None]
        centres = batch["contact_point"][:, h] + radius * batch["contact_normal"][:, h]
        np.testing.assert_allclose(pose.contact_point, centres, atol=METRES)


def test_a_release_without_that_hand_or_with_a_broken_one_is_said(tmp_path):
    with pytest.raises(PathNotFound, match=r"tree\.json of a left hand"):
        HandModel.from_release(tmp_path, "left")
    for text in ("{", json.dumps({"name": "made"}), "[]"):
        path = tmp_path / "tree.json"
        path.write_text(text)
        with pytest.raises(Contradiction, match="not the tree of a hand"):
            read_hand(path)


def test_without_pytorch_kinematics_the_pip_line_is_named(monkeypatch):
    monkeypatch.setattr("bidexdata.hands.torch_layer.find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r"pip install 'bidexdata\[synth\]'"):
        HandModel(load_hand("capsule", "left"))


@pytest.mark.parametrize("place", ["bidexdata", "bidexdata.loaders"])
def test_without_torch_the_pip_line_is_named(place):
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from bidexdata.errors import MissingExtra\n"
        f"try:\n    from {place} import HandModel\n"
        "except MissingExtra as err:\n    print(err)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("pip install 'bidexdata[synth]'")
