"""Laws of patches: plates lie on the surface, face outward, and count each point once."""

import numpy as np

from bidexdata.pictures.patches import LIFT, plate_radius, surface_patch
from bidexdata.pictures.scene import face_normals

COLOUR = (0.1, 0.2, 0.3)


def on_ball(n: int, seed: int = 0):
    normals = np.random.default_rng(seed).standard_normal((n, 3))
    normals = np.concatenate([normals, np.eye(3), -np.eye(3)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return 0.2 * normals, normals


def test_plates_are_flat_on_the_surface_and_face_outward():
    points, normals = on_ball(50)
    patch = surface_patch(points, normals, COLOUR, "region")
    order = np.lexsort(points.T[::-1])
    outward = np.repeat(normals[order], 8, axis=0)
    np.testing.assert_allclose(face_normals(patch.vertices, patch.faces), outward, atol=1e-9)
    corners = patch.vertices[patch.faces] - np.repeat(points[order], 8, axis=0)[:, None]
    np.testing.assert_allclose(np.einsum("fci,fi->fc", corners, outward), LIFT, atol=1e-12)


def test_repeated_points_count_once():
    points, normals = on_ball(20)
    once = surface_patch(points, normals, COLOUR, "region")
    twice = surface_patch(
        np.concatenate([points, points]), np.concatenate([normals, normals]), COLOUR, "region"
    )
    np.testing.assert_array_equal(once.vertices, twice.vertices)
    np.testing.assert_array_equal(once.faces, twice.faces)


def test_plates_of_a_grid_touch_and_scale_with_it():
    grid = np.stack(np.meshgrid(*[np.arange(5.0)] * 2, [0.0]), axis=-1).reshape(-1, 3)
    assert 0.5 <= plate_radius(grid) <= 1.0
    assert np.isclose(plate_radius(0.01 * grid), 0.01 * plate_radius(grid))
    assert plate_radius(grid[:1]) > 0


def test_no_points_are_no_plates():
    assert len(surface_patch(np.zeros((0, 3)), np.zeros((0, 3)), COLOUR, "region").faces) == 0
