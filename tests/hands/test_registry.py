"""Names, specs and what goes wrong with them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from bidexdata.errors import BadConfig, NotUsable, PathNotFound, UnknownKey, UnknownName
from bidexdata.hands import hand_names, load_drawn, load_hand, load_hands, registry
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.hands.meshes import visual_meshes
from bidexdata.hands.source import load_model
from bidexdata.hands.urdf import hand_urdf

SPECS = Path(registry.__file__).parent / "specs"


def test_names_list_the_shipped_hands():
    assert hand_names() == ("allegro", "capsule", "leap", "shadow")
    for name in hand_names():
        spec = registry.hand_spec(name)
        assert spec.name == name
        assert set(spec.sides) == {"left", "right"}


def test_unknown_hand_lists_the_names():
    with pytest.raises(UnknownName, match="known: allegro, capsule, leap, shadow") as caught:
        load_hand("shadwo", "left")
    assert caught.value.exit_code == 3
    assert "did you mean 'shadow'" in str(caught.value)
    with pytest.raises(UnknownName, match=r"no\.yaml"):
        load_hand("no.yaml", "left")


def test_one_name_or_two_give_left_and_right():
    left, right = load_hands("capsule")
    assert (left.side, right.side) == ("left", "right")
    assert load_hands("capsule, capsule") == (left, right)
    for wrong in ("", "capsule,", "capsule,capsule,capsule"):
        with pytest.raises(BadConfig):
            load_hands(wrong)


def test_missing_menagerie_names_the_variable_and_the_way_out(tmp_path, monkeypatch):
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    with pytest.raises(NotUsable, match="MENAGERIE_ROOT") as caught:
        load_model(registry.hand_spec("shadow"), "right", SPECS)
    text = str(caught.value)
    assert "--hand capsule" in text
    assert "\n" not in text


def test_header_carries_what_files_need(hand):
    header = hand.header()
    assert header.joint_names == hand.joint_names
    assert header.contact_names[: hand.fingertips] == ("ff", "mf", "rf", "lf", "th")
    assert header.contact_names == hand.contact_names
    assert header.root_body.endswith("palm")
    assert len(header.spec_hash) == 64


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("name", ["capsule", "shadow", "leap"])
def test_a_hand_that_is_only_drawn_has_the_kinematics_and_shapes_of_the_whole_one(
    name, side, request
):
    if name != "capsule":
        request.getfixturevalue("menagerie")
    whole, drawn = load_hand(name, side), load_drawn(name, side)
    assert (drawn.spec_hash, drawn.body_names) == (whole.spec_hash, whole.body_names)
    assert drawn.joint_names == whole.joint_names
    rng = np.random.default_rng(0)
    for angles in rng.uniform(whole.joint_lower, whole.joint_upper, (4, len(whole.joint_names))):
        for mine, theirs in zip(
            *(forward_kinematics(h, angles) for h in (drawn, whole)), strict=True
        ):
            np.testing.assert_array_equal(mine, theirs)
    for mine, theirs in zip(visual_meshes(drawn), visual_meshes(whole), strict=True):
        assert mine.body == theirs.body
        np.testing.assert_array_equal(mine.mesh.vertices, theirs.mesh.vertices)


def test_palm_is_the_root_and_nothing_above_it_remains(hand):
    model = hand.make_spec().compile()
    assert hand.root_body == ("lh_palm" if hand.side == "left" else "rh_palm")
    assert (model.nq, model.nu, model.nbody) == (22, 18, 24)
    assert hand.body_joint[0] == -1
    assert hand.coupling.shape == (22, 18)
    assert not any("WRJ" in n for n in (*hand.joint_names, *hand.actuator_names))
    np.testing.assert_array_equal(model.body_pos[1], 0)
    np.testing.assert_array_equal(model.body_quat[1], [1, 0, 0, 0])


def test_specs_are_fresh_and_attach_to_a_scene(hands):
    scene = mujoco.MjSpec()
    scene.option.cone, scene.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10
    for hand in hands:
        first, second = hand.make_spec(), hand.make_spec()
        assert first is not second
        first.body(hand.root_body).add_freejoint()
        scene.attach(first, prefix=f"{hand.side}/", frame=scene.worldbody.add_frame())
    model = scene.compile()
    assert model.nq == 2 * (7 + 22)
    assert model.nu == 36
    assert hands[0].make_spec().compile().nq == 22


def test_another_process_gives_the_same_hand_to_the_bit(hands):
    code = (
        "import sys; from bidexdata.hands import load_hands;"
        "print(*(x for h in load_hands(sys.argv[1]) for x in"
        " (h.spec_hash, h.sphere_pos.tobytes().hex(), h.self_pairs.tobytes().hex())))"
    )
    command = [sys.executable, "-c", code, hands[0].name]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    expected = [
        text
        for h in hands
        for text in (h.spec_hash, h.sphere_pos.tobytes().hex(), h.self_pairs.tobytes().hex())
    ]
    assert done.stdout.split() == expected


def test_spec_hash_ignores_comments_and_sees_values(tmp_path):
    original = load_hand("capsule", "right")
    text = (SPECS / "capsule.yaml").read_text()
    (tmp_path / "capsule_links.yaml").write_text((SPECS / "capsule_links.yaml").read_text())
    commented, changed = tmp_path / "a.yaml", tmp_path / "b.yaml"
    commented.write_text("# another comment\n" + text)
    changed.write_text(text.replace("radius: 0.007,", "radius: 0.0071,"))
    assert load_hand(commented, "right").spec_hash == original.spec_hash
    assert load_hand(changed, "right").spec_hash != original.spec_hash


def one_finger(folder, *, head="", palm="", tail="", sphere=""):
    """Write a spec with a model of one finger on a palm on an arm; return the spec's path."""
    (folder / "hand.xml").write_text(
        f"""<mujoco>{head}<worldbody><body name="arm"><joint name="elbow" range="-1 1" axis="0 1 0"/>
        <geom size="0.02" {sphere}/><body name="palm" pos="0 0 0.1" euler="0 30 0">
        <joint name="wrist" range="-1 1"/><geom type="box" size=".03 .01 .03"/>{palm}
        <body name="tip" pos="0 0 .03"><joint name="bend" range="0 90" axis="1 0 0"/>
        <geom type="capsule" fromto="0 0 .01 0 0 .04" size=".008"/></body></body></body></worldbody>
        <actuator><position joint="wrist"/><position name="b" joint="bend" kp="2"/></actuator>{tail}
        </mujoco>"""
    )
    spec = {
        "name": "finger", "description": "one finger", "licence": "Apache-2.0",
        "sides": {"right": {"source": "hand.xml"}}, "written_for": "right", "root": "palm",
        "fingers": {"f": ["tip"]}, "coupled": {}, "postures": {"open": {"bend": 0.1}, "curved": {}},
        "contacts": [{"name": "f", "finger": "f", "body": "tip", "pos": [0, 0, 0.04],
                      "radius": 0.008, "normal": [0, -1, 0]}],
        "palm_frame": {"pos": [0, -0.01, 0], "x": [0, 0, 1], "z": [0, -1, 0]},
    }  # fmt: skip
    path = folder / "finger.yaml"
    path.write_text(yaml.safe_dump(spec))
    return path


