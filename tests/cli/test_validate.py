"""`validate` through the command line: protocols of one's own, extra columns, replay, tables."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from bidexdata import BiDexDataset, Release, Run
from bidexdata.cli.main import run
from bidexdata.cli.report import validate_again
from bidexdata.config import to_plain
from bidexdata.errors import ConfigConflict, NotUsable, SourceChanged
from bidexdata.pictures import sheet
from bidexdata.runs import replay
from bidexdata.runs.browse import open_browsable
from bidexdata.runs.run import verdict_fingerprint
from bidexdata.runs.run_folder import PROTOCOL_FILE
from bidexdata.runs.run_rows import verdict_batch
from bidexdata.runs.shards import read_mark, shard_path, write_shard
from bidexdata.runs.validate import validate_run
from bidexdata.validation import load_protocol
from bidexdata.validation.protocols import Engine

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
    every = json.loads(capsys.readouterr().out)["protocols"]
    assert set(every) == {"paper-1", "short-1"}
    assert run(["info", str(floating), "--json", "--protocol", "short-1"]) == 0
    one = json.loads(capsys.readouterr().out)
    assert one["protocols"] == {"short-1": one["figures"]} == {"short-1": every["short-1"]}
    assert run(["info", str(floating), "--protocol", "short-1"]) == 0
    said = capsys.readouterr().out
    assert "test f of short-1: " in said
    assert "test f of paper-1: " not in said
    assert run(["info", str(floating), "--protocol", "papre-1"]) == 3
    assert "did you mean 'paper-1'?" in capsys.readouterr().err
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


@pytest.mark.parametrize(
    "words",
    [
        ["--protocol", "paper-1-mass500g", "--set", "name=paper-1"],
        ["--set", "hold=1", "--set", "name=dexgraspbench-1"],
        ["--set", "hold=1", "--set", "name=paper-1"],
    ],
)
def test_a_published_name_never_stands_for_other_settings(floating, capsys, words):
    before = sorted(floating.rglob("*.arrow"))
    assert run(["validate", str(floating), *words, *INLINE]) == 3
    assert "name" in capsys.readouterr().err
    assert sorted(floating.rglob("*.arrow")) == before


def test_validate_run_refuses_other_settings_under_a_published_name(floating):
    paper = load_protocol("paper-1")
    with pytest.raises(NotUsable, match="'paper-1' is the name of a protocol with other settings"):
        validate_run(Run.open(floating), replace(paper, hold=1.0))
    with pytest.raises(NotUsable, match="'dexgraspbench-1' is the name"):
        validate_run(Run.open(floating), replace(paper, name="dexgraspbench-1"))


@pytest.mark.parametrize("workers", [("--executor", "inline"), ("--workers", "1")])
def test_json_of_a_process_of_its_own_is_all_that_it_prints(floating, tmp_path, workers):
    """What the libraries in the process and its workers print lands nowhere."""
    folder = tmp_path / "run"
    shutil.copytree(floating, folder, ignore=shutil.ignore_patterns("validate"))
    (folder / "run.json").write_text(
        (floating / "run.json")
        .read_text()
        .replace('"../library"', f'"{floating.parent / "library"}"')
    )
    brief = ("--set", "name=brief-4", "--set", "hold=0.2", "--json", *workers)
    words = [sys.executable, "-m", "bidexdata", "validate", str(folder), *brief]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)
    assert "Warp" not in done.stderr


def test_loads_held_to_their_end_say_so_and_agree(library):
    folder = made(library, "plain")
    validate = ["validate", str(folder), "--set", "name=brief-2", "--set", "hold=0.3", *INLINE]
    assert run(validate) == 0
    opened = Run.open(folder)
    (task,) = opened.tasks
    path = shard_path(opened.stage_folder("validate", "brief-2", "f"), task.task_id)
    quick = next(iter(opened.batches("brief-2", "f"))).success
    assert not read_mark(path).notes["execution"]["plain"]
    assert run([*validate, "--plain"]) == 0
    assert read_mark(path).notes["execution"]["plain"]
    before = path.read_bytes()
    assert run(validate) == 0  # plain verdicts are not replaced by quick ones
    assert path.read_bytes() == before
    np.testing.assert_array_equal(
        next(iter(Run.open(folder).batches("brief-2", "f"))).success, quick
    )


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


def test_every_task_is_done_again_with_what_it_had_itself(tmp_path):
    library, folder = tmp_path / "library", tmp_path / "run"
    sources = ["shapes:box/1", "shapes:cylinder/1"]
    assert run(["prepare", *sources, "--out", str(library), *INLINE]) == 0
    assert run(["synth", str(library), "--out", str(folder), *SMALL]) in (0, 6)
    validate = ["validate", str(folder), "--set", "name=brief-3", "--set", "hold=0.1", *INLINE]
    assert run([*validate, "--plain", "--shard", "0/2"]) in (0, 6)
    assert run([*validate, "--analytic"]) in (0, 6)
    opened = Run.open(folder)
    place = opened.stage_folder("validate", "brief-3", "f")
    notes = [read_mark(shard_path(place, t.task_id)).notes for t in opened.tasks]
    assert sorted(n["extras"] for n in notes) == [["analytic"], ["analytic", "plain"]]
    assert [n["execution"]["plain"] for n in notes] == ["plain" in n["extras"] for n in notes]


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


LIFTS = "base: paper-1\nname: lifts-1\ndescription: the lift alone\ntests: [l]\n"


@pytest.mark.parametrize("replayed", [False, True])
def test_a_protocol_without_a_test_for_the_rows_is_one_sentence(
    floating, tmp_path, capsys, replayed
):
    (tmp_path / "lifts.yaml").write_text(LIFTS)
    batch = next(iter(Run.open(floating).batches()))
    more = ["--replay", str(batch.grasp_id[0])] if replayed else INLINE
    assert run(["validate", str(floating), "--protocol", str(tmp_path / "lifts.yaml"), *more]) == 3
    error = capsys.readouterr().err
    assert "protocol 'lifts-1' has no test for floating rows" in error
    assert error.count("\n") == 1
    assert not (floating / "validate" / "lifts-1").exists()


def test_no_rows_of_a_release_are_copied_for_a_test_that_they_do_not_allow(
    floating, tmp_path, capsys
):
    release, again = tmp_path / "release", tmp_path / "again"
    named = ("--name", "x", "--version", "1.0.0", "--quiet")
    assert run(["pack", str(floating), "--out", str(release), *named]) == 0
    for words in (["--tests", "l"], ["--protocol", str(tmp_path / "lifts.yaml")]):
        (tmp_path / "lifts.yaml").write_text(LIFTS)
        assert run(["validate", str(release), "--out", str(again), *words, *INLINE]) == 3
        assert "floating rows" in capsys.readouterr().err
        assert not again.exists()


def test_a_replay_gives_the_verdict_of_the_run_and_films_it(
    floating, tmp_path, capsys, monkeypatch
):
    # Two pictures a second, not 25: a grasp that comes to rest late is simulated for 18 s.
    monkeypatch.setattr(replay, "FPS", 2)
    batch = next(iter(Run.open(floating).batches("paper-1", "f")))
    row = int(np.flatnonzero(batch.success)[0])
    film = tmp_path / "out.mp4"
    words = ["validate", str(floating), "--replay", str(batch.grasp_id[row])]
    assert run([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["status"] == said["stored_status"] == "ok"
    assert run([*words, "--video", str(film)]) == 0
    told = capsys.readouterr()
    with av.open(str(film)) as movie:
        frames = sum(1 for _ in movie.decode(video=0))
    assert frames > 2 * said["seconds_simulated"]  # the last picture stands for a second
    assert f"{frames} pictures in {film}" in told.out
    assert f"{frames} of {frames} pictures (100 %)" in told.err


def test_a_replay_takes_the_first_digits_of_an_id_when_they_are_one_grasps(
    floating, capsys, monkeypatch
):
    monkeypatch.setattr(replay, "FPS", 2)
    ids = np.concatenate([b.grasp_id for b in Run.open(floating).batches()]).astype(str).tolist()
    shortest = next(n for n in range(1, 17) if sum(i.startswith(ids[0][:n]) for i in ids) == 1)
    words = ["validate", str(floating), "--replay"]
    assert run([*words, ids[0][:shortest].upper(), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["grasp_id"] == ids[0]
    # So few ids may all begin differently: every task twice, and so is every id.
    opened = Run.open(floating)
    monkeypatch.setitem(vars(opened), "tasks", (*opened.tasks, *opened.tasks))
    with pytest.raises(NotUsable) as caught:
        replay.replay_grasp(opened, ids[0][:shortest], load_protocol("paper-1"), "f")
    said = str(caught.value)
    assert f"2 stored grasps of {floating} begin with {ids[0][:shortest]}: " in said
    assert said.endswith("; give more")


def test_moments_of_a_replay_follow_each_other_as_they_were_simulated(floating, monkeypatch):
    """Every load begins where the one before ended, and is first seen after its first steps."""
    monkeypatch.setattr(replay, "FPS", 1e6)  # every look is kept
    paper, opened = load_protocol("paper-1"), Run.open(floating)
    batch = next(iter(opened.batches("paper-1", "f")))
    row = int(np.flatnonzero(batch.success)[0])
    moments = replay.replay_grasp(opened, str(batch.grasp_id[row]), paper, "f").moments
    times = np.array([m.time for m in moments])
    loads = [m.phase for m in moments]
    first = [k for k in range(1, len(loads)) if loads[k] != loads[k - 1]]
    assert len(first) == len(paper.directions)
    steps = np.diff(times) / paper.scene.timestep
    np.testing.assert_allclose(steps, steps.round(), atol=1e-6)
    assert times[first[0] - 1] == pytest.approx(paper.closing_time)
    # The first look of a load is that of the rule of rest, 0.02 s after it has begun.
    np.testing.assert_allclose(steps[np.array(first) - 1], 5, atol=1e-6)


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["--replay", "0" * 16], 3, "has no grasp"),
        (["--replay", "grasp"], 2, "--replay 'grasp': a grasp_id is 16 hexadecimal digits"),
        (["--video", "x.mp4"], 2, "--replay"),
        (
            ["--replay", "0" * 16, "--load-margin", "--out", "x"],
            3,
            "leave out --out, --load-margin",
        ),
        (["--replay", "0" * 16, "--analytic"], 3, "leave out --analytic"),
        (["--replay", "0" * 16, "--workers", "2", "--shard", "0/2"], 3, "--workers, --shard"),
        (["--protocol", "paper-2"], 3, "paper-1"),
        (["--protocol", "nowhere.yaml"], 3, "nowhere.yaml"),
    ],
)
def test_what_cannot_be_done_is_one_sentence(floating, capsys, words, code, says):
    assert run(["validate", str(floating), *words]) == code
    error = capsys.readouterr().err
    assert says in error
    assert "Traceback" not in error


WARP = ("--backend", "mujoco_warp", "--device", "cpu")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--backend", "bullet"], "known: mujoco, mujoco_warp"),
        (["--backend", "mujoco_warp"], "no device is called 'cuda:0' here"),
        (["--backend", "mujoco_warp", "--device", "cuda:99"], "this machine has: cpu"),
        (["--device", "cuda:0"], "--backend mujoco_warp"),
        ([*WARP, "--load-margin"], "no load margin"),
        ([*WARP, "--replay", "0" * 16], "leave out --backend"),
        ([*WARP, "--executor", "ray"], "--executor processes or inline"),
        ([*WARP, "--protocol", "dexgraspbench-1"], "'dexgraspbench-1' sets load"),
        (["--protocol", "paper-1-warp"], "--protocol paper-1 --backend mujoco_warp"),
        (["--set", "engine.device=cuda"], "engine"),
    ],
)
def test_what_another_engine_cannot_do_is_one_sentence(floating, capsys, words, says):
    pytest.importorskip("mujoco_warp", reason="needs the extra gpu")
    if "cuda:0" in says and Path("/dev/nvidia0").exists():
        pytest.skip("this machine has a GPU")
    before = sorted(floating.rglob("*.arrow"))
    assert run(["validate", str(floating), *words]) == 3
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert says in error
    assert sorted(floating.rglob("*.arrow")) == before


def test_a_missing_extra_is_named_with_the_line_that_installs_it(floating, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    assert run(["validate", str(floating), *WARP]) == 3
    assert "pip install 'bidexdata[gpu]'" in capsys.readouterr().err


@pytest.fixture(scope="module")
def judged_by_another(library: Path) -> Path:
    """A run whose only verdicts bear the mark of another engine; no GPU made them."""
    folder = made(library, "another")
    opened = Run.open(folder)
    paper = load_protocol("paper-1")
    engine = Engine(device="cuda", mujoco_warp="4.0.0", warp="1.19.0")
    other = replace(paper, name="paper-1-warp", engine=engine)
    assert run(["validate", str(folder), *INLINE]) == 0
    settings = folder / "validate" / other.name / PROTOCOL_FILE
    settings.parent.mkdir()
    settings.write_text(json.dumps(to_plain(other)))
    for task in opened.tasks:
        batch = opened.task_batch(task)
        columns = opened.task_verdicts(task, batch, "paper-1", "f")
        verdicts = verdict_batch(batch.header, batch["grasp_id"], columns)
        path = shard_path(opened.stage_folder("validate", other.name, "f"), task.task_id)
        write_shard(path, verdicts.to_arrow(), verdict_fingerprint(opened, other, "f"))
    shutil.rmtree(folder / "validate" / "paper-1")
    return folder


def test_everything_that_shows_verdicts_shows_whose_they_are(judged_by_another, tmp_path, capsys):
    folder, release = str(judged_by_another), tmp_path / "release"
    assert run(["info", folder]) == 0
    assert "test f of paper-1-warp: selected" in capsys.readouterr().out
    for place in (folder, str(release)):
        if place != folder:
            names = ("--name", "x", "--version", "1.0.0")
            assert run(["pack", folder, "--out", str(release), *names]) == 0
            assert "test f of paper-1-warp: selected" in capsys.readouterr().out
        assert run(["table", place, "--out", str(tmp_path / "t.csv"), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["protocol"] == "paper-1-warp"
        assert open_browsable(place).protocol == "paper-1-warp"  # of the viewer and of sheets
    opened = Release.open(release)
    assert opened.default_protocol == "paper-1-warp"
    assert opened.protocol_settings["paper-1-warp"]["engine"]["mujoco_warp"] == "4.0.0"
    assert "protocol `paper-1-warp`" in (release / "DATASET_CARD.md").read_text()
    assert "suc_* by paper-1-warp" in repr(BiDexDataset(release, points=16))
    assert run(["verify", str(release), "--full"]) == 0
    assert "not judged again, for paper-1-warp" in capsys.readouterr().out


def test_a_release_is_packed_for_the_protocol_asked_for(judged_by_another, tmp_path, capsys):
    folder = tmp_path / "both"
    shutil.copytree(judged_by_another, folder)
    words = ("--set", "name=brief-1", "--set", "hold=0.3")
    library = str(Run.open(judged_by_another).library.path)
    spec = json.loads((folder / "run.json").read_text())
    spec["source"] = library
    (folder / "run.json").write_text(json.dumps(spec))
    assert run(["validate", str(folder), *words, *INLINE]) == 0
    pack = ["pack", str(folder), "--name", "x", "--version", "1.0.0", "--out"]
    assert run([*pack, str(tmp_path / "a")]) == 3
    assert "say which with --protocol: brief-1, paper-1-warp" in capsys.readouterr().err
    assert run([*pack, str(tmp_path / "b"), "--protocol", "none-1"]) == 3
    assert run([*pack, str(tmp_path / "c"), "--protocol", "brief-1", "--quiet"]) == 0
    assert Release.open(tmp_path / "c").default_protocol == "brief-1"


def test_whose_verdicts_are_shown_is_one_rule_for_pictures_pages_and_tables(
    floating, tmp_path, capsys
):
    both = tmp_path / "both"
    shutil.copytree(floating, both)
    for other in [f for f in (both / "validate").iterdir() if f.name != "paper-1"]:
        shutil.rmtree(other)
    shutil.copytree(both / "validate" / "paper-1", both / "validate" / "paper-1-density25")
    picture = ["render", str(both), "--out", str(tmp_path / "a.png")]
    assert open_browsable(both).protocol == "paper-1"
    assert open_browsable(both, "paper-1-density25").protocol == "paper-1-density25"
    shutil.rmtree(both / "validate" / "paper-1")
    assert open_browsable(both).protocol == "paper-1-density25"
    shutil.copytree(both / "validate" / "paper-1-density25", both / "validate" / "mine-1")
    for words in (picture, ["view", str(both)], ["table", str(both), "--out", "t.csv"]):
        assert run(words) == 3
        assert "say which with --protocol: mine-1, paper-1-density25" in capsys.readouterr().err
        assert run([*words, "--protocol", "none-1"]) == 3
        assert "no protocol with verdicts here is called 'none-1'" in capsys.readouterr().err
    with pytest.raises(NotUsable, match="it has no verdicts of 'paper-1'"):
        open_browsable(Run.open(floating).library.path, "paper-1")


def test_a_shard_of_one_engine_is_never_read_as_the_other_s(judged_by_another, tmp_path):
    folder = tmp_path / "mixed"
    shutil.copytree(judged_by_another, folder)
    (folder / "validate" / "paper-1-warp").rename(folder / "validate" / "paper-1")
    (folder / "validate" / "paper-1" / "protocol.json").unlink()
    with pytest.raises(ConfigConflict, match="fingerprint"):
        list(Run.open(folder).batches("paper-1", "f"))


def test_a_library_that_has_changed_since_is_named(floating, library, tmp_path, capsys):
    for folder in (floating, library):
        shutil.copytree(folder, tmp_path / folder.name)
    opened = Run.open(tmp_path / floating.name)
    assert opened.library.path.samefile(tmp_path / library.name)
    words = ["prepare", "shapes:cylinder/1", "--out", str(tmp_path / library.name), *INLINE[:2]]
    assert run(words) == 0
    assert "1 object of an earlier call left the index" in capsys.readouterr().out
    with pytest.raises(SourceChanged, match="has changed since"):
        _ = Run.open(tmp_path / floating.name).library
    logs = sorted(opened.path.rglob("*.log"))
    assert run(["validate", str(opened.path), "--protocol", "paper-1-mass500g"]) == 5
    said = capsys.readouterr().err
    assert "has changed since" in said
    assert said.count("error: ") == 1
    assert sorted(opened.path.rglob("*.log")) == logs, "no task was begun"


def test_a_release_that_has_changed_since_is_named(floating, tmp_path, capsys):
    release, again = tmp_path / "release", tmp_path / "again"
    pack = ["pack", str(floating), "--out", str(release), "--name", "n", "--version"]
    assert run([*pack, "1.0.0"]) == 0
    words = ["validate", str(release), "--out", str(again), "--set", "name=mine-9", *INLINE]
    assert run(words) == 0
    shutil.rmtree(release)
    assert run([*pack, "1.0.1"]) == 0
    capsys.readouterr()
    assert run(["validate", str(again), "--set", "name=mine-8", *INLINE]) == 5
    assert f"the release {release} has changed since" in capsys.readouterr().err


def test_partly_validated_rows_name_the_command_of_their_own_engine():
    assert validate_again("run", "paper-1") == "bidexdata validate run"
    assert validate_again("run", "mine-1") == "bidexdata validate run --protocol mine-1"
    engine = "--backend mujoco_warp"
    assert validate_again("run", "paper-1-warp") == f"bidexdata validate run {engine}"
    assert validate_again("run", "m-warp") == f"bidexdata validate run --protocol m {engine}"


def test_a_replay_is_filmed_as_mp4_only(floating, tmp_path, capsys):
    batch = next(iter(Run.open(floating).batches()))
    words = ["--replay", str(batch.grasp_id[0]), "--video", str(tmp_path / "x.avi")]
    assert run(["validate", str(floating), *words]) == 3
    assert ".mp4" in capsys.readouterr().err
