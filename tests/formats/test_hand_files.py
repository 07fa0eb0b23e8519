"""A hand in a release brings the licence of what it was derived from."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from made_release import OBJECTS, made_hand, made_release

from bidexdata.formats.hand_files import write_hand
from bidexdata.formats.manifest import MANIFEST
from bidexdata.formats.verify import verify_release
from bidexdata.hands import load_hands

ROOT = Path(__file__).resolve().parents[2]


def written(root: Path, hands) -> Path:
    for hand in hands:
        write_hand(root, hand)
    return root / "hands" / hands[0].name / "LICENSE"


def test_the_built_in_hand_carries_the_licence_of_the_project(tmp_path):
    licence = written(tmp_path, load_hands("capsule"))
    assert licence.read_bytes() == (ROOT / "LICENSE").read_bytes()


def test_a_hand_of_menagerie_carries_the_text_of_its_model(menagerie, tmp_path):
    licence = written(tmp_path, load_hands("shadow"))
    assert licence.read_bytes() == (menagerie / "shadow_hand" / "LICENSE").read_bytes()
    assert "Copyright 2022 Shadow Robot Company" in licence.read_text()


@pytest.mark.parametrize(
    ("left", "right", "expected"),
    [("A", "A", "A"), ("A\n", "B\n", "A\n\nB\n"), ("", "B", "B"), ("A", "", "A"), ("", "", None)],
)
def test_sides_of_two_sources_keep_both_texts(tmp_path, left, right, expected):
    texts = {"left": left, "right": right}
    hands = [replace(made_hand(side), licence_text=text) for side, text in texts.items()]
    licence = written(tmp_path, hands)
    assert (licence.read_text() if licence.exists() else None) == expected
    tree = json.loads((licence.parent / "left" / "tree.json").read_text())
    assert "licence_text" not in tree  # once per hand is enough


def test_the_licence_is_under_the_manifest(tmp_path):
    hands = tuple(replace(made_hand(side), licence_text="Free.") for side in ("left", "right"))
    out = made_release(tmp_path / "r", OBJECTS[:1], hands=hands)
    assert "hands/made/LICENSE" in json.loads((out / MANIFEST).read_text())["files"]
    assert verify_release(out, full=True).ok
