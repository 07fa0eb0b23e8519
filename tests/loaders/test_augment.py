"""Every pose after augmentation still touches its contacts."""

import numpy as np
import pytest
import torch
from made_release import OBJECTS, made_release

from bidexdata import frames
from bidexdata.errors import BadConfig
from bidexdata.formats.release import Release
from bidexdata.hands import load_hands
from bidexdata.hands.kinematics import hand_points
from bidexdata.hands.mirror import twin_joints
from bidexdata.hands.registry import hand_spec
from bidexdata.hands.tree_file import hand_of_release
from bidexdata.hands.twins import twin_of
from bidexdata.loaders import BiDexCases, BiDexDataset

FIELDS = ("hand_pos", "hand_quat_wxyz", "joints", "object_pos", "object_quat_wxyz", "contact_point",
          "contact_normal", "contact_force", "contact_index", "force_scale", "size")  # fmt: skip
METRES = 5e-6  # float32 poses of order 1 m, through a hand of 0.2 m
AUGMENTATIONS = [(), ("yaw",), ("mirror",), ("mirror", "yaw")]
TESTS = pytest.mark.parametrize("augment", AUGMENTATIONS, ids=lambda a: "+".join(a) or "none")


@pytest.fixture(scope="module")
def releases(tmp_path_factory):
    root = tmp_path_factory.mktemp("capsule")
    hands = load_hands("capsule")
    return {
        setting: made_release(root / setting, OBJECTS[:1], hands=hands, setting=setting)
        for setting in ("floating", "tabletop")
    }


def whole(root, **options):
    data = BiDexDataset(root, split=None, fields=FIELDS, **options)
    batch = data.__getitems__(range(len(data))).stacked
    return {name: values.numpy() for name, values in batch.items()}


def pad_gaps(root, batch, frame):
    """Distance of every pad's contact sphere from its contact point, less its radius [m]."""
    gaps = []
    for h, side in enumerate(("left", "right")):
        hand = hand_of_release(root, side)
        joints = batch["joints"][:, h, 1, : len(hand.joint_names)]
        pads = hand_points(hand, joints, batch["hand_pos"][:, h, 1], batch["hand_quat_wxyz"][:, h, 1])  # fmt: skip
        points = batch["contact_point"][:, h].astype(np.float64)
        normals = batch["contact_normal"][:, h].astype(np.float64)
        if frame == "world":
            T = frames.transform(batch["object_pos"], batch["object_quat_wxyz"])
            points = frames.apply(T, points)
            normals = normals @ np.swapaxes(T[:, :3, :3], 1, 2)
        index = batch["contact_index"][:, h]
        assert (index >= 0).all()
        centre = np.take_along_axis(pads.contact, index[..., None].astype(int), axis=1)
        expected = points + hand.contact_radius[index][..., None] * normals
        gaps.append(np.linalg.norm(centre - expected, axis=-1))
    return np.concatenate(gaps)


@TESTS
@pytest.mark.parametrize("frame", ["object", "world"])
@pytest.mark.parametrize("setting", ["floating", "tabletop"])
def test_pads_stay_on_their_contact_points(releases, setting, frame, augment):
    root = releases[setting]
    batch = whole(root, frame=frame, augment=augment, points=16)
    assert pad_gaps(root, batch, frame).max() < METRES
    forces = np.linalg.norm(batch["contact_force"], axis=-1)
    np.testing.assert_allclose(forces, 1, atol=1e-6)
    np.testing.assert_allclose(batch["contact_force"], -batch["contact_normal"], atol=1e-6)


@TESTS
@pytest.mark.parametrize("frame", ["object", "world"])
@pytest.mark.parametrize("setting", ["floating", "tabletop"])
def test_cloud_and_hands_move_as_one(releases, setting, frame, augment):
    options = {"frame": frame, "points": 64}
    plain = whole(releases[setting], **options)
    moved = whole(releases[setting], augment=augment, **options)

    def distances(batch, swapped):
        origin = batch["hand_pos"][:, :, 1]
        origin = np.where(swapped[:, None, None], origin[:, ::-1], origin)
        return np.linalg.norm(batch["cloud_solid"][:, None] - origin[:, :, None], axis=-1)

    nothing = np.zeros(len(plain["size"]), bool)
    swapped = moved.get("mirrored", nothing)
    np.testing.assert_allclose(distances(moved, swapped), distances(plain, nothing), atol=METRES)
    if augment:
        assert not np.allclose(moved["cloud_solid"], plain["cloud_solid"], atol=0.01)
    if "mirror" in augment:
        assert set(swapped) == {True, False}


@pytest.mark.parametrize("frame", ["object", "world"])
def test_a_turn_keeps_what_is_vertical(releases, frame):
    plain, turned = (
        whole(releases["tabletop"], frame=frame, augment=a, points=16) for a in ((), ("yaw",))
    )

    def heights(batch):
        pos = batch["hand_pos"].astype(np.float64)
        if frame == "world":
            return pos[..., 2]
        T = frames.transform(batch["object_pos"], batch["object_quat_wxyz"])
        return frames.apply(T[:, None], pos)[..., 2]

    np.testing.assert_allclose(heights(turned), heights(plain), atol=METRES)


