"""Laws of mass properties and rest poses."""

from __future__ import annotations

import manifold3d
import numpy as np
import pytest

from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.objects.closed import as_mesh, convex_hull
from bidexdata.objects.config import RestConfig
from bidexdata.objects.physics import mass_properties, rest_poses, solid_angles
from bidexdata.objects.prepared import TriangleMesh

EXACT = 1e-12  # sums of a few products in float64
REST = RestConfig()
IDENTITY = np.eye(3)


def moved(mesh: TriangleMesh, R=IDENTITY, p=(0.0, 0, 0), s=1.0) -> TriangleMesh:
    return TriangleMesh(s * mesh.vertices @ R.T + p, mesh.faces)


def centred_hull(points) -> TriangleMesh:
    hull = as_mesh(convex_hull(np.asarray(points, float)))
    return TriangleMesh(hull.vertices - mass_properties(hull).centre, hull.faces)


def test_box_has_the_textbook_volume_and_inertia(box):
    mass = mass_properties(box)
    a, b, c = 0.6, 0.5, 0.3
    expected = a * b * c / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    assert mass.volume == pytest.approx(a * b * c, rel=EXACT)
    np.testing.assert_allclose(mass.inertia, expected, atol=EXACT)
    np.testing.assert_allclose(mass.centre, 0, atol=EXACT)


def test_ball_and_cylinder_approach_their_formulas_as_tessellation_grows():
    for sides, tolerance in ((64, 8e-3), (256, 5e-4)):
        ball = mass_properties(as_mesh(manifold3d.Manifold.sphere(0.3, sides)))
        volume = 4 / 3 * np.pi * 0.3**3
        assert ball.volume == pytest.approx(volume, rel=tolerance)
        np.testing.assert_allclose(
            ball.inertia, 0.4 * volume * 0.09 * np.eye(3), rtol=2 * tolerance, atol=1e-9
        )
        rod = mass_properties(as_mesh(manifold3d.Manifold.cylinder(0.8, 0.1, 0.1, sides, True)))
        m = np.pi * 0.01 * 0.8
        side = m * (3 * 0.01 + 0.64) / 12
        np.testing.assert_allclose(
            rod.inertia, np.diag([side, side, m * 0.01 / 2]), rtol=2 * tolerance, atol=1e-9
        )


@pytest.mark.parametrize("scale", [1e-3, 0.3, 1.0, 80.0])
def test_volume_scales_with_s3_and_inertia_with_s5(prepared, scale):
    for obj in prepared.values():
        one, other = mass_properties(obj.solid), mass_properties(moved(obj.solid, s=scale))
        assert other.volume == pytest.approx(one.volume * scale**3, rel=1e-9)
        size = np.abs(one.inertia).max() * scale**5
        np.testing.assert_allclose(other.inertia, one.inertia * scale**5, atol=1e-9 * size)
        assert np.array_equal(other.inertia, other.inertia.T)


def test_turned_and_shifted_solid_has_the_turned_inertia_about_the_shifted_centre(prepared):
    rng = np.random.default_rng(3)
    for obj in prepared.values():
        R, p = matrix_from_quat(random_quat(rng)), rng.uniform(-5, 5, 3)
        one, other = mass_properties(obj.solid), mass_properties(moved(obj.solid, R, p))
        np.testing.assert_allclose(other.inertia, R @ one.inertia @ R.T, atol=1e-12)
        np.testing.assert_allclose(other.centre, R @ one.centre + p, atol=1e-9)


def test_inward_faces_give_the_negative_volume(box):
    turned = TriangleMesh(box.vertices, box.faces[:, ::-1])
    assert mass_properties(turned).volume == pytest.approx(-0.09, rel=EXACT)


def test_solid_angles_sum_to_a_full_sphere_inside_and_to_nothing_outside(ball):
    assert solid_angles(ball).sum() == pytest.approx(4 * np.pi, rel=1e-9)
    outside = TriangleMesh(ball.vertices + np.array([1.0, 0, 0]), ball.faces)
    assert solid_angles(outside).sum() == pytest.approx(0, abs=1e-9)


def test_box_rests_on_its_six_faces_the_largest_first(box):
    rest = rest_poses(box, REST)
    np.testing.assert_allclose(rest.heights, [0.15, 0.15, 0.25, 0.25, 0.3, 0.3], atol=EXACT)
    assert rest.probabilities.sum() == pytest.approx(1, rel=1e-9)
    for q, height in zip(rest.quats_wxyz, rest.heights, strict=True):
        z = box.vertices @ matrix_from_quat(q)[2]
        assert z.min() == pytest.approx(-height, abs=EXACT)
        assert (z < -height + EXACT).sum() == 4
    assert len({tuple(np.round(matrix_from_quat(q)[2], 6)) for q in rest.quats_wxyz}) == 6


def test_every_rest_pose_has_the_centre_of_mass_over_its_support():
    rng = np.random.default_rng(5)
    for _ in range(20):
        hull = centred_hull(rng.standard_normal((12, 3)))
        rest = rest_poses(hull, REST)
        assert rest.probabilities.sum() <= 1 + 1e-9
        assert rest.probabilities.sum() > 0.9
        for q, height in zip(rest.quats_wxyz, rest.heights, strict=True):
            placed = hull.vertices @ matrix_from_quat(q).T
            foot = placed[placed[:, 2] < -height + 1e-6][:, :2]
            assert placed[:, 2].min() == pytest.approx(-height, abs=1e-9)
            # The origin is in the convex hull of the foot: no direction has it outside.
            turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
            support = (foot @ np.stack([np.cos(turn), np.sin(turn)])).max(axis=0)
            assert support.min() > -1e-9


def test_a_slanted_tower_falls_off_its_foot():
    low = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    tower = centred_hull(np.concatenate([low, low + np.array([6, 0, 6])]))
    rest = rest_poses(tower, REST)
    down = [matrix_from_quat(q)[2] for q in rest.quats_wxyz]
    assert not any(np.allclose(d, [0, 0, 1], atol=1e-6) for d in down)
    assert rest.probabilities.sum() == pytest.approx(1, rel=1e-9)


def test_a_face_pointing_up_is_turned_by_exactly_half_a_turn(box):
    rest = rest_poses(box, REST)
    assert any(np.array_equal(q, [0, 1, 0, 0]) for q in rest.quats_wxyz)
    assert any(np.array_equal(q, [1, 0, 0, 0]) for q in rest.quats_wxyz)
