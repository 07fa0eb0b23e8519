"""DexGraspNet, BimanGrasp, BODex: what files hold, which stages are made, what our hand cannot take."""

from __future__ import annotations

import numpy as np
import pytest
from made_dexgraspbench import OBJECTS, made_object, save
from made_named_qpos import (
    as_list,
    bodex_grasps,
    decomposed,
    named_qpos,
    one_hand,
    two_hands,
)

from bidexdata.formats.importers import load_format, stages
from bidexdata.formats.importers.dexgraspbench import JOINT_NAMES
from bidexdata.formats.importers.format import BadFile
from bidexdata.formats.importers.named_qpos import (
    LEFT_SIGNS,
    THEIR_JOINTS,
    our_joints,
    quat_from_fixed_xyz,
)
from bidexdata.formats.importers.rows import record_rows
from bidexdata.frames import matrix_from_quat, quat_angle, quat_rotate
from bidexdata.hands import load_hands
from bidexdata.objects.config import PrepareConfig, SdfConfig, SurfaceConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.record import Status

CONFIG = PrepareConfig(surface=SurfaceConfig(points=200), sdf=SdfConfig(cells=16, error=1.0))
DGN, BIMAN, BODEX = (load_format(n) for n in ("dexgraspnet", "bimangrasp", "bodex"))
FLOAT32 = 1e-6


@pytest.fixture(scope="module")
def hands():
    return load_hands("capsule")


@pytest.fixture(scope="module")
def obj(tmp_path_factory):
    root = tmp_path_factory.mktemp("dgn")
    decomposed(root / "objects" / "Two_Boxes", OBJECTS["Two_Boxes"])
    return DGN.load_object(DGN.find_object("Two_Boxes", root, None), CONFIG)


def read(form, folder, content, name="data/Two_Boxes.npy"):
    save(folder / "x.npy", content)
    return form.read((folder / "x.npy").read_bytes(), name)


def rows_of(form, grasps, obj, hands):
    return record_rows(
        [("a", grasps)],
        obj,
        hands,
        form,
        setting="floating",
        run_fingerprint="run",
        fingerprints={"run": "run"},
        version="0",
    )


def test_angles_are_about_fixed_axes_x_then_y_then_z():
    rng = np.random.default_rng(0)
    for x, y, z in [*rng.uniform(-3, 3, (20, 3)), (0, 0, 0), (1, np.pi / 2, 2), (np.pi, 0, np.pi)]:
        cx, sx, cy, sy, cz, sz = (f(a) for a in (x, y, z) for f in (np.cos, np.sin))
        R_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        R_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        R_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        found = matrix_from_quat(quat_from_fixed_xyz(np.array([[x, y, z]], float)))[0]
        np.testing.assert_allclose(found, R_z @ R_y @ R_x, atol=1e-12)


def test_numbers_are_taken_by_name_in_any_order(tmp_path):
    content = one_hand(np.random.default_rng(1), 0.1)
    turned = {"scale": content["scale"], "qpos": dict(reversed(content["qpos"].items()))}
    first, second = (read(DGN, tmp_path, as_list([c])) for c in (content, turned))
    np.testing.assert_array_equal(first.joints[0], second.joints[0])
    np.testing.assert_array_equal(first.hand_quat_wxyz, second.hand_quat_wxyz)
    assert first.object_name == "Two_Boxes"
    place = [content["qpos"][f"WRJT{a}"] for a in "xyz"]
    np.testing.assert_array_equal(first.hand_pos[0, 0, 0], place)
    names = dict(zip(our_joints("rh_"), first.joints[0][0, 0], strict=True))
    assert names["rh_FFJ4"] == -content["qpos"]["robot0:FFJ3"]
    assert names["rh_LFJ5"] == content["qpos"]["robot0:LFJ4"]
    assert names["rh_THJ1"] == -content["qpos"]["robot0:THJ0"]


