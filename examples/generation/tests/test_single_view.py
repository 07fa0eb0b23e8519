"""What one camera sees: of a cloud while training, of the rendered solid while sampling."""

from __future__ import annotations

import numpy as np
import torch
from bidexgrasp_model.data import Cases
from bidexgrasp_model.places import depth_clouds, places_of_split
from bidexgrasp_model.single_view import DISTANCE, depth_cloud, draw_camera, seen_points

from bidexdata import Release

CUBE = [(np.concatenate([np.eye(3), -np.eye(3)]), np.full(6, 0.1))]
"""Faces of a cube of 0.2 m about the origin."""


def test_the_depth_of_a_cube_is_on_the_faces_that_look_at_the_camera():
    camera = np.array([0.9, 0.1, 0.8])
    points = depth_cloud(CUBE, camera, np.zeros(3), 0.2, 400)
    assert len(points) == 400
    on = np.isclose(np.abs(points), 0.1, atol=1e-9)
    assert on.any(axis=1).all()
    seen = {(axis, points[k, axis] > 0) for k, axis in zip(*np.nonzero(on), strict=True)}
    assert {(0, True), (1, False), (2, True)} >= {s for s in seen if s != (1, True)}
    assert (0, True) in seen
    assert (2, True) in seen


def test_a_body_in_front_hides_the_one_behind():
    camera = np.array([1.2, 0, 0])
    wall = (np.concatenate([np.eye(3), -np.eye(3)]), np.array([0.3, 0.2, 0.2, -0.25, 0.2, 0.2]))
    points = depth_cloud([*CUBE, wall], camera, np.zeros(3), 0.4, 300)
    np.testing.assert_allclose(points[:, 0], 0.3, atol=1e-9)


def test_cameras_stand_above_the_table():
    rng = np.random.default_rng(0)
    cameras = np.array([draw_camera(np.array([0, 0, 0.1]), rng) for _ in range(50)])
    assert (cameras[:, 2] > 0.4).all()
    np.testing.assert_allclose(np.linalg.norm(cameras - [0, 0, 0.1], axis=1), DISTANCE)


def test_training_sees_no_point_that_looks_away_or_that_rendered_depth_does_not_see(
    release, config
):
    """On boxes, which hide nothing of themselves but what looks away."""
    case = Cases(release, config, augment=False)[0]
    cloud, normals = case["cloud_solid"], case["cloud_normal"]
    found = seen_points(cloud, normals, torch.Generator().manual_seed(5))
    assert found.shape == cloud.shape
    index = torch.cdist(found, cloud).argmin(-1)
    assert torch.equal(cloud[index], found), "they are points of the cloud"
    assert len(index.unique()) < 0.9 * len(cloud)
    # The camera of this seed, as `seen_points` draws it.
    seed = int(torch.randint(0, 2**31, (1,), generator=torch.Generator().manual_seed(5)))
    camera = draw_camera(cloud.double().mean(0).numpy(), np.random.default_rng(seed))
    facing = ((torch.from_numpy(camera) - found) * normals[index]).sum(-1)
    assert (facing > 0).all()


def test_rendered_clouds_lie_on_the_solid(release, config):
    opened = Release.open(release)
    places = places_of_split(opened, "train")[:2]
    clouds = depth_clouds(opened, places, 256, np.random.default_rng(0))
    for place, cloud in zip(places, clouds, strict=True):
        solid = opened.load_solid(place.object_id)
        corners = np.concatenate([place.in_world(p.vertices) for p in solid.pieces])
        low, high = corners.min(0) - 1e-5, corners.max(0) + 1e-5
        assert ((cloud.numpy() >= low) & (cloud.numpy() <= high)).all()
        assert cloud[:, 2].max() > corners[:, 2].max() - 0.02, "the top is seen from above"
