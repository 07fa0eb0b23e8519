"""What one camera sees: rendered depth, in training and in sampling."""

from __future__ import annotations

import itertools

import numpy as np
import torch
from bidexgrasp_model import single_view
from bidexgrasp_model.config import with_settings
from bidexgrasp_model.data import Cases
from bidexgrasp_model.places import depth_clouds, places_of_split
from bidexgrasp_model.single_view import DISTANCE, Body, depth_cloud, draw_camera

from bidexdata import Release

SIX = np.concatenate([np.eye(3), -np.eye(3)])
CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
CUBE = [Body(0.1 * CORNERS, SIX, np.full(6, 0.1))]
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
    wall = Body(
        CORNERS * [0.025, 0.2, 0.2] + [0.275, 0, 0], SIX, np.array([0.3, 0.2, 0.2, -0.25, 0.2, 0.2])
    )
    points = depth_cloud([*CUBE, wall], camera, np.zeros(3), 0.4, 300)
    np.testing.assert_allclose(points[:, 0], 0.3, atol=1e-9)


def test_cameras_stand_above_the_table():
    rng = np.random.default_rng(0)
    cameras = np.array([draw_camera(np.array([0, 0, 0.1]), rng) for _ in range(50)])
    assert (cameras[:, 2] > 0.4).all()
    np.testing.assert_allclose(np.linalg.norm(cameras - [0, 0, 0.1], axis=1), DISTANCE)


def test_training_renders_the_object_where_it_is_turned_and_mirrored(release, config):
    """Points lie on the surface that the whole cloud of the same item shows, on one side of it."""
    config = with_settings(config, {"train.single_view": 1.0, "model.points": 512})
    cases = Cases(release, config)
    cases.set_epoch(1)
    items = [cases[k] for k in range(len(cases))]
    assert {bool(item["mirrored"]) for item in items} == {False, True}
    batch = cases.batch(items, torch.Generator().manual_seed(5))
    gap = torch.cdist(batch.clouds, batch.solid)
    spacing = torch.cdist(batch.solid, batch.solid).kthvalue(2, dim=-1).values.amax(-1)
    assert (gap.amin(-1) < 1.5 * spacing[:, None]).all(), "what is seen is of the object"
    shown = gap.amin(-2) < spacing[:, None]
    assert (shown.float().mean(-1) < 0.95).all(), "a camera does not see all of it"
    again = cases.batch(items, torch.Generator().manual_seed(5))
    assert torch.equal(batch.clouds, again.clouds)


def test_where_the_image_is_cut_to_a_body_nothing_of_it_is_lost(monkeypatch):
    camera = np.array([0.9, 0.1, 0.8])
    cut = depth_cloud(CUBE, camera, np.zeros(3), 0.2, 400)
    monkeypatch.setattr(single_view, "_window", lambda *_: (slice(None), slice(None)))
    np.testing.assert_array_equal(cut, depth_cloud(CUBE, camera, np.zeros(3), 0.2, 400))


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
