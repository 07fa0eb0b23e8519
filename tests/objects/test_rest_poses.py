"""Laws of rest poses: exact ones of known bodies, symmetry, turning, and that they hold."""

from __future__ import annotations

import manifold3d
import numpy as np
import pytest
from standing import tilts_after

from bidexdata.errors import BadConfig
from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.objects.closed import as_mesh, convex_hull
from bidexdata.objects.config import RestConfig
from bidexdata.objects.drops import Body, drop, facing_down, spread_directions
from bidexdata.objects.physics import mass_properties
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.rest import RestPoses, rest_poses

EXACT = 1e-12  # sums of a few products in float64
CHAOS = 0.02  # of 120 drops two or three turn on rounding
CHANCE = 0.12  # probabilities from 120 other drops
REST = RestConfig()
ALL = RestConfig(min_probability=0.0, max_poses=999, merge=0.0)
QUARTER = {
    "x": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "y": np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]),
    "z": np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]]),
}


def body_of(points) -> Body:
    """The hull of points as a solid of unit diagonal with its centre of mass at the origin."""
    hull = as_mesh(convex_hull(np.asarray(points, float)))
    size = np.linalg.norm(np.ptp(hull.vertices, axis=0))
    vertices = (hull.vertices - mass_properties(hull).centre) / size
    hull = TriangleMesh(vertices, hull.faces)
    mass = mass_properties(hull)
    return Body(hull, mass.volume, mass.inertia)


def cuboid(a, b, c) -> Body:
    return body_of(as_mesh(manifold3d.Manifold.cube((a, b, c), True)).vertices)


def cylinder(height, radius, top=None, sides=24) -> Body:
    top = radius if top is None else top
    return body_of(as_mesh(manifold3d.Manifold.cylinder(height, radius, top, sides)).vertices)


def turned(body: Body, R) -> Body:
    hull = TriangleMesh(body.hull.vertices @ R.T, body.hull.faces)
    return Body(hull, body.volume, R @ body.inertia @ R.T)


def downs(rest: RestPoses) -> np.ndarray:
    return np.array([-matrix_from_quat(q)[2] for q in rest.quats_wxyz]).reshape(-1, 3)


def assert_same_poses(one: RestPoses, other: RestPoses, R, *, within: float):
    """Every pose of `one`, turned by R, is a pose of `other`, and as probable."""
    assert len(one.heights) == len(other.heights)
    match = np.argmax(downs(one) @ R.T @ downs(other).T, axis=1)
    assert sorted(match) == list(range(len(match)))
    np.testing.assert_allclose(downs(one) @ R.T, downs(other)[match], atol=1e-6)
    np.testing.assert_allclose(one.heights, other.heights[match], atol=1e-9)
    np.testing.assert_allclose(one.probabilities, other.probabilities[match], atol=within)


def test_box_rests_on_its_six_faces_the_largest_first_and_opposite_ones_alike():
    rest = rest_poses(cuboid(0.6, 0.5, 0.3), REST)
    half = np.array([0.15, 0.15, 0.25, 0.25, 0.3, 0.3]) / np.linalg.norm([0.6, 0.5, 0.3])
    np.testing.assert_allclose(rest.heights, half, atol=EXACT)
    assert len({tuple(np.round(d, 6)) for d in downs(rest)}) == 6
    assert rest.probabilities.sum() == pytest.approx(1, rel=1e-9)
    p = rest.probabilities.reshape(3, 2)
    np.testing.assert_allclose(p[:, 0], p[:, 1], atol=CHAOS)
    assert p[0, 0] > p[1, 0] > p[2, 0] > 0.02


def test_a_cube_rests_on_every_face_alike():
    rest = rest_poses(cuboid(1, 1, 1), REST)
    np.testing.assert_allclose(rest.probabilities, 1 / 6, atol=CHAOS)


