"""Laws of the stage `arms`: rows and order stay, rigs lie beside each other, a stop costs nothing."""

from __future__ import annotations

import dataclasses
import json
import shutil
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from made_armed import made_run, write_rig

from bidexdata.arms.config import ArmConfig, PathConfig
from bidexdata.arms.payload import TooHeavy
from bidexdata.arms.solutions import no_solutions
from bidexdata.cli.main import run as bidexdata
from bidexdata.errors import BadConfig, ConfigConflict, Contradiction, NotUsable, UnknownName
from bidexdata.record import Status
from bidexdata.record.fields import columns_written_by
from bidexdata.runs.arms import arms_run
from bidexdata.runs.chosen import other_rigs, rig_option
from bidexdata.runs.finished import Finished
from bidexdata.runs.info import describe
from bidexdata.runs.run import Run, verdict_fingerprint
from bidexdata.runs.run_rows import verdict_batch
from bidexdata.runs.shards import shard_path, write_shard, write_text
from bidexdata.runs.spec import RunRig
from bidexdata.runs.stage import TaskExecution
from bidexdata.validation.protocols import load_protocol

INLINE = TaskExecution(executor="inline", quiet=True)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arms") / "library"
    assert bidexdata(["prepare", "shapes:box,bracket", "--out", str(folder),
                      "--executor", "inline", "--quiet"]) == 0  # fmt: skip
    return folder


@pytest.fixture
def run(library: Path, tmp_path: Path) -> Run:
    return made_run(library, tmp_path / "run")


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    return write_rig(tmp_path / "rig")


@pytest.fixture(autouse=True)
def solver(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """In place of the solver: what it gives follows from the targets alone; counts its calls."""
    calls: list[int] = []

    def solved(robot, targets, config):
        n = len(targets.hand_pos)
        calls.append(n)
        found = no_solutions(robot, config, n, Status.IK_GRASP)
        good = targets.hand_pos[:, 0, 1, 2] > np.median(targets.hand_pos[:, 0, 1, 2]) - 1e-9
        found.arm_status[good] = Status.OK
        found.arm_path[good] = targets.hand_pos[good, :, 1, :1][:, :, None]
        return found

    module = types.ModuleType("bidexdata.arms.solve")
    module.solve_scenes = lambda robot, field, scenes, targets, config, device="cpu": [
        solved(robot, one, config) for one in targets
    ]
    monkeypatch.setitem(sys.modules, "bidexdata.arms.solve", module)
    return calls


def shards(run: Run, rig: str = "made") -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in (run.path / "arms" / rig).glob("??/*.arrow")}


def test_solutions_have_the_rows_and_the_order_of_the_grasps(run: Run, rig: Path):
    report = arms_run(run, rig, execution=INLINE)
    run = Run.open(run.path)
    assert (run.rig, run.arm_rigs()) == ("made", ("made",))
    assert report.finished == len(run.tasks)
    for task in run.tasks:
        rows = run.task_batch(task)
        joined = run.task_arms(task, rows)
        assert np.array_equal(joined["grasp_id"], rows["grasp_id"])
        assert set(joined.columns) - set(rows.columns) == set(columns_written_by("arms"))
        none = joined["synth_status"] != Status.OK
        assert (joined["arm_status"][none] == Status.NO_GRASP).all()
        assert np.isnan(joined["arm_path"][none]).all()
        assert set(joined["arm_status"][~none].tolist()) == {Status.OK, Status.IK_GRASP}
        assert [a.side for a in joined.header.arms] == ["left", "right"]
    assert (
        report.by_status["no_grasp"] + report.by_status["ok"] + report.by_status["ik_grasp"]
        == report.rows
    )
    assert sum(report.by_size[300].values()) == report.rows // 2
    assert Finished.of(run).armed == run.armed() == {t.task_id for t in run.tasks}
    assert describe(run.path)["done"]["arms/made"] == len(run.tasks)