def test_both_frames_show_the_same_turned_grasp(releases):
    a, b = (whole(releases["tabletop"], frame=f, augment=("mirror",), points=16) for f in ("object", "world"))  # fmt: skip
    assert np.array_equal(a["mirrored"], b["mirrored"])
    T = frames.transform(b["object_pos"], b["object_quat_wxyz"])
    np.testing.assert_allclose(frames.apply(T[:, None], a["hand_pos"]), b["hand_pos"], atol=METRES)
    np.testing.assert_allclose(frames.apply(T, a["cloud_solid"]), b["cloud_solid"], atol=METRES)


def test_what_is_drawn_is_a_function_of_seed_epoch_and_row(releases):
    root, options = releases["floating"], {"augment": ("yaw", "mirror"), "points": 16}
    data = BiDexDataset(root, split=None, **options)
    every = data.__getitems__(range(len(data))).stacked
    for k in (3, 0):
        for name, value in data[k].items():
            assert torch.equal(value, every[name][k]), name
    some = BiDexDataset(root, split=None, where="attempt == 2", **options)
    at = [i for i in range(len(data)) if torch.equal(data[i]["hand_pos"], some[0]["hand_pos"])]
    assert len(at) == 1
    data.set_epoch(1)
    other = data.__getitems__(range(len(data))).stacked
    assert not torch.allclose(other["hand_pos"], every["hand_pos"], atol=1e-3)
    seeded = BiDexDataset(root, split=None, seed=1, **options)
    assert not torch.allclose(seeded.__getitems__(range(len(data))).stacked["hand_pos"], every["hand_pos"], atol=1e-3)  # fmt: skip


def test_failed_attempts_stay_nan_when_augmented(releases):
    data = BiDexDataset(releases["tabletop"], split=None, configuration="audit", where="synth_status != 0", augment=("yaw", "mirror"), cloud=None)  # fmt: skip
    assert torch.isnan(data[0]["hand_pos"]).all()
    assert torch.isnan(data[0]["hand_quat_wxyz"]).all()


def test_a_scene_moves_as_a_whole(releases):
    plain = BiDexCases(releases["floating"], split=None, points=16)
    moved = BiDexCases(releases["floating"], split=None, points=16, augment=("yaw", "mirror"))
    for k in range(len(plain)):
        a, b = plain[k], moved[k]
        assert b["mirrored"].ndim == 0
        pos = b["hand_pos"].flip(1) if b["mirrored"] else b["hand_pos"]
        gaps = [
            torch.cdist(c["cloud_solid"], p.reshape(-1, 3))
            for c, p in ((a, a["hand_pos"]), (b, pos))
        ]
        torch.testing.assert_close(gaps[0], gaps[1], atol=METRES, rtol=0)


@pytest.mark.parametrize("options", [{"frame": "world"}, {"augment": ("yaw",)}])
def test_a_scene_whose_rows_have_many_poses_is_no_case(releases, options):
    cases = BiDexCases(releases["tabletop"], split=None, points=16, **options)
    with pytest.raises(BadConfig, match=r"box-aaaaaaaa/300/table0 have 4 sizes or poses"):
        cases[0]


def test_hands_without_a_twin_are_refused(tmp_path, floating):
    with pytest.raises(BadConfig, match="no mirror images"):
        BiDexDataset(floating, augment=("mirror",))
    alone = made_release(tmp_path / "r", OBJECTS[:1], hands=load_hands("capsule")[:1])
    assert Release.open(alone).header.axis("H") == 1
    with pytest.raises(BadConfig, match=r"one \(left\)"):
        BiDexDataset(alone, split=None, augment=("mirror",))
    BiDexDataset(alone, split=None, augment=("yaw",))


@pytest.mark.parametrize("name", ["capsule", "shadow"])
def test_twins_of_two_hands_are_those_of_their_spec(name, request):
    if name == "shadow":
        request.getfixturevalue("menagerie")
    left, right = load_hands(name)
    spec = hand_spec(name)
    for a, b in ((right, left), (left, right)):
        twin = twin_of(a, b)
        assert [b.contact_names[k] for k in twin.contact] == list(a.contact_names)
        np.testing.assert_allclose(
            hand_points(b, a.posture_curved[twin.joint] * twin.factor).contact[twin.contact],
            frames.apply(twin.image, hand_points(a, a.posture_curved).contact),
            atol=METRES,
        )
    joint, factor = twin_joints(spec, right, left)
    assert np.array_equal(twin_of(right, left).joint, joint)
    assert np.array_equal(twin_of(right, left).factor, factor)
    with pytest.raises(BadConfig, match="both hands are left"):
        twin_of(left, left)
