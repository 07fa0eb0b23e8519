"""`validate` through the command line: protocols of one's own, extra columns, replay, tables."""

from __future__ import annotations

import json
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from bidexdata import Release, Run
from bidexdata.cli.main import run
from bidexdata.pictures import sheet
from bidexdata.runs.shards import read_mark, shard_path

SMALL = (
    *("--hand", "capsule", "--sizes", "0.3", "--grasps", "2", "--candidates", "4"),
    *("--set", "regions.anchors=60", "--set", "optimise.approach.steps=40"),
    *("--executor", "inline", "--quiet"),
)
MINE = "base: paper-1\nname: short-1\ndescription: a shorter hold\nhold: 0.5\n"
BLANK = Image.new("RGB", (2, 2))
INLINE = ("--executor", "inline", "--quiet")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("validate") / "library"
    assert run(["prepare", "shapes:box", "--out", str(folder), *INLINE]) == 0
    return folder


def made(library: Path, name: str, *options: str) -> Path:
    folder = library.parent / name
    assert run(["synth", str(library), "--out", str(folder), *SMALL, *options]) == 0
    return folder


@pytest.fixture(scope="module")
def floating(library: Path) -> Path:
    folder = made(library, "floating")
    assert run(["validate", str(folder), *INLINE]) == 0
    return folder


@pytest.fixture(scope="module")
def tabletop(library: Path) -> Path:
    folder = made(library, "tabletop", "--setting", "tabletop")
    assert run(["validate", str(folder), *INLINE]) == 0
    return folder


def protocol_file(folder: Path) -> Path:
    path = folder / "mine.yaml"
    path.write_text(MINE)
    return path