def test_the_left_hand_is_turned_by_half_a_turn(tmp_path):
    content = two_hands(np.random.default_rng(2), 0.1)
    grasps = read(BIMAN, tmp_path, as_list([content]))
    angles = np.array([[content["qpos_left"][f"WRJR{a}"] for a in "xyz"]])
    theirs = quat_from_fixed_xyz(angles)[0]
    ours = grasps.hand_quat_wxyz[0, 0, 0]
    axis = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(quat_rotate(ours, axis), quat_rotate(theirs, axis), atol=1e-12)
    palm = np.array([0.0, -1.0, 0.0])  # our palm's direction; theirs is +y
    np.testing.assert_allclose(quat_rotate(ours, palm), quat_rotate(theirs, -palm), atol=1e-12)
    assert quat_angle(grasps.hand_quat_wxyz[:, 1, 0], theirs[None])[0] > 0
    order = dict(zip(THEIR_JOINTS, "".join(LEFT_SIGNS.values()), strict=True))
    for n, ours_n, value in zip(
        THEIR_JOINTS, our_joints("lh_"), grasps.joints[0][0, 0], strict=True
    ):
        assert ours_n[3:5] == n[7:9]
        assert value == content["qpos_left"][n] * (1 if order[n] == "+" else -1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"scale": None}, "grasp 0: its scale is no positive number"),
        ({"scale": -1.0}, "grasp 0: its scale is no positive number"),
        ({"scale": "a"}, "grasp 0: its scale is no positive number"),
        ({"qpos": None}, "grasp 0: qpos: there is none"),
        ({"qpos": 3}, "grasp 0: qpos: it is not a dictionary"),
        ({"robot0:FFJ3": None}, "grasp 0: qpos: it has no robot0:FFJ3"),
        ({"WRJTx": np.nan}, "grasp 0: qpos: its WRJTx is not a finite number"),
        ({"WRJTx": True}, "grasp 0: qpos: its WRJTx is not a finite number"),
        ({"WRJRz": np.ones(2)}, "grasp 0: qpos: its WRJRz is not a finite number"),
        ({"WRJTy": 11.0}, "grasp 0: qpos: its hand is more than 10 m away"),
    ],
)
def test_a_grasp_that_lacks_something_is_left_out_and_says_what(tmp_path, change, said):
    rng = np.random.default_rng(3)
    bad, good = one_hand(rng, 0.1), one_hand(rng, 0.1)
    for key, value in change.items():
        where = bad if key in bad else bad["qpos"]
        if value is None:
            del where[key]
        else:
            where[key] = value
    grasps = read(DGN, tmp_path, as_list([bad, good]))
    assert grasps.row.tolist() == [1]
    assert len(grasps.left_out) == 1
    assert grasps.left_out[0].startswith(said)
    with pytest.raises(BadFile, match=said.split(":", maxsplit=1)[0]):
        read(DGN, tmp_path, as_list([bad]))


def test_files_of_the_other_format_say_what_they_lack(tmp_path):
    rng = np.random.default_rng(4)
    with pytest.raises(BadFile, match="qpos_left: there is none"):
        read(BIMAN, tmp_path, as_list([one_hand(rng, 0.1)]))
    with pytest.raises(BadFile, match="qpos: there is none"):
        read(DGN, tmp_path, as_list([two_hands(rng, 0.1)]))
    with pytest.raises(BadFile, match="holds no grasp"):
        read(DGN, tmp_path, as_list([]))
    with pytest.raises(BadFile, match="not a list of grasps"):
        read(DGN, tmp_path, one_hand(rng, 0.1))


def test_an_object_is_the_union_of_its_bodies_named_or_not(tmp_path, obj):
    # Overlap 0.2 x 0.4 x 0.4 counted once.
    unit = np.linalg.norm([1.6, 0.6, 0.6])
    assert len(obj.pieces) == 2
    assert obj.volume == pytest.approx((0.16 + 0.288 - 0.032) / unit**3, rel=1e-5)
    assert obj.nominal_volume == obj.volume
    assert "mass_properties" not in obj.provenance
    decomposed(tmp_path / "objects" / "b", OBJECTS["Two_Boxes"], named=False)
    found = DGN.load_object(DGN.find_object("b", tmp_path, None), CONFIG)
    assert len(found.pieces) == 2
    assert found.volume == pytest.approx(obj.volume, rel=1e-6)


