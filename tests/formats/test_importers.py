"""The adapter of DexGraspBench: what files hold, what objects are, and where hands end up."""

import csv
import json
import shutil

import numpy as np
import pytest
from made_dexgraspbench import (
    NOMINAL,
    OBJECTS,
    box,
    made_dexgraspbench,
    made_grasp,
    made_grasps,
    made_object,
    save,
    write_obj,
)

from bidexdata.errors import NotUsable, UnknownName
from bidexdata.formats.importers import FORMATS, dexgraspbench, load_format
from bidexdata.formats.importers.dexgraspbench import JOINT_NAMES, ROOT_TO_PALM
from bidexdata.formats.importers.format import BadFile, placed
from bidexdata.formats.importers.rows import COLUMNS, joint_orders, record_rows, scenes_of
from bidexdata.frames import quat_angle, quat_conjugate, quat_multiply, quat_rotate, random_quat
from bidexdata.hands import load_hand
from bidexdata.objects.config import PrepareConfig, SdfConfig, SurfaceConfig
from bidexdata.objects.failure import PrepareFailure

FORM = load_format("dexgraspbench")
CONFIG = PrepareConfig(surface=SurfaceConfig(points=200), sdf=SdfConfig(cells=16, error=1.0))
FLOAT32 = 1e-6  # metres; poses are stored in it
NAME = "Two_Boxes"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return made_dexgraspbench(tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="module")
def obj(made):
    return FORM.load_object(FORM.find_object(NAME, made, None), CONFIG)


@pytest.fixture(scope="module")
def hand():
    return load_hand("capsule", "right")


def read(folder, content):
    save(folder / "x.npy", content)
    return FORM.read((folder / "x.npy").read_bytes(), "x.npy")


def one(**changes):
    return {**made_grasp(np.random.default_rng(1), NAME, 0.1), **changes}


def test_formats_are_known_by_name():
    for name in FORMATS:
        form = load_format(name)
        assert form.name == name
        assert len(form.sides) == len(form.joint_names)
    with pytest.raises(UnknownName, match="known: dexgraspbench"):
        load_format("dexgraspbensh")


def test_files_come_in_byte_order_from_graspdata_or_from_everywhere(made, tmp_path):
    found = FORM.files(made)
    assert len(found) == 8
    assert found == sorted(found)
    assert all(f.startswith("graspdata/") for f in found)
    for name in ("b/2.npy", "a/10.npy", "a/9.npy", ".hidden/1.npy", "a/.x.npy"):
        save(tmp_path / name, {})
    assert FORM.files(tmp_path) == ["a/10.npy", "a/9.npy", "b/2.npy"]


def test_a_file_s_numbers_are_the_hand_s_root_moved_to_the_palm(tmp_path):
    content = one()
    grasps = read(tmp_path, content)
    assert (len(grasps), grasps.several, grasps.left_out) == (1, False, ())
    assert grasps.object_name == f"assets/example_object/{NAME}"
    assert grasps.scale.tolist() == [0.1]
    for s, key in enumerate(("pregrasp_qpos", "grasp_qpos", "squeeze_qpos")):
        root, quat, joints = np.split(content[key].astype(float), [3, 7])
        quat /= np.linalg.norm(quat)
        palm = root + quat_rotate(quat, [0, 0, 0.034])
        np.testing.assert_allclose(grasps.hand_pos[0, 0, s], palm, atol=1e-12)
        np.testing.assert_allclose(grasps.hand_quat_wxyz[0, 0, s], quat, atol=1e-12)
        np.testing.assert_array_equal(grasps.joints[0][0, s], joints)


