"""A real tiny run through the command line: workers, kills, growth, damage and other settings.

Three built-in shapes at one size with the built-in hand, few attempts and few optimiser steps: one
task is a few seconds.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bidexdata import BiDexDataset, Release, Run
from bidexdata.cli.main import COMMANDS, run
from bidexdata.record.fields import columns_written_by
from bidexdata.runs.browse import open_browsable
from bidexdata.runs.finished import Finished
from bidexdata.runs.library_report import TIMES
from bidexdata.runs.made_with import package_versions
from bidexdata.runs.pack_rows import rows_of_object
from bidexdata.runs.run_rows import join_tasks
from bidexdata.runs.shards import done_tasks, read_shard, write_shard

ROOT = Path(__file__).resolve().parents[2]
ENV = {**os.environ, "PYTHONPATH": str(ROOT)}
OPTIONS = (
    *("--hand", "capsule", "--sizes", "0.3", "--grasps", "2", "--candidates", "4"),
    *("--set", "regions.anchors=60", "--set", "optimise.approach.steps=40"),
)
TASKS = 3
PATIENCE = 600
"""How long a process may take to begin or to end on a machine that does much else [s]."""


def files_of(folder: Path) -> dict[str, bytes]:
    """All shards, plan and header of a run: what must not depend on how it was made."""
    kept = [p for p in folder.rglob("*") if p.is_file() and not {"logs", TIMES} & {*p.parts}]
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in kept}


def start(*arguments: str | Path) -> subprocess.Popen:
    command = [sys.executable, "-m", "bidexdata", *map(str, arguments)]
    return subprocess.Popen(command, env=ENV, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)


def kill_after_first_shard(stage_folder: Path, *arguments: str | Path) -> None:
    """Start a command with one worker and end it with SIGKILL when the first shard is there."""
    process = start(*arguments, "--workers", "1")
    end = time.monotonic() + PATIENCE
    while not done_tasks(stage_folder) and time.monotonic() < end and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert 1 <= len(done_tasks(stage_folder)) < TASKS, "the kill came too late or too early"


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pipeline") / "library"
    sources = "shapes:box,cylinder,sphere"
    assert run(["prepare", sources, "--out", str(folder), "--executor", "inline", "--quiet"]) == 0
    return folder


@pytest.fixture(scope="module")
def whole(library: Path) -> Path:
    """A run that nothing disturbed, made and validated with two workers."""
    folder = library.parent / "whole"
    options = [*OPTIONS, "--workers", "2", "--quiet"]
    assert run(["synth", str(library), "--out", str(folder), *options]) == 0
    assert run(["validate", str(folder), "--workers", "2", "--quiet"]) == 0
    return folder


@pytest.fixture(scope="module")
def release(whole: Path) -> Path:
    folder = whole.parent / "release"
    names = ["--name", "tiny", "--version", "1.0.0"]
    assert run(["pack", str(whole), "--out", str(folder), *names, "--quiet"]) == 0
    return folder


def test_a_library_made_in_parts_is_the_one_made_at_once(
    library: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    folder = tmp_path / "library"
    prepare = [
        "prepare",
        "shapes:box,cylinder,sphere",
        "--out",
        str(folder),
        "--executor",
        "inline",
    ]
    capsys.readouterr()
    assert run([*prepare, "--shard", "1/2", "--json", "--quiet"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["inputs"], data["prepared"], data["waiting"]) == (1, 1, 2)
    assert "next" not in data
    assert run([*prepare, "--shard", "1/2"]) == 0
    assert "part 1/2: 2 inputs of other parts not done yet" in capsys.readouterr().out
    assert run(["info", str(folder)]) == 3
    assert "unfinished" in capsys.readouterr().err
    assert run([*prepare, "--shard", "0/2", "--json", "--quiet"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["inputs"], data["prepared"], data["waiting"]) == (3, 3, 0)
    assert data["next"].startswith("bidexdata synth")
    assert files_of(folder) == files_of(library)


def test_the_seed_of_prepare_is_that_of_the_surface_points(library: Path, tmp_path: Path, capsys):
    prepare = ["prepare", "shapes:box", "--executor", "inline", "--quiet", "--out"]
    assert run([*prepare, str(tmp_path / "a"), "--seed", "3"]) == 0
    assert run([*prepare, str(tmp_path / "b"), "--set", "surface.seed=3"]) == 0
    assert files_of(tmp_path / "a") == files_of(tmp_path / "b")
    assert run([*prepare, str(tmp_path / "a"), "--seed", "4"]) == 5
    assert "surface.seed: 3 -> 4" in capsys.readouterr().err


def test_a_run_holds_what_was_asked_for(whole: Path):
    made = Run.open(whole)
    assert len(made.tasks) == TASKS
    assert made.verdict_tests() == [("paper-1", "f")]
    for batch in made.batches("paper-1", "f"):
        assert set(columns_written_by("synth")) <= set(batch.columns)
        assert set(columns_written_by("validate")) <= set(batch.columns)
        assert int(batch["audit"].sum()) == 2
        assert int(batch["selected"].sum()) <= 2
        assert np.all(batch["selected"] | batch["audit"])
        assert {sum(c.values()) for c in batch.header.counts.values()} == {4}
        assert batch.header.fingerprints["run"] == made.fingerprint


@pytest.mark.parametrize("executor", ["inline", "processes"])
def test_one_worker_and_two_give_the_same_bytes(whole: Path, library: Path, executor: str):
    folder = library.parent / f"one-{executor}"
    options = [*OPTIONS, "--workers", "1", "--executor", executor, "--quiet"]
    assert run(["synth", str(library), "--out", str(folder), *options]) == 0
    made, wanted = files_of(folder), files_of(whole)
    assert made == {k: v for k, v in wanted.items() if not k.startswith("validate")}


def test_parts_of_several_machines_give_the_same_bytes(whole: Path, library: Path):
    folder = library.parent / "parts"
    for part in ("1/2", "0/2"):
        options = [*OPTIONS, "--executor", "inline", "--shard", part, "--quiet"]
        assert run(["synth", str(library), "--out", str(folder), *options]) == 0
    assert run(["validate", str(folder), "--executor", "inline", "--quiet"]) == 0
    assert files_of(folder) == files_of(whole)


def test_verdicts_of_several_machines_are_the_same_bytes(whole: Path):
    folder = whole.parent / "judged-in-parts"
    shutil.copytree(whole, folder)
    shutil.rmtree(folder / "validate")
    tasks = [task.task_id for task in Run.open(folder).tasks]
    validate = ["validate", str(folder), "--executor", "inline", "--quiet"]
    for shard, done in ((["--shard", "1/2"], tasks[1::2]), ([], tasks)):
        assert run([*validate, *shard]) == 0
        assert done_tasks(folder / "validate" / "paper-1" / "f") == set(done)
    assert files_of(folder) == files_of(whole)


def test_killed_synth_and_validate_resume_to_the_bytes_of_an_undisturbed_run(
    whole: Path, library: Path
):
    folder = library.parent / "killed"
    here = ("--executor", "inline", "--quiet")  # who goes on is another process all the same
    synth = ("synth", str(library), "--out", str(folder), *OPTIONS)
    kill_after_first_shard(folder / "synth", *synth)
    assert run([*synth, *here]) == 0
    validate = ("validate", str(folder))
    kill_after_first_shard(folder / "validate" / "paper-1" / "f", *validate)
    assert run([*validate, *here]) == 0
    assert files_of(folder) == files_of(whole)


def test_ctrl_c_ends_the_workers_and_leaves_a_run_to_go_on_with(library: Path):
    folder = library.parent / "interrupted"
    process = start("synth", library, "--out", folder, *OPTIONS, "--workers", "1")
    end = time.monotonic() + PATIENCE
    while not (folder / "run.json").exists() and time.monotonic() < end:
        time.sleep(0.01)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE) == 130
    assert len(Run.open(folder).tasks) == TASKS
    assert not list(folder.rglob("*.tmp"))


def test_grasps_may_grow_and_old_shards_stay(whole: Path, library: Path, capsys):
    folder = library.parent / "grown"
    subprocess.run(["cp", "-r", whole, folder], check=True)
    before = files_of(folder)
    options = [*OPTIONS, "--executor", "inline", "--quiet"]
    options[options.index("--grasps") + 1] = "3"
    options[options.index("--candidates") + 1] = "7"
    assert run(["synth", str(library), "--out", str(folder), *options]) == 0
    after = files_of(folder)
    shards = {k: v for k, v in before.items() if k.endswith(".arrow")}
    assert {k: after[k] for k in shards} == shards
    grown = Run.open(folder)
    assert len(grown.tasks) == 2 * TASKS
    assert (grown.spec.grasps, grown.spec.candidates) == (3, 7)
    assert grown.fingerprint == Run.open(whole).fingerprint
    for object_id in grown.object_ids:
        batch = join_tasks([grown.task_batch(t) for t in grown.tasks_of(object_id)])
        assert int(batch["audit"].sum()) == 3
        assert len(set(batch["grasp_id"].tolist())) == len(batch)
        assert len(set(batch["attempt"].tolist())) == len(batch)
        assert batch["attempt"].max() < 7
        assert {sum(c.values()) for c in batch.header.counts.values()} == {7}
    capsys.readouterr()
    assert run(["info", str(folder)]) == 0
    tested, rows = (sum(len(b) for b in grown.batches(*p)) for p in (("paper-1", "f"), ()))
    assert 0 < tested < rows
    said = capsys.readouterr().out
    assert f"partly validated: {tested} of {rows} rows; run bidexdata validate {folder}" in said
    assert "not validated yet" not in said
    assert "attempts (before any test): " in said


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (["--seed", "1"], "seed: 0 -> 1"),
        (["--sizes", "0.3,0.5"], "sizes_mm"),
        (["--grasps", "1"], "grasps: 2 -> 1"),
        (["--set", "optimise.approach.steps=41"], "config.optimise.approach.steps: 40 -> 41"),
        (["--preset", "paper"], "preset: 'default' -> 'paper'"),
    ],
)
def test_another_configuration_gives_5_and_names_the_keys(
    whole: Path,
    library: Path,
    change: list[str],
    named: str,
    capsys: pytest.CaptureFixture,
):
    before = files_of(whole)
    options = list(OPTIONS)
    if change[0] in options and change[0] != "--set":
        at = options.index(change[0])
        del options[at : at + 2]
    assert run(["synth", str(library), "--out", str(whole), *options, *change]) == 5
    err = capsys.readouterr().err
    assert named in err
    assert len(err.strip().splitlines()) == 1
    assert files_of(whole) == before


def test_an_unknown_hand_gives_3_and_lists_the_known(
    library: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    out = tmp_path / "run"
    assert run(["synth", str(library), "--out", str(out), "--hand", "shadwo"]) == 3
    err = capsys.readouterr().err
    assert "shadow" in err
    assert "capsule" in err
    assert not out.exists()


def test_a_file_that_is_no_hand_gives_3_and_is_named(library: Path, tmp_path: Path, capsys):
    (tmp_path / "list.yaml").write_text("- 1")
    out = tmp_path / "run"
    hand = str(tmp_path / "list.yaml")
    assert run(["synth", str(library), "--out", str(out), "--hand", hand]) == 3
    assert "list.yaml" in capsys.readouterr().err
    assert not out.exists()


def test_a_test_that_the_setting_does_not_allow_gives_3(whole: Path, capsys):
    assert run(["validate", str(whole), "--tests", "a"]) == 3
    assert "'a'" in capsys.readouterr().err


def test_info_and_verify_count_the_same_rows_in_the_same_words(
    release: Path, capsys: pytest.CaptureFixture
):
    said = []
    for name in ("info", "verify"):
        assert run([name, str(release)]) == 0
        said += re.findall(r"\d+ rows? stored \([^)]*\)", capsys.readouterr().out)
    ids = {
        i
        for c in ("selected", "audit")
        for i in Release.open(release).grasps(configuration=c).grasp_id
    }
    assert len(said) == 2
    assert said[0] == said[1]
    assert said[0].startswith(f"{len(ids)} row")


def test_the_last_line_is_the_next_command_of_the_readme(
    library: Path, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    def following(*words: str | Path) -> str:
        assert run([*map(str, words), "--json", "--quiet"]) == 0
        return json.loads(capsys.readouterr().out)["next"]

    pictures, out = ("--out", tmp_path / "a.png", "--count", "1"), tmp_path / "release"
    assert following("render", library, *pictures) == f"bidexdata synth {library} --out RUN"
    assert following("render", whole, *pictures) == f"bidexdata view {whole}"
    packed = following("pack", whole, "--out", out, "--name", "x", "--version", "1.0.0")
    assert packed == f"bidexdata verify {out}"
    assert following("verify", out) == f"bidexdata view {out}"


def test_the_seconds_of_synth_are_those_of_the_whole_command(
    whole: Path, library: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(
        "bidexdata.runs.synth.check_device", lambda _device: time.sleep(0.3)
    )  # before any task
    synth = ["synth", str(library), "--out", str(whole), *OPTIONS, "--json", "--quiet"]
    start = time.perf_counter()
    assert run(synth) == 0
    taken = time.perf_counter() - start
    assert 0.3 <= json.loads(capsys.readouterr().out)["seconds"] <= taken


def test_a_shard_made_on_another_device_is_told_apart_by_info(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
):
    folder = tmp_path / "mixed"
    subprocess.run(["cp", "-r", whole, folder], check=True)
    first, *others = sorted((folder / "synth").rglob("*.arrow"))
    gpu = {"device": "cuda", "device_name": "a GPU", **package_versions()}
    monkeypatch.setattr("bidexdata.runs.shards.made_with", lambda _device: gpu)
    write_shard(first, read_shard(first), Run.open(folder).fingerprint, device="cuda:1")
    capsys.readouterr()
    assert run(["info", str(folder), "--json"]) == 0
    made = json.loads(capsys.readouterr().out)["made_with"]
    assert [(k["tasks"], k["device"]) for k in made["synth"]] == [(TASKS - 1, "cpu"), (1, "cuda")]
    assert [(k["tasks"], k["device"]) for k in made["validate/paper-1/f"]] == [(TASKS, "cpu")]
    assert all(k["mujoco"] == package_versions()["mujoco"] for k in made["synth"])
    assert run(["info", str(folder)]) == 0
    said = capsys.readouterr().out
    assert f"  {len(others)} tasks on cpu (" in said
    assert "  1 task on cuda (a GPU) with bidexdata" in said


@pytest.mark.parametrize("command", ["info", "pack"])
def test_a_command_lists_every_stage_once_whatever_the_number_of_objects(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
):
    listed = []

    def count(folder: Path) -> set[str]:
        listed.append(folder.relative_to(whole).as_posix())
        return done_tasks(folder)

    for module in ("run", "finished"):
        monkeypatch.setattr(f"bidexdata.runs.{module}.done_tasks", count)
    arguments = {
        "info": ["info", str(whole)],
        "pack": ["pack", str(whole), "--out", str(tmp_path / "r"), "--name", "n", "--version"],
    }[command]
    assert run([*arguments, *["1.0.0"] * (command == "pack"), "--quiet"]) == 0
    assert sorted(listed) == ["synth", "validate/paper-1/f"]


def test_a_command_sees_a_growing_run_as_it_was_and_a_reader_as_it_is(whole: Path, tmp_path: Path):
    folder = tmp_path / "growing"
    subprocess.run(["cp", "-r", whole, folder], check=True)
    late = sorted((folder / "synth").rglob("*.arrow"))[-1]
    late.rename(folder / "kept")
    made, source = Run.open(folder), open_browsable(folder)
    (object_id,) = (t.object_id for t in made.tasks if t.task_id == late.stem)
    before = Finished.of(made)
    assert source.grasps(object_id) is None
    (folder / "kept").rename(late)
    after = Finished.of(made)
    assert (len(before.rows), len(after.rows)) == (TASKS - 1, TASKS)
    tests = list(after.tests)
    assert rows_of_object(made, before, object_id, "", tests) is None
    rows = rows_of_object(made, after, object_id, "", tests)
    assert rows is not None
    assert set(rows.verdicts) == {("paper-1", "f")}
    seen = source.grasps(object_id)
    assert seen is not None
    assert len(seen) == len(rows.batch)
    assert before.tested(tests) == before.rows


def test_the_same_release_comes_out_of_an_equal_run(whole: Path, release: Path, tmp_path: Path):
    again = tmp_path / "release"
    names = ["--name", "tiny", "--version", "1.0.0"]
    assert run(["pack", str(whole), "--out", str(again), *names, "--quiet"]) == 0
    assert files_of(again) == files_of(release)


def test_a_release_passes_verify_and_loads_as_tensors(release: Path):
    assert run(["verify", str(release), "--quiet"]) == 0
    rows = sum(len(BiDexDataset(release, split=s)) for s in ("train", "test"))
    made = Run.open(release.parent / "whole")
    assert rows == sum(int(b["selected"].sum()) for b in made.batches())


def test_pack_says_how_many_rows_are_not_tested(whole: Path, tmp_path: Path, capsys):
    folder = whole.parent / "half"
    subprocess.run(["cp", "-r", whole, folder], check=True)
    names = ["--name", "tiny", "--version", "1.0.0", "--quiet"]
    shards = sorted((folder / "validate" / "paper-1" / "f").rglob("*.arrow"))
    total = sum(len(batch) for batch in Run.open(folder).batches())
    for number, doomed in enumerate((shards[:1], shards[1:])):
        for shard in doomed:
            shard.unlink()
        tested = sum(len(batch) for batch in Run.open(folder).batches("paper-1", "f"))
        capsys.readouterr()
        assert run(["pack", str(folder), "--out", str(tmp_path / str(number)), *names]) == 0
        assert (
            f"run half: {total - tested} of {total} rows not tested; "
            f"`bidexdata validate {folder}` tests them\n"
        ) in capsys.readouterr().err
    for packed, following in ((folder, f"validate {folder}"), (whole, f"verify {tmp_path / 'r'}")):
        shutil.rmtree(tmp_path / "r", ignore_errors=True)
        assert run(["pack", str(packed), "--out", str(tmp_path / "r"), *names[:-1]]) == 0
        assert capsys.readouterr().out.endswith(f"\nnext: bidexdata {following}\n")


def test_one_flipped_byte_gives_4_and_names_the_file(
    release: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    damaged = tmp_path / "damaged"
    subprocess.run(["cp", "-r", release, damaged], check=True)
    victim = sorted((damaged / "grasps").glob("*.parquet"))[0]
    data = bytearray(victim.read_bytes())
    data[len(data) // 2] ^= 1
    victim.write_bytes(data)
    assert run(["verify", str(damaged)]) == 4
    assert victim.name in capsys.readouterr().err


def test_a_damaged_shard_gives_4_and_a_deleted_one_is_made_again(
    whole: Path, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    folder = library.parent / "damaged"
    subprocess.run(["cp", "-r", whole, folder], check=True)
    before = files_of(folder)
    victim = next((folder / "synth").rglob("*.arrow"))
    victim.write_bytes(victim.read_bytes()[:-100])
    assert run(["info", str(folder)]) == 4
    assert victim.name in capsys.readouterr().err
    victim.unlink()
    options = [*OPTIONS, "--executor", "inline", "--quiet"]
    assert run(["synth", str(library), "--out", str(folder), *options]) == 0
    assert files_of(folder) == before


@pytest.mark.parametrize("command", ["validate", "info"])
def test_verdicts_under_another_mark_give_5_and_name_the_shard(
    whole: Path, capsys: pytest.CaptureFixture, command: str
):
    folder = whole.parent / f"foreign-{command}"
    subprocess.run(["cp", "-r", whole, folder], check=True)
    victim = sorted((folder / "validate").rglob("*.arrow"))[-1]
    write_shard(victim, read_shard(victim), "f" * 16)
    assert run([command, str(folder)]) == 5
    err = capsys.readouterr().err
    assert victim.name in err
    assert len(err.strip().splitlines()) == 1


def test_a_release_is_tested_again_into_a_run_of_its_own(
    whole: Path, release: Path, tmp_path: Path
):
    before = files_of(release)
    out = release.parent / "retest"
    assert run(["validate", str(release)]) == 3
    arguments = ["validate", str(release), "--out", str(out), "--executor", "inline", "--quiet"]
    assert run(arguments) == 0
    assert files_of(release) == before
    verdicts = [
        {
            str(i): bool(s)
            for b in Run.open(path).batches("paper-1", "f")
            for i, s in zip(b["grasp_id"], b["success"], strict=True)
        }
        for path in (whole, out)
    ]
    assert verdicts[0] == verdicts[1]


@pytest.mark.parametrize("kind", ["library", "whole", "release"])
def test_info_says_what_it_is_and_json_has_the_documented_keys(
    kind: str, request: pytest.FixtureRequest, capsys: pytest.CaptureFixture
):
    path = request.getfixturevalue(kind)
    capsys.readouterr()
    assert run(["info", str(path)]) == 0
    said = capsys.readouterr().out
    assert ("run" if kind == "whole" else kind) in said
    legend = [line for line in said.splitlines() if line.startswith("kept = ")]
    assert len(legend) == (kind != "library")
    for word in ("kept", "selected", "unselected", "PD", "SPD", "CDC"):
        assert kind == "library" or re.search(rf"\b{word}\b.* = ", legend[0])
    assert run(["info", str(path), "--json"]) == 0
    out = capsys.readouterr().out
    assert "kept = " not in out
    data = json.loads(out)
    documented = set(re.findall(r"\w+", COMMANDS["info"].__doc__ or ""))
    assert set(data) <= documented
    if kind != "library":
        assert data["figures"]["n"] > 0
        assert data["figures"]["tests"]["f"]["unselected"]["n"] == 2 * TASKS


@pytest.mark.parametrize("by", ["object", "size", "hand", "status"])
def test_a_run_and_its_release_have_the_same_groups(
    by: str, whole: Path, release: Path, library: Path, capsys: pytest.CaptureFixture
):
    capsys.readouterr()
    found = []
    for path in (whole, release):
        assert run(["info", str(path), "--by", by, "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out)["groups"])
    assert found[0] == found[1]
    assert run(["info", str(whole), "--json"]) == 0
    tested = json.loads(capsys.readouterr().out)["figures"]["tested_rows"]
    wanted = tested if by == "status" else 2 * TASKS  # causes of failure are of audit rows too
    assert sum(group["rows"] for group in found[0]["paper-1"]["f"].values()) == wanted
    assert run(["info", str(library), "--by", by]) == 3
    assert "is a library" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["prepare", "synth", "validate"])
def test_a_finished_command_repeats_at_once_and_its_json_has_the_documented_keys(
    name: str, whole: Path, library: Path, capsys: pytest.CaptureFixture
):
    arguments = {
        "prepare": ["prepare", "shapes:box,cylinder,sphere", "--out", str(library)],
        "synth": ["synth", str(library), "--out", str(whole), *OPTIONS],
        "validate": ["validate", str(whole)],
    }[name]
    before = files_of(whole)
    capsys.readouterr()
    assert run([*arguments, "--json", "--quiet"]) == 0
    out, err = capsys.readouterr()
    data = json.loads(out)
    assert err == ""
    assert data["next"].startswith("bidexdata ")
    assert set(data) <= set(re.findall(r"\w+", COMMANDS[name].__doc__ or "")) | {"next"}
    assert files_of(whole) == before


def test_nothing_made_gives_6_every_time_one_asks(library: Path, tmp_path: Path):
    # Hands that must keep a metre apart find no start.
    options = ["--hand", "capsule", "--sizes", "0.3", "--grasps", "1", "--executor", "inline"]
    synth = ["synth", str(library), "--out", str(tmp_path / "run"), *options, "--quiet"]
    synth += ["--set", "placement.clearance=1.0", "--set", "placement.draws=1"]
    assert [run(synth), run(synth)] == [6, 6]
    validate = ["validate", str(tmp_path / "run"), "--executor", "inline", "--quiet"]
    assert [run(validate), run(validate)] == [6, 6]