def test_a_cylinder_stands_on_two_ends_or_lies_on_its_sides():
    for height, standing in ((0.2, (0.7, 1.0)), (1.0, (0.1, 0.6)), (4.0, (0.0, 0.1))):
        body = cylinder(height, 0.5)
        rest = rest_poses(body, ALL)
        upright = np.abs(downs(rest)[:, 2])
        assert np.all((upright > 1 - 1e-9) | (upright < 1e-9))
        assert standing[0] <= rest.probabilities[upright > 0.5].sum() <= standing[1]
        ends = body.hull.vertices[:, 2].max()
        np.testing.assert_allclose(rest.heights[upright > 0.5], ends, atol=1e-9)
        # What is missing is the hull's share of sides that no drop ended on.
        assert 0.95 < rest.probabilities.sum() <= 1 + 1e-9


def test_a_cone_does_not_stand_on_its_tip():
    rest = rest_poses(cylinder(1.0, 0.4, top=0.01), ALL)
    assert downs(rest)[:, 2].max() < 0.9
    assert np.isclose(downs(rest)[:, 2], -1).sum() == 1


@pytest.mark.slow
def test_a_smooth_ball_rests_in_no_pose():
    fine = body_of(as_mesh(manifold3d.Manifold.sphere(0.3, 512)).vertices)
    assert rest_poses(fine, ALL).quats_wxyz.shape == (0, 4)


def test_a_ball_of_flats_rests_in_no_pose_more_than_in_others():
    coarse = body_of(as_mesh(manifold3d.Manifold.sphere(0.3, 32)).vertices)
    assert rest_poses(coarse, REST).probabilities.max(initial=0) < 0.04


def test_a_slanted_tower_falls_off_its_foot():
    low = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    rest = rest_poses(body_of(np.concatenate([low, low + np.array([6, 0, 6])])), REST)
    assert not np.isclose(np.abs(downs(rest)[:, 2]), 1, atol=1e-6).any()
    assert rest.probabilities.sum() == pytest.approx(1, rel=1e-9)


def test_a_facet_that_can_carry_but_is_never_reached_is_no_pose():
    needle = cuboid(1, 0.04, 0.04)  # tips over at 2.3 degrees, so its ends do carry it
    rest = rest_poses(needle, ALL)
    assert np.abs(downs(rest)[:, 0]).max() < 1e-6
    assert len(rest.heights) == 4


def test_every_rest_pose_has_the_centre_of_mass_over_its_support():
    rng = np.random.default_rng(5)
    for _ in range(8):
        body = body_of(rng.standard_normal((12, 3)))
        rest = rest_poses(body, REST)
        assert 0.9 < rest.probabilities.sum() <= 1 + 1e-9
        for q, height in zip(rest.quats_wxyz, rest.heights, strict=True):
            placed = body.hull.vertices @ matrix_from_quat(q).T
            foot = placed[placed[:, 2] < -height + 1e-6][:, :2]
            assert placed[:, 2].min() == pytest.approx(-height, abs=1e-9)
            # The origin is in the convex hull of the foot: no direction has it outside.
            turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
            support = (foot @ np.stack([np.cos(turn), np.sin(turn)])).max(axis=0)
            assert support.min() > 0


def test_poses_differ_by_more_than_a_turn_about_z_and_are_in_order(prepared):
    for obj in prepared.values():
        rest = rest_poses(Body(obj.hull, obj.volume, obj.inertia), REST)
        near = downs(rest) @ downs(rest).T - 2 * np.eye(len(rest.heights))
        assert near.max() < np.cos(REST.merge)
        assert np.all(np.diff(rest.probabilities) <= 1e-9)


@pytest.mark.parametrize("axis", QUARTER)
def test_turning_the_object_by_a_quarter_turn_turns_the_poses(prepared, axis):
    bodies = [cuboid(0.6, 0.5, 0.3), cylinder(1.0, 0.5, top=0.3, sides=8)]
    # A mug rolls into one of many neighbouring poses of its round side: no law for each of them.
    bodies += [Body(o.hull, o.volume, o.inertia) for n, o in prepared.items() if n != "mug"]
    for body in bodies:
        one, other = rest_poses(body, REST), rest_poses(turned(body, QUARTER[axis]), REST)
        assert_same_poses(one, other, QUARTER[axis], within=2 * CHAOS)