def test_a_stopped_stage_goes_on_and_gives_the_same_bytes(run: Run, rig: Path, solver):
    arms_run(run, rig, execution=INLINE)
    whole = shards(run)
    for path in list((run.path / "arms" / "made").glob("??/*.arrow"))[1:]:
        path.unlink()
    done = len(solver)
    report = arms_run(Run.open(run.path), rig, execution=INLINE)
    assert report.before == 1
    assert len(solver) - done < done
    assert shards(run) == whole
    again = arms_run(Run.open(run.path), rig, execution=INLINE)
    assert again.finished == 0


def test_parts_of_the_plan_join_to_the_whole(run: Run, rig: Path, tmp_path, library):
    arms_run(run, rig, execution=INLINE)
    other = made_run(library, tmp_path / "run2")
    for part in range(2):
        execution = dataclasses.replace(INLINE, shard=(part, 2))
        arms_run(other, rig, execution=execution)
    # The folder of the run is no part of what it is; paths of the rig differ by nothing here.
    assert shards(other) == shards(run)


def test_new_tasks_of_a_grown_run_are_simply_open(run: Run, rig: Path, library: Path):
    before = arms_run(run, rig, execution=INLINE)
    grown = made_run(library, run.path, grasps=2)
    report = arms_run(grown, rig, execution=INLINE)
    assert report.before == before.tasks
    assert report.finished == report.tasks - before.tasks > 0


def test_another_rig_or_other_settings_under_the_name_are_refused(run: Run, rig: Path, tmp_path):
    arms_run(run, rig, execution=INLINE)
    with pytest.raises(ConfigConflict, match=r"config\.path\.lift"):
        arms_run(run, rig, ArmConfig(path=PathConfig(lift=0.2)), execution=INLINE)
    moved = write_rig(tmp_path / "moved", fixtures=[])
    with pytest.raises(ConfigConflict, match=r"spec\.fixtures"):
        arms_run(run, moved, execution=INLINE)
    write_rig(rig.parent, fixtures=[])
    with pytest.raises(ConfigConflict, match=r"spec\.fixtures"):
        Run.open(run.path).robot()


def test_comments_in_the_rig_change_nothing(run: Run, rig: Path):
    arms_run(run, rig, execution=INLINE)
    rig.write_text("# a remark\n" + rig.read_text(encoding="utf-8"), encoding="utf-8")
    assert arms_run(run, rig, execution=INLINE).before == len(run.tasks)
    assert Run.open(run.path).robot().rig.spec.name == "made"


def test_rigs_lie_beside_each_other_and_one_is_meant(run: Run, rig: Path, tmp_path):
    arms_run(run, rig, execution=INLINE)
    arms_run(run, write_rig(tmp_path / "b", name="other"), execution=INLINE)
    opened = Run.open(run.path)
    assert opened.arm_rigs() == ("made", "other")
    with pytest.raises(NotUsable, match="say which with --rig: made, other"):
        _ = opened.rig
    assert Run.open(run.path, rig="other").rig == "other"
    assert Run.open(run.path, rig=rig).rig == "made"
    with pytest.raises(UnknownName, match="xarm7_leap"):
        Run.open(run.path, rig="xarm7_leap")