def test_bodies_that_are_not_convex_fail_the_object(tmp_path):
    decomposed(tmp_path / "objects" / "b", OBJECTS["brick"])
    file = tmp_path / "objects" / "b" / "coacd" / "decomposed.obj"
    dented = [
        " ".join(["v", "0", "0", "0"]) if k == 1 else x
        for k, x in enumerate(file.read_text().splitlines())
    ]
    file.write_text("\n".join(dented) + "\n")
    with pytest.raises(PrepareFailure, match="1 of 1 bodies in it are not convex"):
        DGN.load_object(DGN.find_object("b", tmp_path, None), CONFIG)


@pytest.mark.parametrize("name", ["nothing", "..", ".", "a/b", "", "/etc"])
def test_an_object_that_is_not_there_says_where_it_was_looked_for(tmp_path, name):
    decomposed(tmp_path / "meshdata" / "a", OBJECTS["brick"])
    assert DGN.find_object("a", tmp_path, None).name == "a"
    with pytest.raises(BadFile, match=r"has no coacd/decomposed.obj \(looked in"):
        DGN.find_object(name, tmp_path, None)


def test_stages_are_made_by_the_paper_s_rule(tmp_path, obj, hands):
    rng = np.random.default_rng(5)
    grasps = read(BIMAN, tmp_path, as_list([two_hands(rng, 0.1) for _ in range(4)]))
    batch = rows_of(BIMAN, grasps, obj, hands)
    assert (batch["synth_status"] == Status.OK).all()
    for h, hand in enumerate(hands):
        quat = batch["hand_quat_wxyz"][:, h].astype(float)
        out = quat_rotate(quat[:, 1], hand.T_hand_palm[:3, 2])
        pos, joints = batch["hand_pos"][:, h].astype(float), batch["joints"][:, h].astype(float)
        np.testing.assert_allclose(pos[:, 1] - pos[:, 0], 0.01 * out, atol=FLOAT32)
        np.testing.assert_allclose(pos[:, 2] - pos[:, 1], 0.01 * out, atol=FLOAT32)
        np.testing.assert_array_equal(quat[:, 0], quat[:, 1])
        np.testing.assert_array_equal(quat[:, 2], quat[:, 1])
        closed = joints[:, 2] - joints[:, 1]
        assert set(np.abs(closed).round(6).ravel().tolist()) == {0.0, 0.1}
        flexing = [hand.joint_names.index(n) for n in hand.joint_names if n.endswith("FFJ3")]
        np.testing.assert_allclose(closed[:, flexing], 0.1, atol=FLOAT32)
        spread = [hand.joint_names.index(n) for n in hand.joint_names if n.endswith("FFJ4")]
        np.testing.assert_array_equal(closed[:, spread], 0)
        # The pre-grasp opens as far, or to the joint's stop.
        opened = np.clip(joints[:, 1] - closed, hand.joint_lower, hand.joint_upper)
        np.testing.assert_allclose(joints[:, 0], opened, atol=FLOAT32)


def test_joints_out_of_range_are_a_status_and_those_nearly_in_it_are_moved(tmp_path, obj, hands):
    rng = np.random.default_rng(6)
    rows = [two_hands(rng, 0.1) for _ in range(4)]
    rows[1]["qpos_right"]["robot0:FFJ0"] = -44.6
    rows[2]["qpos_left"]["robot0:MFJ0"] = 52.0
    rows[3]["qpos_right"]["robot0:FFJ0"] = -0.5 * stages.MOVED_TO_EDGE
    batch = rows_of(BIMAN, read(BIMAN, tmp_path, as_list(rows)), obj, hands)
    assert batch["synth_status"].tolist() == [0, Status.JOINT_RANGE, Status.JOINT_RANGE, 0]
    assert batch["selected"].tolist() == [True, False, False, True]
    assert batch["audit"].tolist() == [False, True, True, False]
    for name in ("hand_pos", "hand_quat_wxyz", "joints"):
        assert np.isnan(batch[name][1:3]).all()
        assert np.isfinite(batch[name][[0, 3]]).all()
    right = hands[1].joint_names.index("rh_FFJ1")
    assert batch["joints"][3, 1, 1, right] == 0.0
    assert batch["source_ref"].tolist() == ["a#0", "a#1", "a#2", "a#3"]


