"""Test a on a run: which tasks it takes, where verdicts lie, and that they can be had again."""

from __future__ import annotations

import json
import sys
import types

import numpy as np
import pytest
from made_armed import made_run, write_rig

from bidexdata.cli.main import run as bidexdata
from bidexdata.config import to_plain
from bidexdata.errors import ConfigConflict, NotUsable
from bidexdata.record import Status
from bidexdata.record.status import ARM_STATUSES, TestStage
from bidexdata.runs.arms import arms_run
from bidexdata.runs.info import describe
from bidexdata.runs.replay import replay_grasp
from bidexdata.runs.run import Run
from bidexdata.runs.shards import shard_path, write_text
from bidexdata.runs.stage import TaskExecution
from bidexdata.runs.validate import allowed_tests, validate_run
from bidexdata.validation.protocols import load_protocol, without_arms

INLINE = TaskExecution(executor="inline", quiet=True)
PAPER = load_protocol("paper-1")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of one object whose first task alone has motions, all its tests done."""
    from motions import solve_scenes

    folder = tmp_path_factory.mktemp("armed")
    library = folder / "library"
    assert bidexdata(["prepare", "shapes:box", "--out", str(library),
                      "--executor", "inline", "--quiet"]) == 0  # fmt: skip
    run = made_run(library, folder / "run", sizes=(300,))
    module = types.ModuleType("bidexdata.arms.solve")
    module.solve_scenes = solve_scenes
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "bidexdata.arms.solve", module)
        validate_run(run, without_arms(PAPER), execution=INLINE)  # before there are arms
        arms_run(run, write_rig(folder / "rig"), execution=INLINE)
    run = Run.open(run.path)
    validate_run(run, PAPER, execution=INLINE)
    return Run.open(run.path)


def rows(run: Run):
    for task in run.tasks:
        batch = run.task_arms(task, run.task_batch(task))
        yield task, batch, run.task_verdicts(task, batch, "paper-1", "a")


def test_verdicts_with_arms_lie_beside_the_others_under_the_name_of_the_rig(run: Run):
    assert run.verdict_tests() == [("paper-1", "f"), ("paper-1", "l"), ("paper-1", "a")]
    folders = sorted(p.name for p in (run.path / "validate" / "paper-1").iterdir() if p.is_dir())
    assert folders == ["a-made", "f", "l"]
    again = validate_run(run, PAPER, execution=INLINE)
    assert {test: report.before for test, report in again.items()} == dict.fromkeys(
        "fla", len(run.tasks)
    )


def test_a_row_fails_with_the_status_of_its_arms_or_is_simulated(run: Run):
    seen = set()
    for _, batch, found in rows(run):
        for k in range(len(batch)):
            status, armed = Status(int(found["verdict_status"][k])), int(batch["arm_status"][k])
            if batch["synth_status"][k] != Status.OK:
                assert status is Status.NOT_RUN
            elif armed != Status.OK:
                assert (status, found["failed_stage"][k]) == (Status(armed), TestStage.NONE)
                assert status in ARM_STATUSES
            else:
                assert np.isfinite(found["drift_pos"][k]) or not found["success"][k]
                seen.add(status)
    assert seen


def test_the_settings_that_are_stored_gain_how_arms_are_driven(run: Run):
    stored = json.loads((run.path / "validate" / "paper-1" / "protocol.json").read_text())
    assert stored == json.loads(json.dumps(to_plain(PAPER)))
    # Verdicts from before then are still read: their mark is the same.
    for task in run.tasks:
        run.task_verdicts(task, run.task_batch(task), "paper-1", "l")


def test_settings_from_before_there_were_arms_are_added_to_and_others_refused(run: Run, tmp_path):
    copy = made_run(run.library.path, tmp_path / "old", sizes=(300,))
    path = copy.path / "validate" / "paper-1" / "protocol.json"
    write_text(path, json.dumps(to_plain(without_arms(PAPER))))
    validate_run(copy, PAPER, ("f",), execution=INLINE)
    assert "arm" in json.loads(path.read_text())
    stiff = to_plain(PAPER)
    stiff["arm"]["arm_gain"] = 4.0
    write_text(path, json.dumps(stiff))
    with pytest.raises(ConfigConflict, match=r"arm\.arm_gain: 4\.0 -> 1\.0"):
        validate_run(copy, PAPER, ("f",), execution=INLINE)


def test_a_replay_gives_the_stored_verdict_and_shows_arms_when_asked(run: Run, tmp_path, capsys):
    _, batch, found = next(rows(run))
    simulated = np.flatnonzero(np.isfinite(found["drift_pos"]) & (batch["arm_status"] == Status.OK))
    for row in simulated[:2]:
        report = replay_grasp(run, batch["grasp_id"][row], PAPER, "a", quiet=True)
        assert report.stored == report.verdict.status.label
        assert np.float32(report.verdict.drift_pos) == found["drift_pos"][row]
        assert report.moments[0].phase == "approach"
        shape = (2, max(len(arm.joint_names) for arm in batch.header.arms))
        assert {moment.pose.arm_joints.shape for moment in report.moments} == {shape}
    grasp = str(batch["grasp_id"][simulated[0]])
    for tests, test in (([], "l"), (["--tests", "a"], "a")):
        said = ["validate", str(run.path), "--replay", grasp, *tests, "--json", "--quiet"]
        assert bidexdata(said) == 0
        assert json.loads(capsys.readouterr().out)["test"] == test


@pytest.mark.slow
def test_a_replay_with_arms_is_filmed(run: Run, tmp_path, monkeypatch, capsys):
    import av

    from bidexdata.runs import replay

    monkeypatch.setattr(replay, "ARM_FPS", 1.0)  # few pictures: drawing is what takes time
    _, batch, found = next(rows(run))
    moved = np.flatnonzero(np.isfinite(found["drift_pos"]) & (batch["arm_status"] == Status.OK))
    said = ["validate", str(run.path), "--replay", str(batch["grasp_id"][moved[0]])]
    film = tmp_path / "a.mp4"
    assert bidexdata([*said, "--tests", "a", "--video", str(film), "--json", "--quiet"]) == 0
    told = json.loads(capsys.readouterr().out)
    with av.open(str(film)) as movie:
        frames = [f.to_ndarray(format="rgb24") for f in movie.decode(video=0)]
    assert len(frames) == told["frames"] >= told["seconds_simulated"]
    assert np.abs(frames[0].astype(int) - frames[-2]).max() > 50  # the arms have moved


@pytest.mark.slow
def test_motions_are_filmed_and_what_stopped_the_others_is_drawn(run: Run, tmp_path, monkeypatch):
    from PIL import Image

    from bidexdata.runs import arm_pictures
    from bidexdata.runs.render import render

    small = arm_pictures.Size(64, 48)
    monkeypatch.setattr(arm_pictures, "SIZE", small)
    monkeypatch.setattr(arm_pictures, "FILM_SIZE", small)
    monkeypatch.setattr(arm_pictures, "film_times", lambda rows, seconds: [0.0, 1e9])
    status = {str(i): Status(int(s)) for _, b, _ in rows(run)
              for i, s in zip(b["grasp_id"], b["arm_status"], strict=True)}  # fmt: skip
    made = render(run.path, tmp_path / "a.gif", video=True, count=1, quiet=True)
    assert [status[name] for name in made.shown] == [Status.OK]
    with Image.open(made.out) as movie:
        assert movie.n_frames == 2
    alone = render(run.path, tmp_path / "b.gif", video=True, arms=False, count=1, quiet=True)
    with Image.open(alone.out) as movie:
        assert movie.n_frames > 2  # stages of the hands
    failed = {s.label for s in status.values()} - {"ok", "no_grasp"}
    for label in failed:
        made = render(run.path, tmp_path / "c.png", status=[label], views=1, count=9, quiet=True)
        assert {status[name].label for name in made.shown} == {label}
    with pytest.raises(NotUsable, match="nothing to draw with --status jump"):
        render(run.path, tmp_path / "d.png", status=["jump"], quiet=True)


def test_figures_tell_reach_apart_from_success(run: Run):
    figures = describe(run.path)["figures"]
    assert list(figures["tests"]) == ["f", "l", "a"]
    found = figures["tests"]["a"]
    counted = sum(
        int(np.sum(b["selected"] & (b["arm_status"] == Status.OK))) for _, b, _ in rows(run)
    )
    assert found["reachable"]["selected"]["k"] == counted
    given = found["given_reachable"]["selected"]
    assert (given["k"], given["n"]) == (found["selected"]["k"], counted)


def test_without_motions_test_a_is_not_run_and_says_what_makes_them(run: Run, tmp_path, capsys):
    bare = made_run(run.library.path, tmp_path / "bare", sizes=(300,))
    assert allowed_tests(bare, PAPER, ()) == ("f", "l")
    with pytest.raises(NotUsable, match=r"needs the motions of arms.*bidexdata arms"):
        allowed_tests(bare, PAPER, ("a",))
    assert bidexdata(["validate", str(bare.path), "--tests", "a", "--quiet"]) == 3
    assert "bidexdata arms" in capsys.readouterr().err
    floating = made_run(run.library.path, tmp_path / "floating", sizes=(300,), setting="floating")
    with pytest.raises(NotUsable, match="cannot be run on floating rows"):
        allowed_tests(floating, PAPER, ("a",))


def test_tasks_whose_motions_are_missing_wait(run: Run, tmp_path):
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(run.path.parent, copy)
    part = Run.open(copy / "run")
    for task in part.tasks:
        shard_path(part.stage_folder("validate", "paper-1", "a"), task.task_id).unlink()
    for task in part.tasks[1:] or part.tasks:
        shard_path(part.arms_folder(), task.task_id).unlink()
    armed = len(Run.open(part.path).armed())
    reports = validate_run(Run.open(part.path), PAPER, execution=INLINE)
    assert set(reports) == ({"f", "l", "a"} if armed else {"f", "l"})
    assert sum(report.finished for report in reports.values()) == armed
