import numpy as np
from made_release import OBJECTS, made_object

from bidexdata.formats import closest
from bidexdata.formats.closest import distance_to_triangles

UNIT = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], float)


def test_known_distances():
    points = np.array(
        [[0.2, 0.2, 3], [0.2, 0.2, -3], [-1, -1, 0], [2, 0, 0], [1, 1, 0], [0.5, -2, 0], [0, 0, 0]]
    )
    expected = [3, 3, np.sqrt(2), 1, np.sqrt(0.5), 2, 0]
    np.testing.assert_allclose(distance_to_triangles(points, UNIT), expected, atol=1e-12)


def test_the_winding_does_not_matter_and_degenerate_triangles_are_segments():
    points = np.random.default_rng(0).normal(size=(50, 3))
    flipped = UNIT[:, ::-1]
    np.testing.assert_allclose(
        distance_to_triangles(points, UNIT), distance_to_triangles(points, flipped)
    )
    line = np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0]]], float)
    along = np.clip(points[:, 0], 0, 2)
    expected = np.linalg.norm(points - along[:, None] * [1, 0, 0], axis=1)
    np.testing.assert_allclose(distance_to_triangles(points, line), expected)
    dot = np.zeros((1, 3, 3))
    np.testing.assert_allclose(distance_to_triangles(points, dot), np.linalg.norm(points, axis=1))


def test_no_dense_sample_is_closer_and_one_is_about_as_close():
    rng = np.random.default_rng(1)
    triangles = rng.normal(size=(6, 3, 3))
    points = rng.normal(size=(40, 3)) * 2
    u, v = np.meshgrid(np.linspace(0, 1, 80), np.linspace(0, 1, 80))
    keep = u + v <= 1 + 1e-12
    u, v = u[keep], v[keep]
    a, b, c = triangles[:, None, 0], triangles[:, None, 1], triangles[:, None, 2]
    samples = (a + u[None, :, None] * (b - a) + v[None, :, None] * (c - a)).reshape(-1, 3)
    dense = np.linalg.norm(points[:, None] - samples[None], axis=2).min(axis=1)
    exact = distance_to_triangles(points, triangles)
    assert (exact <= dense + 1e-12).all()
    np.testing.assert_allclose(exact, dense, atol=0.05)


def test_blocks_do_not_change_the_result(monkeypatch):
    mesh = made_object(OBJECTS[0]).mesh
    points = np.random.default_rng(2).normal(size=(33, 3))
    whole = distance_to_triangles(points, mesh.vertices[mesh.faces])
    monkeypatch.setattr(closest, "BLOCK", 30)
    np.testing.assert_array_equal(whole, distance_to_triangles(points, mesh.vertices[mesh.faces]))
    assert distance_to_triangles(np.zeros((0, 3)), UNIT).shape == (0,)
