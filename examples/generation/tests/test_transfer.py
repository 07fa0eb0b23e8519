"""Grasps carried from the nearest training object: the baseline without learning."""

from __future__ import annotations

import pytest
import torch
from bidexgrasp_model.data import Cases
from bidexgrasp_model.places import places_of_split, release_clouds
from bidexgrasp_model.rotations import matrix_from_vector
from bidexgrasp_model.state import GRASP, Poses
from bidexgrasp_model.transfer import carried, known_cases, transfer

from bidexdata import Release

ZERO, ONE = torch.zeros(3), torch.tensor(0.2)


@pytest.fixture(scope="module")
def stored(release, config) -> Poses:
    cases = Cases(release, config, augment=False)
    return cases.batch([cases[0]]).poses


def test_to_the_same_sphere_grasps_come_as_they_are(stored):
    found = carried(stored, ZERO, ONE, torch.eye(3), ZERO, ONE, stored.joints.shape[-1])
    for a, b in zip(found, stored, strict=True):
        torch.testing.assert_close(a, b, atol=1e-5, rtol=0)


def test_to_a_sphere_of_twice_the_size_wrists_go_twice_as_far(stored):
    """The anchor and dt grow alike, so wrists scale about the centre; hands do not."""
    to = torch.tensor([0.5, -0.1, 0.3])
    found = carried(stored, ZERO, ONE, torch.eye(3), to, 2 * ONE, stored.joints.shape[-1])
    torch.testing.assert_close(
        found.pos[:, :, GRASP], 2 * stored.pos[:, :, GRASP] + to, atol=1e-5, rtol=0
    )
    torch.testing.assert_close(found.rot, stored.rot, atol=1e-5, rtol=0)
    torch.testing.assert_close(found.joints, stored.joints, atol=1e-6, rtol=0)
    step = stored.pos[:, :, 0] - stored.pos[:, :, GRASP]
    torch.testing.assert_close(found.pos[:, :, 0] - found.pos[:, :, GRASP], step, atol=1e-5, rtol=0)


def test_with_the_object_turned_grasps_turn_along(stored):
    R = matrix_from_vector(torch.tensor([0.0, 0, 2.0]))
    found = carried(stored, ZERO, ONE, R, ZERO, ONE, stored.joints.shape[-1])
    torch.testing.assert_close(found.pos, stored.pos @ R.T, atol=1e-5, rtol=0)
    torch.testing.assert_close(found.rot, R @ stored.rot, atol=1e-5, rtol=0)


def test_the_nearest_object_of_a_training_scene_is_itself(release, config):
    opened = Release.open(release)
    known = known_cases(release, config, "suc_l or not suc_l")
    ranks = [len(p.pos) for p in known.poses]
    places = [p for p in places_of_split(opened, "train") if round(1000 * p.size) == 300]
    clouds = release_clouds(opened, places, config.model.points)
    found = transfer(known, clouds, [300] * len(places), 1, config, known.poses[0].joints.shape[-1])
    assert min(ranks) > 0
    best = torch.cat([p.pos[:1] for p in known.poses])
    gaps = (found.poses.pos[:, None] - best[None]).flatten(2).norm(dim=-1).min(dim=1).values
    assert gaps.median() < 1e-4, "scenes without a grasp of their own take another's"