def test_a_users_spec_may_name_an_mjcf_file(tmp_path):
    path = one_finger(tmp_path)
    hand = load_hand(path, "right")
    assert hand.body_names == ("palm", "tip")
    assert hand.joint_names == ("bend",)
    assert hand.actuator_names == ("b",)
    assert hand.joint_upper[0] == pytest.approx(np.pi / 2, abs=1e-5)  # MJCF text has six digits
    with pytest.raises(BadConfig, match="no left side"):
        load_hand(path, "left")


MESH = '<asset><mesh name="plate" file="sub/plate.stl"/></asset>'


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ({"head": MESH}, r"hand\.xml: mesh 'plate' names the file .*plate\.stl, which cannot be read"),
        ({"palm": '<geom type="mesh" mesh="plate"/>'}, "plate"),
        ({"palm": '<body name="bone"><joint name="loose" range="0 1"/></body>'}, "refuses the hand .*mass"),
        ({"palm": '<geom type="ellipsoid" size=".1 .1 .2"/>'}, "'palm' .*ellipsoid"),
        ({"head": "<bones/>"}, "cannot read this model .*bones"),
    ],
)  # fmt: skip
def test_a_model_that_mujoco_refuses_is_one_sentence_with_file_and_key(tmp_path, parts, says):
    with pytest.raises(BadConfig, match=says) as caught:
        load_hand(one_finger(tmp_path, **parts), "right")
    assert "\n" not in str(caught.value)
    if "ellipsoid" not in says:
        assert str(caught.value).startswith(f"sides.right.source: {tmp_path / 'hand.xml'}: ")


