"""Laws of the signed-distance grid."""

from __future__ import annotations

from itertools import pairwise

import manifold3d
import numpy as np
import pytest
from exact_distance import inside, near_points, signed_distances
from scipy.spatial import KDTree
from standing import tilts_after

from bidexdata.objects.assemble import unit_solid
from bidexdata.objects.closed import as_mesh, convex_hull
from bidexdata.objects.config import PrepareConfig, SdfConfig
from bidexdata.objects.distance_field import signed_distance
from bidexdata.objects.mesh_queries import distances, winding_distances
from bidexdata.objects.prepare import prepare_object
from bidexdata.objects.sdf import cover, exact_distances, grid_warnings, signed_distance_grid
from bidexdata.objects.surface import sample_surface

CONFIG = SdfConfig(cells=40)
FLOAT32 = 5e-5  # kernels work in float32, and slivers of a union cost two more digits
DONOR = 0.15  # a borrowed closest point is too far by this many cells at most (module docstring)
NEAR = 0.03  # of the diagonal: the zone for which the grid is exact enough
PROMISED = 0.0025  # of the diagonal: 99th percentile of the error, and where the sign is right
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


def plate(thickness):
    return [as_mesh(manifold3d.Manifold.cube((1.0, 0.6, thickness), True).rotate((20, 35, 10)))]


def frame(width):
    """Four bars of a square frame, each a piece."""
    bars = [((1, width, width), (0, s * 0.5, 0)) for s in (-1, 1)]
    bars += [((width, 1, width), (s * 0.5, 0, 0)) for s in (-1, 1)]
    return [as_mesh(manifold3d.Manifold.cube(size, True).translate(at)) for size, at in bars]


def bowl(wall):
    """A ring of 16 wall pieces on a round floor."""
    around = np.linspace(0, 2 * np.pi, 17)
    pieces = []
    for a, b in pairwise(around):
        corners = [
            [(0.3 + 0.2 * z + t) * np.cos(c), (0.3 + 0.2 * z + t) * np.sin(c), 0.4 * z]
            for c in (a, b)
            for z in (0, 1)
            for t in (0, wall)
        ]
        pieces.append(as_mesh(convex_hull(np.array(corners))))
    floor = manifold3d.Manifold.cylinder(2 * wall, 0.3 + wall, 0.3 + wall, 16)
    return [*pieces, as_mesh(floor.translate((0, 0, -wall)))]


THIN = {
    "plate of 1 %": plate(0.012),
    "plate of 0.5 %": plate(0.006),
    "frame of 1 %": frame(0.014),
    "frame of 0.5 %": frame(0.007),
    "bowl of 1 %": bowl(0.011),
    "bowl of 0.6 %": bowl(0.0066),
}


def assert_promise(solid, pieces, grid, seed, count=4000):
    """99 % of the errors near the surface, and every sign off it, at unit diagonal."""
    points = near_points(solid, count, NEAR, seed)
    exact = signed_distances(solid, pieces, points)
    read, _ = signed_distance(grid, 1.0, points)
    assert np.percentile(np.abs(read - exact), 99) <= PROMISED
    clear = np.abs(exact) > PROMISED
    assert np.array_equal(read[clear] < 0, exact[clear] < 0)


@pytest.mark.parametrize("name", THIN)
def test_thin_walls_are_resolved(name):
    made = unit_solid(THIN[name])
    grid = signed_distance_grid(made.mesh, made.pieces, SdfConfig())
    assert_promise(made.mesh, made.pieces, grid, seed=1)


def test_grids_near_the_surface_are_as_exact_as_promised(prepared):
    for obj in prepared.values():
        grid = signed_distance_grid(obj.solid, obj.pieces, SdfConfig())
        assert_promise(obj.solid, obj.pieces, grid, seed=2)


