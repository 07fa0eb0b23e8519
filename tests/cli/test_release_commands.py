"""migrate, merge, split, subset and diff from the command line: chains, exit codes, sentences."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest
from made_release import OBJECTS, made_release
from old_releases import unpacked

from bidexdata.cli.main import run
from bidexdata.formats.release import Release
from bidexdata.formats.verify import verify_release
from bidexdata.hands import load_hands
from bidexdata.runs import release_pictures
from bidexdata.runs.release_pictures import SHEET, card_pictures


@pytest.fixture(scope="module")
def packed(tmp_path_factory) -> Path:
    return made_release(tmp_path_factory.mktemp("packed") / "release")


def said(capsys) -> dict:
    return json.loads(capsys.readouterr().out)


def quiet(*words: object) -> list[str]:
    return [*map(str, words), "--no-pictures", "--quiet"]


def test_a_release_goes_through_every_command_and_keeps_every_law(packed, tmp_path, capsys):
    old = unpacked("schema-1.2", tmp_path / "old")
    assert run([*quiet("migrate", old, "--out", tmp_path / "new"), "--json"]) == 0
    data = said(capsys)
    assert data["n"] == 7
    assert shlex.split(data["next"])[:2] == ["bidexdata", "verify"]
    version = ("--version", "1.1.0")
    mugs = quiet(
        "subset", packed, "--out", tmp_path / "a", *version, "--where", "category == 'box'"
    )
    assert run([*mugs, "--json"]) == 0
    assert said(capsys)["whole_scenes"] is True
    rest = quiet(
        "subset", packed, "--out", tmp_path / "b", *version, "--where", "category != 'box'"
    )
    assert run(rest) == 0
    parts = (tmp_path / "a", tmp_path / "b")
    assert run(quiet("merge", *parts, "--out", tmp_path / "c", *version, "--name", "whole")) == 0
    assert run(["diff", str(packed), str(tmp_path / "c"), "--json"]) == 0
    data = said(capsys)
    assert data["same"] is True
    assert data["about"]["name"] == {"a": "made", "b": "whole"}
    sizes = quiet("split", tmp_path / "c", "--out", tmp_path / "d", *version, "--by", "size")
    assert run(sizes) == 0
    won = quiet("subset", packed, "--out", tmp_path / "e", *version, "--where", "suc_f and pd < 1")
    assert run(won) == 0
    assert "no unselected rate" in capsys.readouterr().err
    for name in ("new", "a", "b", "c", "d", "e"):
        report = verify_release(tmp_path / name, full=True)
        assert report.ok, (name, [c.detail for c in report.checks if not c.ok])


def test_diff_tells_a_person_what_differs(packed, tmp_path, capsys):
    other = made_release(tmp_path / "other", OBJECTS[:2], version="1.0.1")
    assert run(["diff", str(packed), str(other)]) == 0
    out = capsys.readouterr().out
    assert "objects: 2 in both, 0 of them changed, 1 only in A, 0 only in B" in out
    assert "not the same content" in out
    assert run(["diff", str(packed), str(packed)]) == 0
    assert "\nthe same content" in capsys.readouterr().out


WRONG = [
    (3, ["subset", "{r}", "--where", "colour == 'red'"], "no column is called 'colour'"),
    (3, ["subset", "{r}", "--where", "suc_f and and"], "cannot be read"),
    (3, ["subset", "{r}", "--where", "category == 'cup'"], "no scene of"),
    (3, ["subset", "{r}", "--where", "pd > 1000"], "no row of"),
    (3, ["split", "{r}", "--by", "colour"], "one of object, category, size"),
    (2, ["split", "{r}", "--test-fraction", "1.5"], "between 0 and 1"),
    (3, ["merge", "{r}", "--name", "x"], "two releases or more"),
    (3, ["merge", "{r}", "{r}", "--name", "x"], "named twice"),
    (3, ["split", "{tmp}/nowhere"], "no such file or folder"),
]


@pytest.mark.parametrize(("code", "arguments", "says"), WRONG, ids=lambda v: str(v)[:40])
def test_what_is_wrong_is_one_sentence(code, arguments, says, packed, tmp_path, capsys):
    arguments = [a.format(r=packed, tmp=tmp_path) for a in arguments]
    out = ["--out", str(tmp_path / "x"), "--version", "1.1.0"]
    got = run([*arguments, *out])
    err = capsys.readouterr().err
    assert says in err
    assert got == code
    assert err.count("error: ") == 1
    assert not (tmp_path / "x").exists()


def test_the_card_has_a_picture_that_is_the_same_every_time(tmp_path, shown_on_cards, monkeypatch):
    monkeypatch.setattr(release_pictures, "SHOWN", shown_on_cards)
    hands = load_hands("capsule")
    made = [
        made_release(tmp_path / name, OBJECTS[:2], hands=hands, pictures=card_pictures)
        for name in ("a", "b")
    ]
    pictures = [(m / SHEET).read_bytes() for m in made]
    assert pictures[0] == pictures[1]
    assert pictures[0].startswith(b"\x89PNG")
    assert len(pictures[0]) < 400_000
    for page in ("DATASET_CARD.md", "README.md"):
        assert f"]({SHEET})" in (made[0] / page).read_text()
    assert SHEET in Release.open(made[0]).manifest["files"]
    assert verify_release(made[0], full=True).ok