def test_a_squeeze_may_ask_for_more_than_a_joint_can_give(hands):
    hand = hands[1]
    joints = np.tile(hand.joint_upper, (1, 3, 1))
    joints[0, 2] += 0.4
    pos, quat = np.zeros((1, 3, 3)), np.tile([1.0, 0, 0, 0], (1, 3, 1))
    found = stages.staged(pos, quat, joints, hand)
    assert found.possible.all()
    np.testing.assert_array_equal(found.joints, joints)
    joints[0, 0, 0] += 0.4
    assert not stages.staged(pos, quat, joints, hand).possible.any()


def test_bodex_s_thumbs_come_first_and_its_poses_are_palms(tmp_path):
    content = bodex_grasps(np.random.default_rng(7), 3)
    grasps = read(BODEX, tmp_path, content, "x/Two_Boxes/scale_pose_grasp.npy")
    assert (grasps.object_name, grasps.several, len(grasps)) == ("Two_Boxes", True, 3)
    pose = content["robot_pose"][0].astype(float)
    np.testing.assert_array_equal(grasps.hand_pos[:, 0], pose[..., :3])
    named = {n: grasps.joints[0][..., k] for k, n in enumerate(BODEX.joint_names[0])}
    ours = np.stack([named[n] for n in JOINT_NAMES], axis=-1)
    # As its own conversion: the thumb's five joints go to the end.
    np.testing.assert_array_equal(ours, np.concatenate([pose[..., 12:], pose[..., 7:12]], axis=-1))


def test_bodex_and_its_conversion_are_the_same_grasp(tmp_path, hands):
    """Converted as the benchmark converts it (thumb last, root 34 mm below), it imports equally."""
    content = bodex_grasps(np.random.default_rng(8), 1)
    pose = content["robot_pose"][0, 0].astype(float)
    root = pose[:, :3] - quat_rotate(pose[:, 3:7], np.array([0, 0, 0.034]))
    qpos = np.concatenate([root, pose[:, 3:7], pose[:, 12:], pose[:, 7:12]], axis=-1)
    keys = ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos")
    converted = {
        **dict(zip(keys, qpos, strict=True)),
        "obj_pose": content["obj_pose"][0],
        "obj_scale": content["obj_scale"][0],
        "obj_path": "assets/Two_Boxes",
    }
    bench = load_format("dexgraspbench")
    made_object(tmp_path / "objects" / "Two_Boxes", OBJECTS["Two_Boxes"])
    solid = bench.load_object(bench.find_object("Two_Boxes", tmp_path, None), CONFIG)
    raw = rows_of(BODEX, read(BODEX, tmp_path, content, "Two_Boxes/a_grasp.npy"), solid, hands[1:])
    again = rows_of(bench, read(bench, tmp_path, converted, "a.npy"), solid, hands[1:])
    for name in ("hand_pos", "hand_quat_wxyz", "joints", "size"):
        np.testing.assert_allclose(raw[name], again[name], atol=FLOAT32)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"robot_pose": np.zeros((1, 2, 3, 28))}, "robot_pose has shape"),
        ({"robot_pose": np.zeros((2, 2, 3, 29))}, "of 2 scenes"),
        (
            {"robot_pose": np.full((1, 1, 3, 29), np.nan)},
            "grasp 0: its pregrasp_qpos is not finite",
        ),
        ({"robot_pose": [[1], [2, 3]]}, "robot_pose is not numbers"),
        ({"obj_scale": np.ones(2)}, "obj_scale has shape"),
        ({"obj_pose": None}, "has no obj_pose"),
    ],
)
def test_a_bodex_file_that_lacks_something_says_what(tmp_path, change, said):
    content = bodex_grasps(np.random.default_rng(9), 2) | change
    content = {k: v for k, v in content.items() if v is not None}
    with pytest.raises(BadFile, match=said):
        read(BODEX, tmp_path, content, "Two_Boxes/a_grasp.npy")


def test_named_joints_of_a_hand_are_all_there():
    assert sorted(our_joints("rh_")) == sorted(JOINT_NAMES)
    assert len(named_qpos(np.random.default_rng(0))) == 28
