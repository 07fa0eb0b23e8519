"""Laws of the signed-distance grid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from bidexdata.objects.config import SdfConfig
from bidexdata.objects.mesh_queries import distances, winding_distances
from bidexdata.objects.sdf import cover, signed_distance_grid
from bidexdata.objects.surface import sample_surface
from bidexdata.synthesis.distance_field import signed_distance

CONFIG = SdfConfig(cells=40)
FLOAT32 = 5e-5  # kernels work in float32, and slivers of a union cost two more digits
DONOR = 0.15  # a borrowed closest point is too far by this many cells at most (module docstring)
DEEP = 1.0  # near the medial axis of a fine ball all faces are equally far; donors differ most


def nodes(grid):
    return grid.origin + grid.cell * np.argwhere(np.ones(grid.values.shape, bool))


def box_distance(points, half):
    q = np.abs(points) - half
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


def test_grid_of_a_box_is_its_analytic_distance(box):
    grid = signed_distance_grid(box, [box], CONFIG)
    exact = box_distance(nodes(grid), np.array([0.3, 0.25, 0.15]))
    error = grid.values.ravel() - exact
    # Nodes that lie on the surface to float32 may take either sign.
    assert np.abs(error).max() < DONOR * grid.cell


def test_sign_and_size_agree_with_winding_distances_for_every_object(prepared):
    for obj in prepared.values():
        points = nodes(obj.sdf)[:: max(1, obj.sdf.values.size // 20_000)]
        stored = obj.sdf.values.ravel()[:: max(1, obj.sdf.values.size // 20_000)]
        exact = winding_distances(obj.solid, points)
        clear = np.abs(exact) > FLOAT32
        assert np.array_equal(stored[clear] < 0, exact[clear] < 0)
        assert np.abs(np.abs(stored) - np.abs(exact)).max() < DEEP * obj.sdf.cell
        assert np.percentile(np.abs(np.abs(stored) - np.abs(exact)), 99) < DONOR * obj.sdf.cell
        # A borrowed distance is never too small.
        assert (np.abs(stored) - np.abs(exact)).min() > -FLOAT32


def test_distance_is_zero_on_the_surface_to_half_a_cell(prepared):
    for obj in prepared.values():
        assert (
            np.abs(signed_distance(obj.sdf, 1.0, obj.surface_points)[0]).max() < 0.5 * obj.sdf.cell
        )


def test_neighbouring_nodes_differ_by_at_most_a_cell(prepared, box):
    grids = [obj.sdf for obj in prepared.values()] + [signed_distance_grid(box, [box], CONFIG)]
    for grid in grids:
        for axis in range(3):
            step = np.abs(np.diff(grid.values.astype(float), axis=axis)) / grid.cell
            assert np.percentile(step, 99.9) < 1 + DONOR
            assert step.max() < 1 + DEEP


def test_grid_holds_the_solid_with_the_margin(prepared):
    for obj in prepared.values():
        top = obj.sdf.origin + obj.sdf.cell * (np.array(obj.sdf.values.shape) - 1)
        low, high = obj.solid.vertices.min(axis=0), obj.solid.vertices.max(axis=0)
        room = SdfConfig().margin * (high - low).max()
        assert np.all(low - obj.sdf.origin > room - 1e-9)
        assert np.all(top - high > room - 1e-9)
        border = [np.take(obj.sdf.values, k, axis) for axis in range(3) for k in (0, -1)]
        assert all((side > 0).all() for side in border)


def test_scaled_solid_has_the_scaled_distances(box):
    small = signed_distance_grid(box, [box], CONFIG)
    double = box._replace(vertices=2 * box.vertices)
    large = signed_distance_grid(double, [double], CONFIG)
    assert large.cell == pytest.approx(2 * small.cell)
    np.testing.assert_allclose(large.values, 2 * small.values, atol=1e-6)


def test_interpolation_is_exact_at_nodes_and_grows_outside(box):
    grid = signed_distance_grid(box, [box], CONFIG)
    at = nodes(grid)
    np.testing.assert_allclose(signed_distance(grid, 1.0, at)[0], grid.values.ravel(), atol=1e-9)
    far = signed_distance(grid, 1.0, np.array([[5.0, 0, 0]]))[0][0]
    assert far == pytest.approx(4.7, abs=0.01)


def test_cover_leaves_no_surface_point_far_away(prepared):
    for obj in prepared.values():
        points = np.concatenate(list(cover(obj.solid, 0.02)))
        drawn, _ = sample_surface(obj.solid, 2000, np.random.default_rng(0))
        assert KDTree(points).query(drawn)[0].max() < 0.02
        assert distances(obj.solid, points)[1].max() < FLOAT32


def test_distances_of_no_points_are_none(box):
    closest, away = distances(box, np.zeros((0, 3)))
    assert closest.shape == (0, 3)
    assert away.shape == (0,)