def test_stout_objects_get_a_coarser_grid_than_thin_ones(prepared):
    box = prepared["box"]
    stout = signed_distance_grid(box.solid, box.pieces, SdfConfig())
    thin = unit_solid(THIN["frame of 0.5 %"])
    fine = signed_distance_grid(thin.mesh, thin.pieces, SdfConfig())
    assert fine.cell < 1 / 200
    assert stout.cell > 1 / 190


def test_a_finest_grid_that_is_not_exact_enough_is_warned_of(prepared):
    mug = prepared["mug"]
    for config, warned in (
        (SdfConfig(), False),
        (SdfConfig(cells=40), True),
        (SdfConfig(cells=40, error=0.5), False),
    ):
        grid = signed_distance_grid(mug.solid, mug.pieces, config)
        told = grid_warnings(mug.solid, mug.pieces, grid, config)
        assert len(told) == warned
    assert [w for w in mug.provenance["warnings"] if "sdf.error is 0.25%" in w]


def test_exact_distances_are_those_of_every_triangle(prepared):
    for obj in prepared.values():
        points = near_points(obj.solid, 500, 0.1, seed=3)
        expected = signed_distances(obj.solid, obj.pieces, points)
        found = exact_distances(obj.solid, obj.pieces, points)
        np.testing.assert_allclose(np.abs(found), np.abs(expected), atol=FLOAT32)
        assert np.array_equal(found < 0, inside(obj.pieces, points))


def test_the_gradient_has_length_one_and_follows_the_normal(prepared):
    """Away from the medial axis: where every distance within two cells grows as the normal says."""
    deep = 0
    for obj in prepared.values():
        grid = signed_distance_grid(obj.solid, obj.pieces, SdfConfig())
        normals = obj.surface_normals.astype(float)
        points = obj.surface_points.astype(float)
        for sign in (-1, 1):
            reach = [sign * k * grid.cell for k in (1, 3, 5)]
            along = [signed_distances(obj.solid, obj.pieces, points + r * normals) for r in reach]
            clear = np.all(np.abs(np.array(along) - np.array(reach)[:, None]) < 1e-4, axis=0)
            if sign < 0 and clear.mean() < 0.2:
                continue  # walls thinner than ten cells
            deep += sign < 0
            assert clear.mean() > 0.2
            at = points[clear] + reach[1] * normals[clear]
            value, slope = signed_distance(grid, 1.0, at)
            # Within half a cell diagonal another face may be nearer: a few per cent are off.
            length = np.linalg.norm(slope, axis=1)
            cosine = np.einsum("ni,ni->n", slope, normals[clear]) / length
            assert np.abs(np.median(length) - 1) < 0.005
            assert np.percentile(np.abs(length - 1), 90) < 0.05
            assert np.percentile(cosine, 5) > 0.98
            assert np.percentile(np.abs(value - reach[1]), 90) < 0.1 * grid.cell
    assert deep > len(prepared) / 2


REAL = [
    "contactdb_bowl.stl", "contactdb_fryingpan.stl", "scopia_shopping_basket.obj",
    "bullet_bicycle_frame.stl", "contactdb_eyeglasses.stl", "sh3db_wire_coathanger.obj",
    "scopia_basin.obj", "sh3d_umbrella.obj", "mujoco_cap.obj", "sh3d_dustbin.obj",
    "contactdb_table.stl", "gso_ecoforms_plate_coacd.obj", "scopia_broom.obj", "sh3d_pallet.obj",
    "kaykit_chair_A.obj", "duck.glb", "mujoco_bunny.obj", "quadknot.obj", "robosuite_can.stl",
    "ycb_power_drill.obj",
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_objects_have_grids_as_exact_as_promised_and_rest_poses_that_hold(shared, name):
    obj = prepare_object(shared / "objects" / "train" / name, PrepareConfig())
    assert_promise(obj.solid, obj.pieces, obj.sdf, seed=4, count=3000)
    assert obj.sdf.values.size < 3_500_000
    assert len(obj.rest_heights) >= 2
    poses = obj.rest_quats_wxyz, obj.rest_heights
    assert tilts_after(obj.pieces, obj.volume, obj.inertia, poses).max() < 1
