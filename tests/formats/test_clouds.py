from pathlib import Path

import numpy as np
import pytest
from made_release import OBJECTS, made_object

from bidexdata.errors import Contradiction
from bidexdata.formats.clouds import open_cloud, surface_cloud
from bidexdata.formats.release import Release


@pytest.mark.parametrize("object_id", OBJECTS)
def test_points_lie_on_the_convex_surface(object_id):
    mesh = made_object(object_id).mesh
    cloud = surface_cloud(mesh.vertices, mesh.faces, 256, object_id).astype(float)
    v = mesh.vertices[mesh.faces]
    normal = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # The farthest outward plane of a convex solid is zero exactly on its surface.
    height = np.einsum("pfi,fi->pf", cloud[:, None] - v[None, :, 0], normal)
    centre = np.einsum("fi,fi->f", mesh.vertices.mean(0) - v[:, 0], normal)
    outward = height * -np.sign(centre)
    np.testing.assert_allclose(outward.max(axis=1), 0, atol=1e-6)


def test_the_density_follows_the_area():
    # Two parallel squares, one with four times the area of the other: farthest-point order keeps
    # the share, to the tolerance of 1000 points.
    big = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0.0]])
    small = np.array([[0, 0, 9], [1, 0, 9], [1, 1, 9], [0, 1, 9.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    cloud = surface_cloud(np.concatenate([big, small]), faces, 1000, "x")
    assert (cloud[:, 2] == 0).mean() == pytest.approx(0.8, abs=0.05)


def test_the_first_points_cover_the_surface_alone():
    mesh = made_object(OBJECTS[0]).mesh
    cloud = surface_cloud(mesh.vertices, mesh.faces, 512, "x")
    gap = np.linalg.norm(cloud[:, None] - cloud[None, :64], axis=2).min(axis=1).max()
    random = np.random.default_rng(0).permutation(cloud)[:64]
    worse = np.linalg.norm(cloud[:, None] - random[None], axis=2).min(axis=1).max()
    assert gap < worse


def test_the_same_key_gives_the_same_points_and_another_key_others():
    mesh = made_object(OBJECTS[0]).mesh
    first, again, other = (surface_cloud(mesh.vertices, mesh.faces, 32, k) for k in "aab")
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_what_is_no_cloud_is_refused(tmp_path):
    path = tmp_path / "c.npy"
    path.write_bytes(b"nothing")
    with pytest.raises(Contradiction, match="unreadable cloud"):
        open_cloud(path)
    np.save(path, np.zeros((2, 3)))
    with pytest.raises(Contradiction, match="expected float32"):
        open_cloud(path)
    np.save(path, np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(Contradiction, match="unreadable cloud"):
        open_cloud(path)


def test_numpy_reads_every_array_of_a_release_without_pickle(packed):
    paths = [*packed.rglob("*.npy"), *packed.rglob("*.npz")]
    assert {p.suffix for p in paths} == {".npy", ".npz"}
    for path in paths:
        found = np.load(path, allow_pickle=False)
        arrays = [found] if isinstance(found, np.ndarray) else list(found.values())
        assert all(a.dtype != object for a in arrays)


def test_the_rows_of_a_cloud_file_are_those_that_the_objects_table_names(packed):
    release = Release.open(packed)
    every = np.load(packed / "clouds" / "cloud_solid.npy", mmap_mode="r")
    rows = release.objects.select(["object_id", "cloud_index"]).to_pylist()
    assert sorted(r["cloud_index"] for r in rows) == list(range(len(every)))
    for row in rows:
        cloud = release.cloud("cloud_solid", row["object_id"])
        np.testing.assert_array_equal(every[row["cloud_index"]], cloud)


def test_readme_and_card_say_how_to_read_clouds_and_that_pickle_is_not_needed(packed):
    root = Path(__file__).resolve().parents[2]
    for text in (
        (root / "README.md").read_text("utf-8"),
        (packed / "README.md").read_text("utf-8"),
    ):
        said = " ".join(text.split())
        assert 'mmap_mode="r"' in said
        assert "`allow_pickle=True` is never needed" in said
        assert "`cloud_index` of" in said
