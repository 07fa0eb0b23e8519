"""What refinement does to grasps: pads come to the surface, nothing is left in it, no steps change nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from bidexgrasp_model.anchors import Anchor
from bidexgrasp_model.checkpoint import HandId
from bidexgrasp_model.config import RefineConfig
from bidexgrasp_model.data import Cases
from bidexgrasp_model.hand_shape import HandShapes
from bidexgrasp_model.places import places_of_split, release_clouds
from bidexgrasp_model.refine import refined
from bidexgrasp_model.sampling import best_of
from bidexgrasp_model.single_view import bodies_of
from bidexgrasp_model.state import GRASP, PREGRASP, Layout, Scale, decode, encode
from bidexgrasp_model.surfaces import Surface, estimated_surface, known_surface

from bidexdata import Release


@pytest.fixture(scope="module")
def scene(release, config):
    """Stored grasps as normalised states about frames at their wrists, their surfaces and hands."""
    cases = Cases(release, config, augment=False)
    batch = cases.batch([cases[k] for k in range(len(cases))])
    opened = Release.open(release)
    hands = HandShapes.of_release(release, 32)
    left, right = (m.hand for m in hands.models)
    limits = HandId(
        names=("capsule", "capsule"),
        joint_names=(left.joint_names, right.joint_names),
        lower=(tuple(left.joint_lower.tolist()), tuple(right.joint_lower.tolist())),
        upper=(tuple(left.joint_upper.tolist()), tuple(right.joint_upper.tolist())),
    )
    pos = batch.poses.pos[:, :, GRASP]
    anchor = Anchor(pos, torch.eye(3).expand(*pos.shape, 3).contiguous())
    layout = Layout(limits.joints)
    scale = Scale(torch.zeros(2, layout.width), layout.least().expand(2, -1))
    state = scale.normalised(encode(batch.poses, anchor))
    table = torch.zeros(len(batch.case))
    surface = Surface(batch.solid[batch.case], batch.normals[batch.case], table)
    return opened, hands, limits, anchor, layout, scale, state, surface


def _overlap(scene, state, stage):
    """Sum over key spheres of their depths in the convex pieces of each grasp's object [m]."""
    opened, hands, _limits, anchor, layout, scale, _, surface = scene
    poses = decode(scale.restored(state), anchor, layout)
    keys = hands(poses.pos[:, :, stage], poses.rot[:, :, stage], poses.joints[:, :, stage]).keys
    found = []
    for place in places_of_split(opened, "train"):
        cloud = release_clouds(opened, [place], surface.points.shape[1])[0]
        own = (surface.points - cloud).abs().amax((1, 2)) < 1e-6
        pieces = bodies_of(opened.load_solid(place.object_id).pieces)
        bodies = [b.moved(place.turn, place.size, np.array(place.pos)) for b in pieces]
        points = keys[own].double().numpy()
        height = np.min([(points @ b.normal.T - b.offset).max(-1) for b in bodies], axis=0)
        found.append((hands.radius.numpy() - height).clip(0).sum(-1))
    return np.concatenate(found)


def test_hands_that_were_pushed_into_the_object_come_out(scene):
    _, hands, limits, anchor, _, scale, state, surface = scene
    inward = torch.nn.functional.normalize(surface.points.mean(1)[:, None] - anchor.pos, dim=-1)
    pushed = state.clone()
    pushed[..., :3] += 0.02 * inward / scale.std[:, :3]
    config = RefineConfig(steps=40, rate=0.2, within=0.0)
    found, _ = refined(pushed, anchor, surface, hands, limits, scale, config)
    for stage in (PREGRASP, GRASP):
        before, after = _overlap(scene, pushed, stage).sum(), _overlap(scene, found, stage).sum()
        assert before > 0.1
        assert after < 0.2 * before


def test_what_is_left_is_less_after_more_steps_and_more_where_hands_were_pushed_in(scene):
    _, hands, limits, anchor, _, scale, state, surface = scene
    pushed = state.clone()
    pushed[..., :3] += 1.5
    left = {
        steps: refined(
            pushed, anchor, surface, hands, limits, scale, RefineConfig(steps=steps, rate=0.2)
        )[1].mean()
        for steps in (0, 10, 40)
    }
    assert left[0] > left[10] > left[40]
    still = RefineConfig(steps=0)
    assert refined(state, anchor, surface, hands, limits, scale, still)[1].mean() < left[0]


