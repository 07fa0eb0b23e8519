"""Laws of mass properties."""

from __future__ import annotations

import manifold3d
import numpy as np
import pytest

from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.objects.closed import as_mesh
from bidexdata.objects.physics import mass_properties, solid_angles
from bidexdata.objects.prepared import TriangleMesh

EXACT = 1e-12  # sums of a few products in float64
IDENTITY = np.eye(3)


def moved(mesh: TriangleMesh, R=IDENTITY, p=(0.0, 0, 0), s=1.0) -> TriangleMesh:
    return TriangleMesh(s * mesh.vertices @ R.T + p, mesh.faces)


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
