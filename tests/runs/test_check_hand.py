"""`hands check`: a right spec passes, and each wrong number fails the check that is about it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from bidexdata.cli.main import run
from bidexdata.hands.registry import spec_path
from bidexdata.runs.check_hand import CHECKS, inspect_hand

CAPSULE = spec_path("capsule")


def changed(tmp_path: Path, **changes: Any) -> str:
    """The spec of the built-in hand with some keys replaced."""
    shutil.copy(CAPSULE.with_name("capsule_links.yaml"), tmp_path)
    path = tmp_path / "changed.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(CAPSULE.read_text()) | changes))
    return str(path)


def contacts(index: int, **changes: Any) -> list[dict[str, Any]]:
    """The contact points of the built-in hand, one of them changed."""
    points = yaml.safe_load(CAPSULE.read_text())["contacts"]
    points[index] |= changes
    return points


def changed_again(tmp_path: Path, **changes: Any) -> str:
    """Another spec beside the list of links that is there."""
    path = tmp_path / "again.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(CAPSULE.read_text()) | changes))
    return str(path)


def sides(**changes: Any) -> dict[str, Any]:
    """The sides of the built-in hand; the left one has a palm frame of its own, with changes."""
    both = yaml.safe_load(CAPSULE.read_text())["sides"]
    frame = {"pos": [0, -0.012, 0.055], "x": [0, 0, 1], "z": [0, -1, 0]} | changes
    return {**both, "left": both["left"] | {"palm_frame": frame}}


def posture(**angles: float) -> dict[str, Any]:
    """The postures of the built-in hand, the open one changed."""
    postures = yaml.safe_load(CAPSULE.read_text())["postures"]
    return {**postures, "open": postures["open"] | angles}


def failed(name: str) -> dict[str, str]:
    """The checks that fail, with what they say."""
    return {f.check: f.says for f in inspect_hand(name)[0] if f.passed is False}


def test_the_built_in_hand_passes_every_check():
    findings, hands = inspect_hand("capsule")
    assert [f for f in findings if not f.passed] == []
    assert {f.check for f in findings} == set(CHECKS) - {"grasp"}
    assert [hand.side for hand in hands] == ["right", "left"]


@pytest.mark.parametrize(
    ("changes", "check", "says"),
    [
        ({"mirror": "z"}, "mirror", "`mirror`"),
        ({"sides": sides(pos=[0.02, -0.012, 0.055])}, "mirror", "`sides.left.palm_frame`"),
        ({"postures": posture(FFJ3=2.0)}, "limits", "postures.open: FFJ3 is 2"),
        ({"contacts": contacts(0, pos=[0, -0.004, 0.0245])}, "contacts", "contact ff: the sphere"),
        ({"contacts": contacts(1, pos=[0.02, 0, 0.02])}, "contacts", "contact mf: its centre"),
        ({"contacts": contacts(2, radius=0.012)}, "contacts", "contact rf: the sphere"),
        ({"contacts": contacts(4, finger="ff")}, "contacts", "none of finger ff"),
        ({"spheres": {"worth": 0.01}}, "spheres", "spheres.worth"),
        ({"spheres": {"min_radius": 0.03, "max_radius": 0.04}}, "spheres", "spheres.min_radius"),
        ({"spheres": {"protrusion": 0.02, "max_radius": 0.05}}, "spheres", "spheres.protrusion"),
        ({"palm_frame": {"pos": [0, -0.003, 0.055], "x": [0, 0, 1], "z": [0, -1, 0]}}, "palm", "inside"),
        ({"palm_frame": {"pos": [0, -0.012, 0.055], "x": [0, 0, 1], "z": [0, 1, 0]}}, "palm", "z"),
        ({"postures": posture(FFJ4=-0.34, MFJ4=0.34)}, "postures", "exclude_contacts"),
    ],
)  # fmt: skip
def test_a_wrong_number_fails_its_check_and_names_the_key(tmp_path, changes, check, says):
    if check != "mirror":  # what is wrong with one hand is found with one
        changes = {"sides": {"right": sides()["right"]}} | changes
    found = failed(changed(tmp_path, **changes))
    assert check in found
    assert says in found[check]


def test_joints_without_inertia_fail_and_an_armature_in_the_spec_helps(tmp_path):
    spec = changed(tmp_path)
    links = tmp_path / "capsule_links.yaml"
    links.write_text(links.read_text().replace("armature: 0.0002", "armature: 0.0"))
    assert "joint_armature" in failed(spec)["armature"]
    assert failed(changed_again(tmp_path, joint_armature=0.001)) == {}


def test_a_normal_that_points_back_is_found_by_how_the_finger_closes(tmp_path):
    found = failed(changed(tmp_path, contacts=contacts(0, normal=[0, 0.82, 0.57])))
    assert "moves away from where its normal points" in found["contacts"]


def test_a_model_that_is_not_there_fails_first_and_nothing_else_is_made(tmp_path, capsys):
    spec = changed(tmp_path, sides={"right": {"source": "gone.xml"}})
    assert run(["hands", "check", spec, "--out", str(tmp_path / "hand.png"), "--json"]) == 3
    out, err = capsys.readouterr()
    report = json.loads(out)
    assert not report["passed"]
    assert [c["check"] for c in report["checks"] if c["passed"] is False] == ["model"]
    assert {c["check"] for c in report["checks"]} == set(CHECKS)
    assert not (tmp_path / "hand.png").exists()
    assert "1 check: model" in err
    assert err.count("error: ") == 1


def test_a_mesh_that_is_not_there_fails_the_check_of_the_model(tmp_path, capsys):
    (tmp_path / "bare.xml").write_text(
        '<mujoco><asset><mesh name="plate" file="plate.stl"/></asset><worldbody><body name="rh_palm">'
        '<geom type="mesh" mesh="plate"/></body></worldbody></mujoco>'
    )
    spec = changed(tmp_path, sides={"right": {"source": "bare.xml", "prefix": "rh_"}})
    assert run(["hands", "check", spec, "--out", str(tmp_path / "hand.png"), "--json"]) == 3
    first = json.loads(capsys.readouterr().out)["checks"][0]
    assert (first["check"], first["passed"]) == ("model", False)
    assert "mesh 'plate' names the file" in first["says"]
    assert "sides.right.source" in first["says"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nose"], "no hand is called"),
        (["capsule", "--out", "hand.txt"], ".png"),
        (["capsule", "--out", "no/folder/hand.png"], "folder"),
    ],
)
def test_what_cannot_be_checked_is_one_sentence(arguments, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["hands", "check", *arguments]) == 3
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1


def test_the_built_in_hand_grasps_and_is_drawn(tmp_path, capsys):
    from PIL import Image

    picture = tmp_path / "capsule.png"
    assert run(["hands", "check", "capsule", "--out", str(picture), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["passed"]
    assert report["grasps_held"] >= 1
    assert Image.open(picture).size[0] > 1000