def test_a_file_of_several_grasps_gives_them_with_their_numbers(tmp_path):
    content = made_grasps(np.random.default_rng(2), NAME, 0.1, 3)
    grasps = read(tmp_path, content)
    assert (len(grasps), grasps.several, grasps.row.tolist()) == (3, True, [0, 1, 2])
    each = {
        "obj_scale": np.array([0.1, 0.2, 0.3]),
        "obj_pose": np.tile([1.0, 2, 3, 1, 0, 0, 0], (3, 1)),
    }
    grasps = read(tmp_path, content | each)
    assert grasps.scale.tolist() == [0.1, 0.2, 0.3]
    assert grasps.object_pos.tolist() == [[1, 2, 3]] * 3
    for row in range(3):
        alone = {k: v[row] if k.endswith("qpos") else v for k, v in content.items()}
        np.testing.assert_array_equal(
            read(tmp_path, alone).hand_pos[0], read(tmp_path, content).hand_pos[row]
        )


def test_bad_grasps_of_a_file_are_left_out_and_named(tmp_path):
    content = made_grasps(np.random.default_rng(2), NAME, 0.1, 3)
    content["grasp_qpos"][1, 8] = np.nan
    grasps = read(tmp_path, content)
    assert grasps.row.tolist() == [0, 2]
    assert grasps.left_out == ("grasp 1: its grasp_qpos is not finite",)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"grasp_qpos": None}, "has no grasp_qpos"),
        ({"grasp_qpos": np.zeros(28, np.float32)}, "grasp_qpos has shape"),
        ({"pregrasp_qpos": np.zeros(30, np.float32)}, r"pregrasp_qpos has shape \(30,\), not \(29"),
        ({"grasp_qpos": np.array(["a"] * 29)}, "grasp_qpos is not numbers"),
        ({"grasp_qpos": np.full(29, np.nan)}, "grasp_qpos is not finite"),
        ({"squeeze_qpos": np.zeros(29)}, "quaternion of its squeeze_qpos"),
        ({"obj_scale": np.float64(0)}, "obj_scale is 0"),
        ({"obj_scale": -0.1}, "obj_scale is -0.1"),
        ({"obj_scale": np.ones(2)}, "obj_scale has shape"),
        ({"obj_pose": np.zeros(7)}, "obj_pose is none"),
        ({"obj_pose": np.full(7, np.inf)}, "obj_pose is none"),
        ({"obj_path": None}, "no text obj_path"),
        ({"obj_path": 3}, "no text obj_path"),
        ({"obj_path": "/"}, "no text obj_path"),
    ],
)
def test_a_file_that_lacks_something_says_what(tmp_path, changes, said):
    content = {k: v for k, v in one(**changes).items() if v is not None}
    with pytest.raises(BadFile, match=said):
        read(tmp_path, content)


def test_a_file_of_no_grasps_is_named(tmp_path):
    none = {k: np.zeros((0, 29), np.float32) for k in dexgraspbench.STAGE_KEYS}
    with pytest.raises(BadFile, match="holds no grasp"):
        read(tmp_path, one(**none))


def test_an_object_is_found_by_its_path_in_objects_or_where_the_caller_says(made, tmp_path):
    by_name = FORM.find_object(f"assets/example_object/{NAME}", made, None)
    assert by_name.folder == made / "objects" / NAME
    own = tmp_path / "assets" / "example_object" / NAME
    shutil.copytree(by_name.folder, own)
    found = FORM.find_object(f"assets/example_object/{NAME}", tmp_path, None)
    assert found.folder == own
    assert found.object_id == by_name.object_id
    elsewhere = FORM.find_object(NAME, tmp_path / "nothing", made / "objects")
    assert elsewhere.object_id == by_name.object_id
    assert by_name.object_id == f"two_boxes-{by_name.sha256[:8]}"


@pytest.mark.parametrize("name", ["nothing", "/etc", "../../etc", "..", "a/../.."])
def test_an_object_that_is_not_there_is_named_and_no_path_leads_out(made, name):
    with pytest.raises(BadFile, match="has no urdf/meshes"):
        FORM.find_object(name, made / "graspdata", None)


def test_any_changed_byte_makes_another_object(made, tmp_path):
    folder = tmp_path / "objects" / NAME
    shutil.copytree(made / "objects" / NAME, folder)
    before = FORM.find_object(NAME, tmp_path, None).object_id
    for file in ("info/simplified.json", "urdf/meshes/convex_piece_001.obj"):
        with open(folder / file, "a") as stream:
            stream.write("\n")
        after = FORM.find_object(NAME, tmp_path, None).object_id
        assert after != before
        before = after


