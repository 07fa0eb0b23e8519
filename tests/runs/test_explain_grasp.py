"""Laws of explaining a grasp of a run: it repeats, names are exact, other files stay as they are."""

from __future__ import annotations

import csv
import dataclasses
import json
import re
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from bidexdata.cli.main import run as command
from bidexdata.errors import BadValue, Contradiction, NotUsable
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import DIRECTIONS
from bidexdata.record.status import TestStage
from bidexdata.runs.explain import ExplainReport, explain_grasp, find_attempt, same_rows
from bidexdata.runs.run import Run
from bidexdata.runs.shards import read_mark, shard_path, write_shard
from bidexdata.synthesis.attempts import grasp_ids

OPTIONS = (
    *("--hand", "capsule", "--grasps", "2", "--candidates", "5", "--executor", "inline"),
    *("--set", "regions.anchors=60", "--set", "optimise.approach.steps=30", "--quiet"),
)


@pytest.fixture(scope="module", autouse=True)
def _small_pictures():
    """Drawing takes most of the time, and the laws here are not about it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bidexdata.runs.explain_pictures.WIDTH", 64)
        patch.setattr("bidexdata.runs.explain_pictures.HEIGHT", 48)
        yield


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("explain") / "library"
    prepare = ["prepare", "shapes:box", "--out", str(folder), "--executor", "inline", "--quiet"]
    assert command(prepare) == 0
    return folder


@pytest.fixture(scope="module")
def made(library: Path) -> Run:
    folder = library.parent / "run"
    for grasps in ((), ("--grasps", "3", "--candidates", "9")):  # the second is a round of its own
        given = list(OPTIONS)
        if grasps:
            given[2:6] = grasps
        arguments = ["synth", str(library), "--out", str(folder), "--sizes", "0.3,0.5", *given]
        assert command(arguments) == 0
    return Run.open(folder)


@pytest.fixture(scope="module")
def before(made: Run) -> dict[str, bytes]:
    """All files of the run before anything is explained."""
    return files_of(made.path)


@pytest.fixture(scope="module")
def report(library: Path, made: Run, before: dict[str, bytes]) -> ExplainReport:
    """What is said of a selected grasp of the first round."""
    return explain_grasp(library, made.path, selected_of(made, 0))


def rows(run: Run) -> list[tuple[str, int, bool]]:
    """(grasp_id, round, selected) of every stored row."""
    return [
        (str(grasp_id), task.round, bool(selected))
        for task in run.tasks
        for batch in [run.task_batch(task)]
        for grasp_id, selected in zip(batch["grasp_id"], batch["selected"], strict=True)
    ]


def selected_of(run: Run, number: int) -> str:
    return next(g for g, its_round, selected in rows(run) if its_round == number and selected)


def files_of(folder: Path) -> dict[str, bytes]:
    found = [p for p in folder.rglob("*") if p.is_file() and "explain" not in p.parts]
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in found}


def test_rows_of_every_round_repeat_and_nothing_else_changes(
    library: Path, made: Run, before: dict[str, bytes], report: ExplainReport
):
    for one in (report, explain_grasp(library, made.path, selected_of(made, 1))):
        assert one.repeat.differing == ()
        assert one.repeat.rows > 0
        assert one.stored
        assert one.as_dict()["selected"]
        folder = made.path / "explain" / one.grasp_id
        assert {p.name for p in folder.iterdir()} == {p.name for p in one.files}
        assert all(p.parent == folder and p.stat().st_size for p in one.files)
    assert files_of(made.path) == before


def test_the_same_grasp_gives_the_same_files(library: Path, made: Run, report: ExplainReport):
    first = {p.name: p.read_bytes() for p in report.files}
    again = explain_grasp(library, made.path, report.grasp_id)
    assert {p.name: p.read_bytes() for p in again.files} == first


def test_the_table_of_energies_has_a_line_per_step(report: ExplainReport):
    (path,) = (p for p in report.files if p.suffix == ".csv")
    lines = list(csv.DictReader(path.read_text().splitlines()))
    assert len(lines) == 30 + 30 + 70 + 1
    assert [int(line["step"]) for line in lines] == list(range(len(lines)))
    for line in lines:
        terms = [float(v) for k, v in line.items() if k.startswith("weighted_") and v]
        assert float(line["sum"]) == pytest.approx(sum(terms), rel=1e-6)
        assert (line["region"] == "") == (line["phase"] in ("pregrasp", "grasp"))


def test_an_attempt_that_no_row_keeps_is_explained_too(
    library: Path, made: Run, report: ExplainReport
):
    stored = {g for g, _, _ in rows(made)}
    page = report.files[-1].read_text()  # lists all attempts of the scene
    other = next(word for word in re.findall(r"\b[0-9a-f]{16}\b", page) if word not in stored)
    one = explain_grasp(library, made.path, other)
    assert not one.stored
    assert not one.as_dict()["selected"]
    assert one.repeat.differing == ()


def test_the_first_digits_do_when_they_are_one_attempts(made: Run):
    ids = [g for g, _, _ in rows(made)]
    assert find_attempt(made, ids[0][:10].upper()).grasp_id == ids[0]
    every = [
        grasp_id
        for task in made.tasks
        for one in [made.spec.rounds[task.round]]
        for scene in task.scene_ids
        for grasp_id in grasp_ids(
            made.fingerprint,
            scene,
            range(one.first_attempt, one.first_attempt + one.candidates),
        )
    ]
    assert len(every) == 18  # so that two have the same first digit of sixteen
    digit, shared = Counter(g[0] for g in every).most_common(1)[0]
    with pytest.raises(NotUsable, match=f"{shared} attempts .* begin with {digit}"):
        find_attempt(made, digit)


@pytest.mark.parametrize("wanted", ["", "xyz", "12345678901234567", "0x12", "ab cd"])
def test_what_is_no_id_is_refused(made: Run, wanted: str):
    with pytest.raises(BadValue, match="hexadecimal"):
        find_attempt(made, wanted)


def test_names_that_mean_nothing_end_in_their_exit_codes(
    library: Path, made: Run, tmp_path: Path, capsys: pytest.CaptureFixture
):
    def ends(*arguments: str | Path) -> tuple[int, str]:
        code = command(["synth", *map(str, arguments)])
        return code, capsys.readouterr().err

    other = tmp_path / "other"
    prepare = ["prepare", "shapes:cylinder", "--out", str(other), "--executor", "inline"]
    assert command([*prepare, "--quiet"]) == 0
    known = rows(made)[0][0]
    unknown = "f" * 16
    asked = ("--out", made.path, "--explain")
    for arguments, code, words in [
        ((library, *asked, unknown), 3, "has no grasp"),
        ((library, *asked, "grasp"), 2, "hexadecimal"),
        ((other, *asked, known), 5, "library.fingerprint"),
        ((library, "--out", tmp_path / "none", "--explain", known), 3, "none"),
        ((tmp_path / "none", *asked, known), 3, "none"),
    ]:
        found, said = ends(*arguments)
        assert found == code, said
        assert said.startswith("error: ")
        assert words in said
        assert len(said.splitlines()) == 1


def test_a_task_that_is_not_done_and_rows_that_were_changed_are_told(
    library: Path, made: Run, tmp_path: Path
):
    shutil.copytree(made.path, library.parent / tmp_path.name)
    run = Run.open(library.parent / tmp_path.name)
    task = run.tasks[0]
    path = shard_path(run.stage_folder("rows"), task.task_id)
    batch = run.task_batch(task)
    grasp_id = str(batch["grasp_id"][0])
    moved = batch["region_score"].copy()
    moved[0] += 1
    changed = GraspBatch(batch.header, {**batch.columns, "region_score": moved})
    assert same_rows(batch, changed) == ("region_score",)
    write_shard(path, changed.to_arrow(), run.fingerprint)
    with pytest.raises(Contradiction, match="region_score"):
        explain_grasp(library, run.path, grasp_id)
    path.unlink()
    with pytest.raises(NotUsable, match="not done yet"):
        explain_grasp(library, run.path, grasp_id)


def test_rows_that_another_version_made_are_told_and_explained(
    library: Path, made: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    there = read_mark(shard_path(made.stage_folder("rows"), made.tasks[0].task_id)).made_with
    other = {**there, "warp-lang": "0.0.1"}
    monkeypatch.setattr("bidexdata.runs.explain.made_with", lambda device: other)
    monkeypatch.setattr("bidexdata.runs.explain.same_rows", lambda stored, made: ("joints",))
    report = explain_grasp(library, made.path, rows(made)[0][0])
    assert report.as_dict()["repeats"] is False
    assert report.repeat.elsewhere == (f"warp-lang {there['warp-lang']} -> 0.0.1",)
    assert "not repeated" in report.files[-1].read_text()


def test_the_command_says_a_line_per_stage(
    library: Path, made: Run, report: ExplainReport, capsys: pytest.CaptureFixture
):
    asked = ["synth", str(library), "--out", str(made.path), "--explain", report.grasp_id]
    assert command(asked) == 0
    said = capsys.readouterr().out.splitlines()
    assert "bit for bit" in said[1]
    stages = [s.stage for s in report.said]
    assert [line.split()[0] for line in said[2 : 2 + len(stages)]] == stages
    assert (stages[0], stages[-2:]) == ("regions", ["selection", "audit"])
    told = json.loads(json.dumps(report.as_dict()))
    assert [s["stage"] for s in told["stages"]] == stages
    assert told["status"] == Status.OK.label


def test_the_verdicts_of_the_run_are_told(
    library: Path, made: Run, report: ExplainReport, capsys: pytest.CaptureFixture
):
    assert report.verdicts == ()
    folder = library.parent / "tested"
    shutil.copytree(made.path, folder)
    heavy = ["--set", "name=heavy", "--set", "gravity=1000.0", "--executor", "inline"]
    assert command(["validate", str(folder), *heavy, "--quiet"]) == 6  # not one holds
    grasp_id = report.grasp_id
    capsys.readouterr()
    asked = ["synth", str(library), "--out", str(folder), "--explain", grasp_id]
    assert command(asked) == 0
    said = capsys.readouterr().out
    assert command([*asked, "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["verdicts"]
    of_task = (b.select(b["grasp_id"] == grasp_id) for b in Run.open(folder).batches("heavy", "f"))
    (row,) = (b for b in of_task if len(b))
    status, direction = Status(int(row["verdict_status"][0])), int(row["direction"][0])
    assert status is not Status.OK
    assert direction >= 0
    assert (told["protocol"], told["test"], told["status"]) == ("heavy", "f", status.label)
    assert told["failed_stage"] == TestStage(int(row["failed_stage"][0])).label
    assert told["direction"] == DIRECTIONS[direction]
    assert f"({told['failed_stage']} in load {told['direction']}, after" in told["text"]
    assert f"{status.label}: {status.sentence}" in told["text"]
    (line,) = (x for x in said.splitlines() if x.startswith("verdict"))
    assert line.endswith(told["text"])
    page = (folder / "explain" / grasp_id / "explain.md").read_text()
    assert f"- {told['text']}" in page


def test_no_attempt_is_repeated_wrongly(made: Run):
    batch = made.task_batch(made.tasks[0])
    assert same_rows(batch, batch) == ()
    fewer = batch.select(np.arange(len(batch)) > 0)
    assert "grasp_id" in same_rows(batch, fewer)
    without = dataclasses.replace(
        batch, columns={k: v for k, v in batch.columns.items() if k != "joints"}
    )
    assert same_rows(batch, without) == ("joints",)