def test_verdicts_with_arms_are_those_of_the_rig_that_is_meant(run: Run, rig: Path, tmp_path):
    for number, path in enumerate((rig, write_rig(tmp_path / "b", name="other"))):
        arms_run(run, path, execution=INLINE)
        mine = Run.open(run.path, rig=path)
        rules = load_protocol("paper-1")
        write_text(run.path / "validate" / "paper-1" / "protocol.json",
                   json.dumps({"name": "paper-1"}))  # fmt: skip
        for task in mine.tasks:
            rows = mine.task_batch(task)
            columns = {
                "success": np.full(len(rows), bool(number)),
                "verdict_status": np.zeros(len(rows), np.int8),
            }
            shard = verdict_batch(rows.header, rows["grasp_id"], columns).to_arrow()
            folder = mine.stage_folder("validate", "paper-1", "a")
            assert folder.name == f"a-{mine.rig}"
            write_shard(
                shard_path(folder, task.task_id), shard, verdict_fingerprint(mine, rules, "a")
            )
    for name in ("made", "other"):
        mine = Run.open(run.path, rig=name)
        assert mine.verdict_tests() == [("paper-1", "a")]
        assert next(iter(mine.verdict_folders().values())).name == f"a-{name}"
    made, other = (
        verdict_fingerprint(Run.open(run.path, rig=r), rules, "a") for r in ("made", "other")
    )
    assert made != other


def test_ids_are_compared(run: Run, rig: Path):
    arms_run(run, rig, execution=INLINE)
    run = Run.open(run.path)
    first, second = run.tasks[:2]
    path = [shard_path(run.arms_folder(), t.task_id) for t in (first, second)]
    path[0].write_bytes(path[1].read_bytes())
    with pytest.raises(Contradiction, match="grasp ids"):
        run.task_arms(first, run.task_batch(first))


def test_what_cannot_be_done_is_one_sentence(run: Run, rig: Path, library, tmp_path):
    floating = made_run(library, tmp_path / "floating", setting="floating")
    with pytest.raises(NotUsable, match="arms need a table"):
        arms_run(floating, rig, execution=INLINE)
    with pytest.raises(UnknownName, match="ur10e_pots"):
        arms_run(run, "ur10e_pots", execution=INLINE)
    with pytest.raises(BadConfig, match="name of a folder"):
        arms_run(run, write_rig(tmp_path / "odd", name="../up"), execution=INLINE)
    weak = write_rig(tmp_path / "weak")
    weak.write_text(weak.read_text().replace("payload: 8.0", "payload: 0.1"), encoding="utf-8")
    with pytest.raises(TooHeavy, match=r"carries 0\.1 kg"):
        arms_run(run, weak, execution=INLINE)
    with pytest.raises(NotUsable, match="has no arm solutions"):
        run.robot()
    assert not (run.path / "arms").exists()