def test_an_object_is_its_pieces_as_they_are(obj):
    # Boxes 1.0 x 0.4 x 0.4 at x = 0.4 and 0.8 x 0.6 x 0.6 at x = -0.3, both at z = 0.1.
    volumes, centres = (0.16, 0.288), (0.4, -0.3)
    total = sum(volumes)
    x = sum(v * c for v, c in zip(volumes, centres, strict=True)) / total
    unit = np.linalg.norm([0.9 + 0.7, 0.6, 0.6])
    known = obj.provenance
    assert len(obj.pieces) == 2
    assert known["unit_in_file"] == pytest.approx(unit)
    np.testing.assert_allclose(known["origin_in_file"], [x, 0, 0.1], atol=1e-9)
    assert obj.volume == pytest.approx(total / unit**3, rel=FLOAT32)
    assert obj.nominal_volume == pytest.approx(NOMINAL / unit**3)
    np.testing.assert_allclose(obj.source_origin, [-x / unit, 0, -0.1 / unit], atol=1e-9)
    corners = np.concatenate([p.vertices for p in obj.pieces])
    assert np.linalg.norm(np.ptp(corners, axis=0)) == pytest.approx(1, abs=FLOAT32)
    expected = np.concatenate([box(*b) for b in OBJECTS[NAME]])
    in_file = np.array(known["origin_in_file"]) + unit * corners
    np.testing.assert_allclose(np.sort(in_file, 0), np.sort(expected, 0), atol=2 * FLOAT32)
    # Shown is the simplified mesh: the first box alone.
    shown = np.array(known["origin_in_file"]) + unit * obj.mesh.vertices
    np.testing.assert_allclose(shown.min(0), [-0.1, -0.2, -0.1], atol=2 * FLOAT32)
    assert known["mass_properties"] == "sum of pieces"
    assert known["piece_method"] == "given"
    assert known["licence"] == known["source"] == "unknown"
    assert len(obj.rest_heights) > 0
    assert len(obj.surface_points) == 200


def test_what_an_object_s_folder_lacks_is_done_without(tmp_path):
    made_object(tmp_path / "objects" / "a", OBJECTS["brick"])
    (tmp_path / "objects" / "a" / "mesh" / "simplified.obj").write_text("v 1 2 3\n")
    (tmp_path / "objects" / "a" / "info" / "simplified.json").write_text('{"mass": 0}')
    found = FORM.load_object(FORM.find_object("a", tmp_path, None), CONFIG)
    assert found.nominal_volume == found.volume
    np.testing.assert_allclose(found.mesh.vertices, found.solid.vertices, atol=FLOAT32)
    assert ["simplified.obj" in w or "simplified.json" in w for w in found.provenance["warnings"]]
    assert len(found.provenance["warnings"]) == 2
    shutil.rmtree(tmp_path / "objects" / "a" / "mesh")
    shutil.rmtree(tmp_path / "objects" / "a" / "info")
    bare = FORM.load_object(FORM.find_object("a", tmp_path, None), CONFIG)
    assert bare.provenance["warnings"] == []
    assert bare.nominal_volume == bare.volume


def test_a_flat_or_broken_piece_fails_the_object(tmp_path):
    folder = tmp_path / "objects" / "a"
    made_object(folder, OBJECTS["brick"])
    piece = folder / "urdf" / "meshes" / "convex_piece_001.obj"
    write_obj(piece, box((0, 0, 0), (1, 1, 0)))
    with pytest.raises(PrepareFailure, match="piece 1 of 2 is flat"):
        FORM.load_object(FORM.find_object("a", tmp_path, None), CONFIG)
    piece.write_text("not a mesh")
    with pytest.raises(PrepareFailure, match="no face"):
        FORM.load_object(FORM.find_object("a", tmp_path, None), CONFIG)