def test_turning_the_object_in_any_way_turns_the_poses_up_to_chance():
    rng = np.random.default_rng(7)
    body = cuboid(0.6, 0.5, 0.3)
    for _ in range(3):
        R = matrix_from_quat(random_quat(rng))
        one, other = rest_poses(body, REST), rest_poses(turned(body, R), REST)
        assert_same_poses(one, other, R, within=CHANCE)


def test_the_same_body_gives_the_same_bits(prepared):
    obj = prepared["mug"]
    body = Body(obj.hull, obj.volume, obj.inertia)
    for a, b in zip(rest_poses(body, REST), rest_poses(body, REST), strict=True):
        assert np.array_equal(a, b)


def test_an_object_put_down_in_a_rest_pose_stays(prepared):
    for obj in prepared.values():
        poses = obj.rest_quats_wxyz, obj.rest_heights
        assert tilts_after(obj.pieces, obj.volume, obj.inertia, poses).max() < 1


def test_a_face_pointing_up_is_turned_by_exactly_half_a_turn():
    rest = rest_poses(cuboid(0.6, 0.5, 0.3), REST)
    assert any(np.array_equal(q, [0, 1, 0, 0]) for q in rest.quats_wxyz)
    assert any(np.array_equal(q, [1, 0, 0, 0]) for q in rest.quats_wxyz)


def test_what_is_turned_down_points_down():
    rng = np.random.default_rng(2)
    some = rng.standard_normal((50, 3))
    edges = [*np.eye(3), *-np.eye(3), [1e-12, 0, 1], [1e-5, 0, 1]]
    for d in np.concatenate([some, np.array(edges)]):
        unit = d / np.linalg.norm(d)
        np.testing.assert_allclose(
            matrix_from_quat(facing_down(unit)) @ unit, [0, 0, -1], atol=1e-9
        )


def test_release_directions_are_even_and_quarter_turns_permute_them():
    made = spread_directions(120, np.random.default_rng(0))
    assert made.shape == (120, 3)
    np.testing.assert_allclose(np.linalg.norm(made, axis=1), 1, atol=EXACT)
    for R in QUARTER.values():
        assert (made @ R.T @ made.T).max(axis=1).min() > 1 - 1e-12
    nearest = np.degrees(np.arccos(np.sort(made @ made.T, axis=1)[:, -2]))
    assert (
        nearest.min() > 8
    )  # 120 circles of equal size have about 20 degrees from centre to centre
    with pytest.raises(BadConfig, match="multiple of 24"):
        RestConfig(drops=100)


def test_dropped_boxes_end_flat_on_a_face():
    body = cuboid(0.6, 0.5, 0.3)
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    released = spread_directions(48, np.random.default_rng(1))
    end = drop(body, released, normals, height=0.05, angle=np.radians(1), seconds=6.0)
    assert end.still.all()
    assert np.abs(end.downs).max(axis=1).min() > np.cos(np.radians(1))


def test_poses_that_the_pieces_do_not_hold_are_none():
    """The hull says that a block stands on its foot; of a corner that is missing only pieces know."""
    body = cuboid(0.4, 0.4, 0.6)
    corners = body.hull.vertices.copy()
    corner = np.argmin(corners @ [1.0, 1.0, 1.0])
    corners[corner, 2] += 0.05
    short = as_mesh(convex_hull(corners))
    whole, rocks = rest_poses(body, REST), rest_poses(body, REST, (short,))
    on_foot = [(downs(rest)[:, 2] < -1 + 1e-6).any() for rest in (whole, rocks)]
    assert on_foot == [True, False]
