"""Laws of surface points."""

from __future__ import annotations

import numpy as np
import pytest

from bidexdata.objects.config import SurfaceConfig
from bidexdata.objects.mesh_queries import distances, winding_distances
from bidexdata.objects.surface import farthest_point_order, sample_surface, surface_points

FLOAT32 = 5e-5  # kernels work in float32, and slivers of a union cost two more digits
TIE = 1e-6  # distances of float32 points
CONFIG = SurfaceConfig(points=600)


def test_points_lie_on_the_surface_and_normals_point_out(prepared):
    for obj in prepared.values():
        assert distances(obj.solid, obj.surface_points)[1].max() < FLOAT32
        np.testing.assert_allclose(np.linalg.norm(obj.surface_normals, axis=1), 1, atol=1e-5)
        outside = winding_distances(obj.solid, obj.surface_points + 1e-3 * obj.surface_normals)
        inside = winding_distances(obj.solid, obj.surface_points - 1e-3 * obj.surface_normals)
        assert (outside > 0).mean() > 0.995  # an edge may have another wall within 1e-3
        assert (inside < 0).mean() > 0.995


def test_every_next_point_is_the_farthest_from_all_before(prepared):
    points = prepared["mug"].surface_points.astype(float)
    for k in (1, 2, 17, 300, len(points) - 1):
        to_prefix = np.linalg.norm(points[k:, None] - points[None, :k], axis=2).min(axis=1)
        assert to_prefix[0] == pytest.approx(to_prefix.max(), abs=TIE)


def test_order_is_a_permutation_even_of_equal_points():
    rng = np.random.default_rng(0)
    clouds = [
        rng.standard_normal((50, 3)),
        np.zeros((7, 3)),
        np.repeat(rng.standard_normal((5, 3)), 3, axis=0),
        np.zeros((1, 3)),
        np.zeros((0, 3)),
    ]
    for cloud in clouds:
        order = farthest_point_order(cloud.astype(np.float32))
        assert sorted(order) == list(range(len(cloud)))
        for count in (0, 1, 4, 99):
            first = farthest_point_order(cloud.astype(np.float32), count)
            np.testing.assert_array_equal(first, order[:count])


def test_samples_are_uniform_by_area(box):
    _, face = sample_surface(box, 60_000, np.random.default_rng(1))
    corners = box.vertices[box.faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    share = np.bincount(face, minlength=len(area)) / len(face)
    np.testing.assert_allclose(share, area / area.sum(), atol=0.01)


def test_same_solid_gives_the_same_points(box):
    one, two = surface_points(box, CONFIG), surface_points(box, CONFIG)
    assert np.array_equal(one[0], two[0])
    assert np.array_equal(one[1], two[1])
    assert len(one[0]) == 600