def test_a_list_beside_the_objects_states_their_licence(tmp_path):
    made_object(tmp_path / "objects" / "brick", OBJECTS["brick"])
    (tmp_path / "objects" / "INDEX.csv").write_text("file,licence,source\nbrick,CC0-1.0,mine\n")
    found = FORM.load_object(FORM.find_object("brick", tmp_path, None), CONFIG)
    assert (found.provenance["licence"], found.provenance["source"]) == ("CC0-1.0", "mine")
    assert found.provenance["author"] == "unknown"


def rows_of(parts, obj, hand, setting="floating"):
    return record_rows(
        parts,
        obj,
        (hand,),
        FORM,
        setting=setting,
        run_fingerprint="run",
        fingerprints={"run": "run"},
        version="0",
    )


def posed(tmp_path, rng, scale=0.1):
    """A grasp in a world where the object is somewhere, and the fixed points of the scene."""
    pose = np.concatenate([rng.normal(size=3), random_quat(rng)])
    return read(tmp_path, made_grasp(rng, NAME, scale, pose))


@pytest.mark.parametrize("setting", ["floating", "tabletop"])
def test_hands_stay_where_they_were_on_the_object(tmp_path, obj, hand, setting):
    rng = np.random.default_rng(5)
    for scale in (0.06, 0.123456):
        grasps = posed(tmp_path, rng, scale)
        batch = rows_of([("a.npy", grasps)], obj, hand, setting)
        origin = np.array(obj.provenance["origin_in_file"])
        unit = obj.provenance["unit_in_file"]
        assert batch["size"][0] == np.float32(scale * unit)
        for s in range(3):
            # The palm in the file's object frame, in metres.
            back = quat_conjugate(grasps.object_quat_wxyz[0])
            p_file = quat_rotate(back, grasps.hand_pos[0, 0, s] - grasps.object_pos[0])
            back_ours = quat_conjugate(batch["object_quat_wxyz"][0].astype(float))
            p_ours = quat_rotate(back_ours, batch["hand_pos"][0, 0, s] - batch["object_pos"][0])
            # x_file = origin_in_file + unit_in_file x_object, at the file's scale.
            np.testing.assert_allclose(p_file, scale * origin + p_ours, atol=2 * FLOAT32)
            turn_file = quat_multiply(back, grasps.hand_quat_wxyz[0, 0, s])
            turn_ours = quat_multiply(back_ours, batch["hand_quat_wxyz"][0, 0, s].astype(float))
            assert quat_angle(turn_file[None], turn_ours[None])[0] < 1e-5
        if setting == "floating":
            assert batch["object_pos"].tolist() == [[0, 0, 0]]
            assert batch["object_quat_wxyz"].tolist() == [[1, 0, 0, 0]]
        else:
            centre = grasps.object_pos[0] + quat_rotate(grasps.object_quat_wxyz[0], scale * origin)
            np.testing.assert_allclose(batch["object_pos"][0], [0, 0, centre[2]], atol=FLOAT32)
            turned = quat_angle(batch["object_quat_wxyz"], grasps.object_quat_wxyz)
            assert turned[0] < 1e-5


def test_rows_have_the_order_of_the_files_and_say_where_they_come_from(tmp_path, obj, hand):
    rng = np.random.default_rng(6)
    several = read(tmp_path, made_grasps(rng, NAME, 0.1, 3))
    single = read(tmp_path, made_grasp(rng, NAME, 0.2))
    batch = rows_of([("a/x.npy", several), ("b.npy", single)], obj, hand)
    assert batch["source_ref"].tolist() == ["a/x.npy#0", "a/x.npy#1", "a/x.npy#2", "b.npy"]
    unit = obj.provenance["unit_in_file"]
    mm = [round(100 * unit), round(200 * unit)]
    assert batch["size_mm"].tolist() == [mm[0]] * 3 + [mm[1]]
    assert batch["scene_id"].tolist() == [f"{obj.object_id}/{m}/float" for m in batch["size_mm"]]
    assert batch["attempt"].tolist() == [0, 1, 2, 0]
    assert len(set(batch["grasp_id"].tolist())) == 4
    assert set(batch.columns) == set(COLUMNS)
    assert batch["selected"].all()
    assert not batch["audit"].any()
    assert (batch["synth_status"] == 0).all()
    assert batch["sides"].tolist() == [[1]] * 4
    assert batch.header.counts == {}
    again = rows_of([("a/x.npy", several), ("b.npy", single)], obj, hand)
    assert again.to_arrow().equals(batch.to_arrow())