def test_a_mesh_may_lie_in_a_folder_of_the_meshes(tmp_path):
    (tmp_path / "meshes" / "sub").mkdir(parents=True)
    corners = np.array([[0, 0, 0], [0.02, 0, 0], [0, 0.02, 0], [0, 0, 0.02]], np.float32)
    faces = corners[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]]
    record = np.zeros(4, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    record["corners"] = faces
    stl = bytes(80) + np.uint32(4).tobytes() + record.tobytes()
    (tmp_path / "meshes" / "sub" / "plate.stl").write_bytes(stl)
    head = '<compiler meshdir="meshes"/>' + MESH
    hand = load_hand(
        one_finger(tmp_path, head=head, palm='<geom type="mesh" mesh="plate"/>'), "right"
    )
    assert hand.make_spec().compile().nmesh == 1


def test_what_is_only_looked_at_need_not_be_there(tmp_path):
    """Textures, also where defaults name them, skins, and the height field of the world."""
    head = """<default><material texture="skin"/></default><asset>
    <texture name="skin" type="2d" file="gone.png" gridsize="1 1"/>
    <texture name="cube" type="cube" fileleft="left.png" fileright="right.png"/>
    <hfield name="ground" file="ground.png" size="1 1 1 1"/>
    <material name="red" rgba="1 0 0 1"/><material name="cubes" texture="cube" rgba="0 1 0 1"/></asset>"""
    hand = load_hand(
        one_finger(
            tmp_path,
            head=head,
            palm='<geom size=".01" material="red"/><geom size=".01" material="cubes"/>',
            tail='<deformable><skin name="glove" file="gone.skn"/></deformable>',
            sphere='type="hfield" hfield="ground"',
        ),
        "right",
    )
    colours = {mesh.rgba for mesh in visual_meshes(hand)}
    assert {(1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)} <= colours


@pytest.mark.parametrize(
    ("change", "error", "says"),
    [
        ({"colour": "red"}, UnknownKey, "colour"),
        ({"root": "elbow"}, BadConfig, "no body 'rh_elbow'"),
        ({"written_for": "up"}, BadConfig, "left, right"),
        ({"coupled": {"FFJ1": "XXJ2"}}, BadConfig, "XXJ2"),
        ({"coupled": {"FFJ1": "FFJ2", "FFJ2": "FFJ3"}}, BadConfig, "itself follows"),
        ({"postures": {"open": {"FFJ3": 3.0}, "curved": {}}}, BadConfig, "outside its limits"),
        ({"fingers": {"ff": ["ffdistal"]}}, BadConfig, "finger"),
        ({"exclude_contacts": [["palm", "nose"]]}, BadConfig, "nose"),
        ({"spheres": {"slack": 0.4, "gap": 1}}, UnknownKey, "gap"),
        ({"palm_frame": {"pos": [0, 0, 0], "x": [1, 0, 0], "z": [1, 0, 0]}}, BadConfig, "perpend"),
        ({"sides": {"right": {"source": "gone.xml"}}}, PathNotFound, r"gone\.xml"),
        ({"contacts": None}, BadConfig, "contacts"),
    ],
)
def test_an_impossible_spec_is_one_sentence(tmp_path, change, error, says):
    (tmp_path / "capsule_links.yaml").write_text((SPECS / "capsule_links.yaml").read_text())
    data = yaml.safe_load((SPECS / "capsule.yaml").read_text()) | change
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in data.items() if v is not None}))
    with pytest.raises(error, match=says):
        load_hand(path, "right")


def test_urdf_has_a_link_per_body_and_reads_back(hand):
    from xml.etree import ElementTree

    robot = ElementTree.fromstring(hand_urdf(hand))
    assert [link.get("name") for link in robot.findall("link")] == list(hand.body_names)
    moving = [j.get("name") for j in robot.findall("joint") if j.get("type") == "revolute"]
    assert moving == list(hand.joint_names)
