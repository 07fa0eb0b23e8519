"""Normals of clouds: those of the face each point lies on, moved with it."""

import numpy as np
import pytest
import torch
from made_release import OBJECTS, made_release

from bidexdata.errors import BadConfig
from bidexdata.formats.release import Release
from bidexdata.loaders import BiDexCases, BiDexDataset, collate_cases
from bidexdata.loaders.normals import normals_on

FIELDS = ("hand_pos", "hand_quat_wxyz", "object_pos", "object_quat_wxyz")
METRES = 1e-5  # float32 clouds of order 1


@pytest.fixture(scope="module")
def tabletop(tmp_path_factory):
    from bidexdata.hands import load_hands

    root = tmp_path_factory.mktemp("normals") / "release"
    return made_release(root, OBJECTS[:2], setting="tabletop", hands=load_hands("capsule"))


def test_every_point_of_a_box_has_the_normal_of_its_side(tabletop):
    release = Release.open(tabletop)
    points = np.asarray(release.cloud("cloud_solid", release.object_ids[0]))
    pieces = release.load_solid(release.object_ids[0]).pieces
    normals = normals_on(points, pieces)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    corners = np.concatenate([p.vertices for p in pieces])
    # Nothing of a convex solid lies beyond the plane through a point of its surface.
    beyond = (corners @ normals.T).max(axis=0) - (points * normals).sum(axis=1)
    assert len(pieces) == 1
    assert np.abs(beyond).max() < METRES


def test_points_of_a_union_take_the_face_of_the_piece_they_lie_on():
    from box_solids import box_mesh

    left = box_mesh((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
    right = box_mesh((0.2, -0.5, -0.5), (1.2, 0.5, 0.5))
    points = np.array([[-0.5, 0.0, 0.0], [1.2, 0.1, 0.1], [0.3, 0.5, 0.2], [0.9, 0.0, -0.5]])
    expected = [[-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1]]
    np.testing.assert_allclose(normals_on(points, (left, right)), expected, atol=1e-6)


@pytest.mark.parametrize("augment", [(), ("yaw",), ("mirror",), ("mirror", "yaw")])
@pytest.mark.parametrize("frame", ["object", "world"])
def test_normals_move_with_the_cloud(tabletop, frame, augment):
    data = BiDexDataset(
        tabletop, split=None, fields=FIELDS, frame=frame, points=64, normals=True, augment=augment
    )
    for k in range(len(data)):
        cloud, normal = data[k]["cloud_solid"].double(), data[k]["cloud_normal"].double()
        assert normal.shape == cloud.shape
        torch.testing.assert_close(normal.norm(dim=-1), torch.ones(len(normal)).double())
        # All other points of a convex solid lie behind the plane of each point.
        ahead = torch.einsum("pk,qk->pq", normal, cloud) - (normal * cloud).sum(-1)[:, None]
        assert ahead.max() < METRES


def test_a_case_has_its_normals_once(floating):
    cases = BiDexCases(floating, split=None, points=64, normals=True)
    batch = collate_cases([cases[0], cases[1]])
    assert batch["cloud_normal"].shape == batch["cloud_solid"].shape == (2, 64, 3)


def test_batches_of_single_grasps_have_normals_too(tabletop):
    data = BiDexDataset(tabletop, points=16, normals=True, clouds="unique")
    batch = data.__getitems__([0, 1, 2]).stacked
    assert batch["cloud_normal"].shape == batch["cloud_solid"].shape
    assert data[0]["cloud_normal"].shape == (16, 3)


@pytest.mark.parametrize("cloud", ["cloud_mesh", None])
def test_normals_of_another_cloud_are_refused(tabletop, cloud):
    with pytest.raises(BadConfig, match="cloud_solid"):
        BiDexDataset(tabletop, cloud=cloud, normals=True)
