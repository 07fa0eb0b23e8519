"""A hand is read from a release whole, or not at all."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from made_release import OBJECTS, made_release

from bidexdata.errors import Contradiction, NotUsable
from bidexdata.formats.hand_files import hand_folder, write_hand
from bidexdata.formats.manifest import write_manifest
from bidexdata.formats.release import Release
from bidexdata.formats.stored_hand import stored_hand
from bidexdata.hands import load_hands
from bidexdata.runs.resimulate import release_hands

NOT_STORED = ("make_spec", "make_mounted", "licence_text")
NAMES_OF_FILES = ("paths", "mesh_pathadr", "signature")


def written(root: Path, hand) -> Path:
    write_hand(root, hand)
    return root / hand_folder(hand.name, hand.side)


def same_hand(a, b) -> None:
    for field in dataclasses.fields(a):
        if field.name in NOT_STORED:
            continue
        mine, theirs = getattr(a, field.name), getattr(b, field.name)
        assert type(mine) is type(theirs), field.name
        if isinstance(mine, np.ndarray):
            assert (mine.dtype, mine.shape) == (theirs.dtype, theirs.shape), field.name
            np.testing.assert_array_equal(mine, theirs, field.name)
        else:
            assert mine == theirs, field.name


def same_model(a, b) -> None:
    for name in dir(a):
        value = None if name.startswith("_") else getattr(a, name)
        if isinstance(value, np.ndarray) and name not in NAMES_OF_FILES:
            np.testing.assert_array_equal(value, getattr(b, name), name)


@pytest.mark.parametrize("side", [0, 1])
def test_a_hand_without_meshes_comes_back_whole(tmp_path, side):
    hand = load_hands("capsule")[side]
    stored = stored_hand(written(tmp_path, hand), {})
    assert stored is not None
    same_hand(hand, stored)
    same_model(hand.make_spec().compile(), stored.make_spec().compile())


def test_a_hand_with_meshes_comes_back_where_they_are_its_own(menagerie, tmp_path):
    hand = load_hands("shadow")[1]
    folder, assets = written(tmp_path, hand), hand.make_spec().assets
    assert stored_hand(folder, {}) is None
    stored = stored_hand(folder, assets)
    assert stored is not None
    same_hand(hand, stored)
    same_model(hand.make_spec().compile(), stored.make_spec().compile())
    longest = max(assets, key=lambda name: len(assets[name]))
    other = next(name for name in assets if name != longest and name.endswith(".obj"))
    assert stored_hand(folder, {**assets, longest: assets[other]}) is None


def test_an_unreadable_hand_is_one_sentence(tmp_path):
    folder = written(tmp_path, load_hands("capsule")[0])
    (folder / "hand.xml").write_text("<mujoco")
    with pytest.raises(Contradiction, match="unreadable hand"):
        stored_hand(folder, {})


def test_the_hands_of_a_release_are_its_own_and_else_those_of_here(tmp_path):
    out = made_release(tmp_path / "r", OBJECTS[:1], hands=load_hands("capsule"))
    assert release_hands(Release.open(out)).borrowed == ()
    head = json.loads((out / "manifest.json").read_text())
    path = out / hand_folder("capsule", "left") / "tree.json"
    tree = json.loads(path.read_text())
    del tree["prefix"]  # as an older version wrote it
    path.write_text(json.dumps(tree))
    del head["files"]
    write_manifest(out, head)
    found = release_hands(Release.open(out))
    assert found.borrowed == ("capsule",)
    assert [h.side for h in found.hands] == ["left", "right"]


def test_a_hand_that_nobody_has_is_told(tmp_path):
    """The made hand's release is whole, and an older one of it has no hand to fall back on."""
    out = made_release(tmp_path / "r", OBJECTS[:1])
    assert release_hands(Release.open(out)).borrowed == ()
    head = json.loads((out / "manifest.json").read_text())
    path = out / hand_folder("made", "right") / "tree.json"
    tree = json.loads(path.read_text())
    del tree["prefix"]
    path.write_text(json.dumps(tree))
    del head["files"]
    write_manifest(out, head)
    with pytest.raises(NotUsable, match="made"):
        release_hands(Release.open(out))
