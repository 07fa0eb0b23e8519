"""Laws of runs that are made for a rig: what is kept can be taken, and all else is as without one."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_armed import write_rig

from bidexdata.cli.main import run as bidexdata
from bidexdata.errors import BadConfig, ConfigConflict
from bidexdata.record import Status
from bidexdata.runs.arms import arms_run
from bidexdata.runs.explain import explain_grasp
from bidexdata.runs.finished import Finished
from bidexdata.runs.info import describe
from bidexdata.runs.pack_inputs import NamedRun, run_info
from bidexdata.runs.run import Run
from bidexdata.runs.stage import TaskExecution
from bidexdata.runs.synth import SynthRequest
from bidexdata.synthesis.attempts import grasp_ids
from bidexdata.synthesis.config import SynthConfig

INLINE = TaskExecution(executor="inline", quiet=True)
GRASPS, CANDIDATES = 2, 8
OPTIONS = (
    *("--hand", "capsule", "--setting", "tabletop", "--sizes", "0.3,0.5", "--quiet"),
    *("--grasps", str(GRASPS), "--candidates", str(CANDIDATES)),
    *("--set", "regions.anchors=60", "--set", "optimise.approach.steps=30"),
    # Short runs end unbalanced; all that come through may be kept.
    *("--set", "selection.largest_residual=100"),
)


def synth(library: Path, out: Path, *more: str, executor: str = "inline") -> int:
    return bidexdata(
        ["synth", str(library), "--out", str(out), *OPTIONS, "--executor", executor, *more]
    )


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rigged") / "library"
    prepare = ["prepare", "shapes:box,bracket", "--out", str(folder)]
    assert bidexdata([*prepare, "--executor", "inline", "--quiet"]) == 0
    return folder


@pytest.fixture(scope="module")
def rig(library: Path) -> Path:
    return write_rig(library.parent / "rig")


@pytest.fixture(scope="module")
def made(library: Path, rig: Path) -> Run:
    out = library.parent / "run"
    assert synth(library, out, "--rig", str(rig)) == 0
    return Run.open(out)


@pytest.fixture(scope="module")
def solved(made: Run, library: Path) -> Run:
    out = library.parent / "solved"
    shutil.copytree(made.path, out)
    arms_run(Run.open(out), execution=INLINE)  # of the run's own rig
    return Run.open(out)


def shards(run: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in (run / "synth").glob("??/*.arrow")}


def statuses(run: Run) -> dict[str, int]:
    """Attempts by status, over the whole run."""
    found: dict[str, int] = {}
    for batch in run.batches():
        for counts in batch.header.counts.values():
            for label, n in counts.items():
                found[label] = found.get(label, 0) + n
    return found


def test_the_arms_have_a_motion_for_every_grasp_that_was_kept(solved: Run):
    rows = [solved.task_arms(task, solved.task_batch(task)) for task in solved.tasks]
    assert sum(int(batch["selected"].sum()) for batch in rows) > 4
    for batch in rows:
        good = batch["synth_status"] == Status.OK
        assert np.all(batch["selected"] <= good)
        assert (batch["arm_status"][good] == Status.OK).all()
        assert (batch["arm_status"][~good] == Status.NO_GRASP).all()


def test_attempts_out_of_reach_are_counted_and_have_no_pose(made: Run):
    found = statuses(made)
    assert found["not_reachable"] > 0
    assert sum(found.values()) == CANDIDATES * sum(len(task.scene_ids) for task in made.tasks)
    figures = describe(made.path)["figures"]
    assert figures["by_status"] == found
    assert figures["by_stage"]["reach"] == found["not_reachable"]
    for batch in made.batches():
        beyond = batch["synth_status"] == Status.NOT_REACHABLE
        assert not batch["selected"][beyond].any()
        assert np.isnan(batch["hand_pos"][beyond]).all()


def test_run_json_names_the_rig_and_the_stages_behind_take_it(made: Run, solved: Run):
    data = json.loads((made.path / "run.json").read_text())
    assert data["rig"]["name"] == "made"
    assert data["rig"]["rig"] == "../rig/made.yaml"
    assert describe(made.path)["made_for"] == "made"
    assert run_info(NamedRun("run", made, Finished.of(made))).rig == "made"  # the release's runs
    assert solved.arm_rigs() == ("made",)
    shutil.copytree(solved.path / "arms" / "made", solved.path / "arms" / "ur10e_post")
    try:
        assert Run.open(solved.path).rig == "made"
    finally:
        shutil.rmtree(solved.path / "arms" / "ur10e_post")


def test_a_run_without_a_rig_says_nothing_of_one(made: Run, library: Path, tmp_path):
    assert synth(library, tmp_path / "run") == 0
    plain = Run.open(tmp_path / "run")
    assert "rig" not in json.loads((plain.path / "run.json").read_text())
    assert "rig" not in plain.spec.identity()
    assert replace(made.spec, rig=None).fingerprint == plain.fingerprint
    assert made.fingerprint != plain.fingerprint
    assert statuses(plain).get("not_reachable", 0) == 0


def test_a_stopped_run_goes_on_and_gives_the_same_bytes(made: Run, library, rig, tmp_path):
    shutil.copytree(made.path, tmp_path / "run")
    whole = shards(made.path)
    for path in list((tmp_path / "run" / "synth").glob("??/*.arrow"))[1:]:
        path.unlink()
    # The run lies elsewhere now, and so does the rig from there.
    assert synth(library, tmp_path / "run", "--rig", str(rig)) == 0
    assert shards(tmp_path / "run") == whole


@pytest.mark.slow
def test_one_worker_and_two_give_the_same_bytes(made: Run, library, rig, tmp_path):
    out = tmp_path / "run"
    assert synth(library, out, "--rig", str(rig), "--workers", "2", executor="processes") == 0
    assert shards(out) == shards(made.path)


def test_another_rig_or_none_is_another_configuration(made: Run, library, rig, tmp_path, capsys):
    assert synth(library, made.path) == 5
    assert "rig: 'made' -> ''" in capsys.readouterr().err
    other = write_rig(tmp_path / "rig", name="other")
    assert synth(library, made.path, "--rig", str(other)) == 5
    assert "rig: 'made' -> 'other'" in capsys.readouterr().err
    changed = write_rig(tmp_path / "changed", description="the same arms, told otherwise")
    assert synth(library, made.path, "--rig", str(changed)) == 5
    assert "rig.robot" in capsys.readouterr().err


def test_a_changed_rig_stops_what_would_use_it(made: Run, library, rig, tmp_path):
    shutil.copytree(made.path, tmp_path / "run")
    write_rig(tmp_path / "rig", description="the same arms, told otherwise")
    with pytest.raises(ConfigConflict, match="rig"):
        explain_grasp(library, tmp_path / "run", some_id(made, Status.OK))


def some_id(run: Run, status: Status) -> str:
    """The first attempt of the first scene that has this status, stored or not."""
    for batch in run.batches():
        found = np.flatnonzero(batch["synth_status"] == status)
        if len(found):
            return str(batch["grasp_id"][found[0]])
    raise AssertionError(f"no row is {status.label}")


@pytest.mark.parametrize("status", [Status.OK, Status.NOT_REACHABLE], ids=lambda s: s.label)
def test_an_explained_attempt_repeats_and_says_what_the_arms_say(
    made: Run, library, tmp_path, monkeypatch, status
):
    monkeypatch.setattr("bidexdata.runs.explain_pictures.WIDTH", 64)
    monkeypatch.setattr("bidexdata.runs.explain_pictures.HEIGHT", 48)
    report = explain_grasp(library, made.path, some_id(made, status))
    assert report.repeat.differing == ()
    assert report.explanation.status is status
    said = {words.stage: words for words in report.said}
    where = "reach" if "reach" in said else "start"
    assert said[where].passed is (status is Status.OK)
    assert "arms" in said[where].text or status is Status.OK
    shutil.rmtree(made.path / "explain")


def test_arms_need_a_table(capsys, tmp_path):
    with pytest.raises(BadConfig, match="--rig belongs to --setting tabletop"):
        SynthRequest(config=SynthConfig(), rig="ur10e_post")
    floating = ["synth", str(tmp_path), "--out", str(tmp_path / "run"), "--rig", "ur10e_post"]
    assert bidexdata(floating) == 3
    assert "--rig belongs to --setting tabletop: arms need a table" in capsys.readouterr().err


def test_a_rig_that_there_is_not_is_refused_by_name(library, tmp_path, capsys):
    assert synth(library, tmp_path / "run", "--rig", "ur10e_pst") == 3
    assert "ur10e_post" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_arms_that_cannot_carry_the_hands_are_refused_before_anything_is_written(
    library, tmp_path, capsys
):
    from made_rig import rig_data

    weak = write_rig(tmp_path / "rig", arm={**rig_data()["arm"], "payload": 0.01})
    assert synth(library, tmp_path / "run", "--rig", str(weak)) == 3
    assert "carries 0.01 kg" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_ids_of_a_rigged_run_are_its_own(made: Run):
    for task in made.tasks:
        batch = made.task_batch(task)
        for scene_id in task.scene_ids:
            known = set(grasp_ids(made.fingerprint, scene_id, range(CANDIDATES)))
            assert set(batch["grasp_id"][batch["scene_id"] == scene_id].tolist()) <= known