def test_of_several_draws_the_one_with_least_left_is_kept():
    left = torch.tensor([3.0, 1.0, 2.0, 0.5, 0.7, 0.1])
    assert best_of(left, 3).tolist() == [1, 5]
    assert best_of(left, 1).tolist() == [0, 1, 2, 3, 4, 5]


def test_what_a_pregrasp_wants_leaves_its_grasp_alone(scene):
    """With a clearance that the pre-grasp lacks only the numbers of the pre-grasp move."""
    _, hands, limits, anchor, layout, scale, state, surface = scene
    free = surface._replace(table=torch.full_like(surface.table, -torch.inf))
    config = RefineConfig(steps=5, within=0.0, self=0.0, contact=0.0, object=0.0)
    still, _ = refined(state, anchor, free, hands, limits, scale, config)
    assert torch.equal(still, state), "nothing asks for anything"
    config = dataclasses.replace(config, clear=0.2, table=64000.0)
    found, _ = refined(state, anchor, surface, hands, limits, scale, config)
    own = 9 + layout.joints
    assert torch.equal(found[..., :own], state[..., :own])
    assert not torch.equal(found, state)


def test_hands_leave_the_table_also_where_no_point_of_their_surface_is_in_it(scene):
    opened, _, limits, anchor, layout, scale, state, surface = scene
    hands = HandShapes.of_release(opened.path, 1)

    def depth(state):
        poses = decode(scale.restored(state), anchor, layout)
        shape = hands(poses.pos[:, :, GRASP], poses.rot[:, :, GRASP], poses.joints[:, :, GRASP])
        return (hands.radius - shape.keys[..., 2]).clamp(min=0).amax(1)

    lowered = state.clone()
    poses = decode(scale.restored(state), anchor, layout)
    shape = hands(poses.pos[:, :, GRASP], poses.rot[:, :, GRASP], poses.joints[:, :, GRASP])
    room = (shape.keys[..., 2] - hands.radius).amin(1) + 0.006
    lowered[..., 2] -= room[:, None] / scale.std[:, 2]
    config = RefineConfig(steps=40, rate=0.2, within=0.0, object=0.0)
    found, _ = refined(lowered, anchor, surface, hands, limits, scale, config)
    before, after = depth(lowered), depth(found)
    assert before.min() > 5e-3
    assert after.mean() < 0.5 * before.mean()
    floating = surface._replace(table=torch.full_like(surface.table, -torch.inf))
    found, _ = refined(lowered, anchor, floating, hands, limits, scale, config)
    assert depth(found).mean() > 0.8 * before.mean(), "where nothing lies below nothing is lifted"


def test_the_squeeze_keeps_what_it_is_relative_to_the_grasp_and_no_steps_change_nothing(scene):
    _, hands, limits, anchor, layout, scale, state, surface = scene
    config = RefineConfig(steps=3)
    found, _ = refined(state, anchor, surface, hands, limits, scale, config)
    behind = 9 + layout.joints + 6 + layout.joints
    assert torch.equal(found[..., behind:], state[..., behind:])
    assert not torch.equal(found, state)
    still, _ = refined(
        state, anchor, surface, hands, limits, scale, dataclasses.replace(config, steps=0)
    )
    assert torch.equal(still, state)


def test_estimated_normals_are_those_of_the_pieces_on_a_box(scene):
    opened = scene[0]
    boxes = [p for p in places_of_split(opened, "train") if p.object_id.startswith("box")]
    known = known_surface(opened, boxes)
    found = estimated_surface(known.points, known.table)
    alike = (found.normals * known.normals).sum(-1)
    torch.testing.assert_close(
        known.normals.norm(dim=-1), torch.ones_like(alike), atol=1e-4, rtol=0
    )
    assert (alike > 0.9).float().mean() > 0.6  # edges have no normal of their own
    assert (alike > -0.1).float().mean() > 0.95