def test_joints_go_by_name_whatever_the_order_of_the_hand(tmp_path, obj, hand):
    from dataclasses import replace

    grasps = read(tmp_path, one())
    batch = rows_of([("a", grasps)], obj, hand)
    assert batch.header.hands[0].joint_names == tuple(hand.joint_names)
    for name, value in zip(hand.joint_names, batch["joints"][0, 0, 1], strict=True):
        assert value == np.float32(grasps.joints[0][0, 1, JOINT_NAMES.index(name)])
    other = replace(hand, joint_names=tuple(reversed(hand.joint_names)))
    assert joint_orders(FORM, (other,))[0].tolist() == [
        JOINT_NAMES.index(n) for n in reversed(hand.joint_names)
    ]
    with pytest.raises(NotUsable, match="joints of another hand than capsule"):
        joint_orders(FORM, (load_hand("capsule", "left"),))


def test_poses_on_a_table_are_numbered_as_they_come(tmp_path):
    rng = np.random.default_rng(7)
    quats = random_quat(rng, (3,))
    order = [2, 0, 2, 1, 0]
    grasps = [
        read(tmp_path, made_grasp(rng, NAME, 0.1, [*rng.normal(size=3), *(sign * quats[k])]))
        for k, sign in zip(order, (1, 1, -1, 1, -1), strict=True)
    ]
    places = [p for g in grasps for p in placed(g)]
    scenes = scenes_of("x", 2.0, places, "tabletop")
    assert [s.scene_id for s in scenes] == [f"x/200/table{k}" for k in (0, 1, 0, 2, 1)]
    assert {s.scene_id for s in scenes_of("x", 2.0, places, "floating")} == {"x/200/float"}


def test_the_root_lies_34_mm_below_the_palm_of_the_benchmark_s_hand(shared):
    text = (shared / "peers" / "dexgraspbench" / "hand" / "right_hand.xml").read_text()
    assert 'name="rh_palm"' in text
    line = next(x for x in text.splitlines() if 'name="rh_palm"' in x)
    assert f'pos="0 0 {ROOT_TO_PALM[2]:g}"' in line


def test_the_benchmark_s_own_files_are_read(shared):
    root = shared / "peers" / "dexgraspbench"
    with open(root / "peer_results.csv", newline="") as stream:
        results = {row["file"]: row for row in csv.DictReader(stream)}
    plain = np.load(root / "grasps.npz")
    assert tuple(plain["joint_names"].tolist()) == JOINT_NAMES
    files = FORM.files(root)
    assert set(files) == set(results)
    for number, file in enumerate(plain["source_file"].tolist()):
        grasps = FORM.read((root / file).read_bytes(), file)
        np.testing.assert_array_equal(grasps.joints[0][0, 1], plain["grasp_qpos"][number, 7:])
        assert grasps.scale[0] == plain["obj_scale"][number]


def test_the_benchmark_s_objects_weigh_what_it_compiled(shared):
    root = shared / "peers" / "dexgraspbench"
    with open(root / "peer_results.csv", newline="") as stream:
        results = list(csv.DictReader(stream))
    for name in sorted({row["object"] for row in results}):
        found = FORM.load_object(FORM.find_object(name, root, None), CONFIG)
        mass = 0.1 * found.volume / found.nominal_volume
        for row in results:
            if row["object"] == name:
                assert mass == pytest.approx(float(row["compiled_mass_kg"]), rel=1e-6)
        info = json.loads((root / "objects" / name / "info" / "simplified.json").read_text())
        # Pieces and mesh have nearly the same centre.
        gap = np.subtract(info["gravity_center"], found.provenance["origin_in_file"])
        assert np.linalg.norm(gap) < 0.01 * found.provenance["unit_in_file"]