def test_the_command_says_what_it_did(run: Run, rig: Path, capsys):
    options = ["--rig", str(rig), "--executor", "inline"]
    assert bidexdata(["arms", str(run.path), *options, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    rows = sum(len(b) for b in run.batches())
    assert said["n"] == rows * 2 // 3
    assert said["reachable"] == said["by_status"]["ok"]
    assert set(said["by_size"]) == {"300", "400"}
    assert said["next"] == f"bidexdata validate {run.path} --tests l,a"
    assert said["now"] == {k: said[k] for k in ("n", "reachable", "by_status", "by_size")}
    assert bidexdata(["arms", str(run.path), *options]) == 0
    assert "none open" in capsys.readouterr().out
    assert bidexdata(["arms", str(run.path), *options, "--set", "path.lift=0.3"]) == 5
    assert bidexdata(["arms", str(run.path.parent)]) == 3


def test_counts_are_those_of_the_whole_run_however_often_one_asks(run: Run, rig: Path, capsys):
    command = ["arms", str(run.path), "--rig", str(rig), "--executor", "inline", "--json"]
    assert bidexdata(command) == 0
    whole = json.loads(capsys.readouterr().out)
    told = ("n", "reachable", "by_status", "by_size")
    assert bidexdata(command) == 0
    again = json.loads(capsys.readouterr().out)
    next((run.path / "arms" / "made").glob("??/*.arrow")).unlink()
    assert bidexdata(command) == 0
    resumed = json.loads(capsys.readouterr().out)
    for said in (again, resumed):
        assert {k: said[k] for k in told} == {k: whole[k] for k in told}
    assert (again["now"]["n"], resumed["tasks_before"]) == (0, len(run.tasks) - 1)
    assert 0 < resumed["now"]["n"] < whole["n"]
    arms = describe(run.path)["arms"]  # before any test
    assert arms["all"] == {k: whole[k] for k in told}
    solved = [run.for_rig("made").task_arms(t, run.task_batch(t)) for t in run.tasks]
    for kind in ("selected", "audit"):
        for mm in (300, 400):
            ok = sum(int(np.sum(b[kind] & (b["size_mm"] == mm) & (b["arm_status"] == Status.OK)))
                     for b in solved)  # fmt: skip
            assert arms[kind]["by_size"][str(mm)].get("ok", 0) == ok
    assert bidexdata(["info", str(run.path)]) == 0
    assert "have a motion (selected)" in capsys.readouterr().out


def test_a_refused_change_says_what_to_remove_and_that_works(run: Run, rig: Path, tmp_path, capsys):
    command = ["arms", str(run.path), "--rig", str(rig), "--executor", "inline", "--quiet"]
    verdicts = run.path / "validate" / "paper-1" / "a-made"
    assert bidexdata(command) == 0
    verdicts.mkdir(parents=True)
    assert bidexdata([*command, "--set", "path.lift=0.3"]) == 5
    said = capsys.readouterr().err
    folders = [run.path / "arms" / "made", verdicts]
    assert f"remove {folders[0]}, {folders[1]} to solve anew" in said
    assert "--out" not in said
    for folder in folders:
        shutil.rmtree(folder)
    assert bidexdata([*command, "--set", "path.lift=0.3"]) == 0
    other = write_rig(tmp_path / "renamed", name="renamed")  # the other way out
    assert bidexdata(["arms", str(run.path), "--rig", str(other), *command[4:]]) == 0
    assert Run.open(run.path, rig="renamed").arm_rigs() == ("made", "renamed")


def test_the_next_command_names_the_rig_that_it_would_not_take(run: Run, rig: Path, tmp_path):
    other = write_rig(tmp_path / "b", name="other")
    for path in (rig, other):
        arms_run(run, path, execution=INLINE)
    made_for = RunRig(name="made", rig="made", digest="", config={})
    known = dataclasses.replace(run, spec=dataclasses.replace(run.spec, rig=made_for))
    said = ("--rig", "other")
    cases = [(run, "made", ("--rig", "made")), (run, "other", said)]
    cases += [(known, "made", ()), (known, "", ()), (known, "other", said)]
    for opened, name, words in cases:
        assert rig_option(dataclasses.replace(opened, asked_rig=name)) == words
    assert other_rigs(run.for_rig("made")) == ("other",)
    assert describe(run.path, rig="other")["rigs"] == ["made", "other"]


def test_a_rig_that_is_not_there_is_not_offered_to_be_solved(run: Run, rig: Path):
    arms_run(run, rig, execution=INLINE)
    with pytest.raises(UnknownName) as nothing:
        run.for_rig("nosuch")
    assert "bidexdata arms" not in str(nothing.value)
    with pytest.raises(UnknownName, match=r"bidexdata arms .* --rig xarm7_leap"):
        run.for_rig("xarm7_leap")


def test_the_command_ends_with_6_where_nothing_is_reachable(
    run: Run, rig: Path, capsys, monkeypatch
):
    def none(robot, field, scenes, targets, config, device="cpu"):
        return [no_solutions(robot, config, len(t.hand_pos), Status.IK_GRASP) for t in targets]

    monkeypatch.setattr(sys.modules["bidexdata.arms.solve"], "solve_scenes", none)
    command = ["arms", str(run.path), "--rig", str(rig), "--executor", "inline", "--quiet"]
    assert [bidexdata(command) for _ in range(2)] == [6, 6]
    said = capsys.readouterr()
    assert f"can take not one grasp; `bidexdata rigs check {rig}`" in said.err
    assert bidexdata([*command[:-1], "--json"]) == 6
    assert "next" not in json.loads(capsys.readouterr().out)