def test_a_protocol_of_ones_own_is_stored_read_and_packed(floating, tmp_path, capsys):
    mine = str(protocol_file(tmp_path))
    assert run(["validate", str(floating), "--protocol", mine, *INLINE]) == 0
    opened = Run.open(floating)
    assert opened.protocol("short-1").hold == 0.5
    assert opened.verdict_tests() == [("paper-1", "f"), ("short-1", "f")]
    assert run(["info", str(floating), "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)["protocols"]) == {"paper-1", "short-1"}
    out = tmp_path / "release"
    named = ("--name", "x", "--version", "1.0.0", "--quiet")
    assert run(["pack", str(floating), "--out", str(out), *named]) == 0
    settings = Release.open(out).protocol_settings
    assert settings["short-1"]["hold"] == 0.5
    assert settings["paper-1"]["hold"] == 3.0
    assert run(["verify", str(out), "--full", "--quiet"]) == 0


def test_other_settings_under_a_stored_name_are_refused(floating, tmp_path, capsys):
    mine = protocol_file(tmp_path)
    assert run(["validate", str(floating), "--protocol", str(mine), *INLINE]) == 0
    mine.write_text(MINE.replace("0.5", "0.7"))
    assert run(["validate", str(floating), "--protocol", str(mine), *INLINE]) == 5
    assert "hold: 0.5 -> 0.7" in capsys.readouterr().err


def test_set_needs_a_name_of_its_own(floating, capsys):
    assert run(["validate", str(floating), "--set", "hold=1.0", *INLINE]) == 3
    assert "--set name=NAME" in capsys.readouterr().err


def test_extra_columns_are_measured_once_asked_for_and_never_lost(library):
    folder = made(library, "extras")
    validate = ["validate", str(folder), "--set", "name=brief-1", "--set", "hold=0.3", *INLINE]
    assert run(validate) == 0
    opened = Run.open(folder)
    (task,) = opened.tasks
    path = shard_path(opened.stage_folder("validate", "brief-1", "f"), task.task_id)

    def columns():
        return next(iter(Run.open(folder).batches("brief-1", "f")))

    plain = columns()
    assert np.isnan(plain.load_margin).all()
    assert read_mark(path).notes["extras"] == []
    assert run([*validate, "--load-margin"]) == 0
    loaded = columns()
    ran = loaded.synth_status == 0
    np.testing.assert_array_equal(loaded.load_margin[ran] >= 1, loaded.success[ran])
    assert run([*validate, "--analytic"]) == 0
    both = columns()
    assert read_mark(path).notes["extras"] == ["analytic", "load_margin"]
    np.testing.assert_array_equal(both.load_margin, loaded.load_margin)
    assert np.isfinite(both.q1[ran]).all()
    np.testing.assert_array_equal(both.success, plain.success)
    before = path.read_bytes()
    assert run(validate) == 0
    assert path.read_bytes() == before


def test_tabletop_rows_are_tested_for_closure_and_lift(tabletop):
    opened = Run.open(tabletop)
    assert opened.verdict_tests() == [("paper-1", "f"), ("paper-1", "l")]
    assert sum(b.success.sum() for b in opened.batches("paper-1", "l")) > 0


def test_pictures_of_a_tabletop_run_tell_both_verdicts(tabletop, tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(sheet, "contact_sheet", lambda tiles, **_: told.extend(tiles) or BLANK)
    assert run(["render", str(tabletop), "--out", str(tmp_path / "a.png"), "--quiet"]) == 0
    opened = Run.open(tabletop)
    for tile in told:
        said = tile.caption.lines
        for test, line, good in zip("fl", said[1:], tile.caption.good, strict=True):
            rows = next(iter(opened.batches("paper-1", test)))
            (row,) = np.flatnonzero([str(g) in said[0] for g in rows.grasp_id])
            assert good == rows.success[row]
            assert f"test {test}" in line
    assert told


def test_a_release_of_tabletop_grasps_can_be_lifted_again(tabletop, tmp_path, capsys):
    named = ("--name", "x", "--version", "1.0.0", "--quiet")
    assert run(["pack", str(tabletop), "--out", str(tmp_path / "release"), *named]) == 0
    again = ["validate", str(tmp_path / "release"), "--out", str(tmp_path / "again")]
    capsys.readouterr()
    assert run([*again, "--tests", "l", "--executor", "inline", "--json"]) == 0
    retested = json.loads(capsys.readouterr().out)["tests"]["l"]
    stored = [b.success.sum() for b in Run.open(tabletop).batches("paper-1", "l")]
    assert retested["success"] == sum(stored)


def test_a_lift_of_a_floating_object_is_refused(floating, capsys):
    assert run(["validate", str(floating), "--tests", "l", *INLINE]) == 3
    assert "floating rows" in capsys.readouterr().err


def test_a_replay_gives_the_verdict_of_the_run_and_films_it(floating, tmp_path, capsys):
    batch = next(iter(Run.open(floating).batches("paper-1", "f")))
    row = int(np.flatnonzero(batch.success)[0])
    film = tmp_path / "out.mp4"
    words = ["validate", str(floating), "--replay", str(batch.grasp_id[row])]
    assert run([*words, "--video", str(film), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["status"] == said["stored_status"] == "ok"
    with av.open(str(film)) as movie:
        frames = sum(1 for _ in movie.decode(video=0))
    assert said["frames"] == frames > 55  # the last picture stands for 25
    capsys.readouterr()
    assert run([*words, "--video", str(film)]) == 0
    told = capsys.readouterr()
    assert f"{frames} pictures in {film}" in told.out
    assert f"{frames} of {frames} pictures (100 %)" in told.err


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["--replay", "0" * 16], 3, "has no grasp"),
        (["--video", "x.mp4"], 2, "--replay"),
        (["--protocol", "paper-2"], 3, "paper-1"),
        (["--protocol", "nowhere.yaml"], 3, "nowhere.yaml"),
    ],
)
def test_what_cannot_be_done_is_one_sentence(floating, capsys, words, code, says):
    assert run(["validate", str(floating), *words]) == code
    error = capsys.readouterr().err
    assert says in error
    assert "Traceback" not in error


def test_a_replay_is_filmed_as_mp4_only(floating, tmp_path, capsys):
    batch = next(iter(Run.open(floating).batches()))
    words = ["--replay", str(batch.grasp_id[0]), "--video", str(tmp_path / "x.avi")]
    assert run(["validate", str(floating), *words]) == 3
    assert ".mp4" in capsys.readouterr().err
