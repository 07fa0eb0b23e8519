"""How commands end: what failed is said once, and nothing made is nothing however often one asks."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from bidexdata.cli.figures import LEGEND
from bidexdata.cli.main import run
from bidexdata.cli.report import (
    earlier_text,
    free_name,
    no_grasp_text,
    refuse_nothing,
    warn_of_failed,
)
from bidexdata.errors import NothingSucceeded
from bidexdata.runs.executors import TaskFailure
from bidexdata.runs.stage import StageReport


def test_failed_tasks_are_counted_with_the_first_reason_and_what_to_do(capsys):
    failures = (TaskFailure(None, "ValueError: bad"), TaskFailure(None, "died"))
    warn_of_failed(StageReport(tasks=5, before=1, failures=failures), Path("here/run"))
    said = capsys.readouterr().err
    assert said.startswith("2 of 5 tasks failed (first: ValueError: bad); here/run/logs has")
    assert len(said.splitlines()) == 1
    warn_of_failed(StageReport(tasks=5, before=1), Path("here/run"))
    assert capsys.readouterr().err == ""


def test_suggested_folders_are_not_there_yet(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert free_name("RUN") == "RUN"
    for name in ("RUN", "RUN-2"):
        (tmp_path / name).mkdir()
    assert free_name("RUN") == "RUN-3"


def rows(*success: bool) -> list[dict[str, np.ndarray]]:
    return [{"success": np.array([one])} for one in success]


def test_a_success_of_this_call_or_an_earlier_one_is_enough():
    refuse_nothing(1, rows(), "success", "none")
    refuse_nothing(0, rows(False, True), "success", "none")
    for found in (rows(), rows(False, False)):
        with pytest.raises(NothingSucceeded, match="none") as caught:
            refuse_nothing(0, found, "success", "none")
        assert caught.value.exit_code == 6


def test_rows_are_not_read_when_this_call_had_a_success():
    def unread():
        pytest.fail("the rows were read")
        yield

    refuse_nothing(1, unread(), "success", "none")


def test_every_figure_with_a_short_name_is_explained_where_it_is_printed():
    root = Path(__file__).resolve().parents[2]
    readme = (root / "README.md").read_text("utf-8").partition("## What the figures mean")[2]
    protocols = (root / "docs" / "protocols.md").read_text("utf-8").partition("## Metrics")[2]
    for name in ("PD", "SPD", "CDC", "D"):
        assert re.search(rf"\b{name}\b[^;]* = ", LEGEND), name
        assert re.search(rf"\b{name}\b (is|says)", readme) or f" {name} the" in readme, name
        assert re.search(rf"\b{name}\b|`{name.lower()}`", protocols), name


def test_prepare_and_info_say_the_same_of_inputs_that_failed(tmp_path, capsys):
    for name in ("bad.obj", "copy.obj"):
        (tmp_path / name).write_text("no mesh")
    words = ["prepare", str(tmp_path / "bad.obj"), str(tmp_path / "copy.obj"), "shapes:box"]
    assert run([*words, "--out", str(tmp_path / "lib"), "--executor", "inline", "--json"]) == 0
    prepared = json.loads(capsys.readouterr().out)
    assert run(["info", str(tmp_path / "lib"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert prepared["failures"] == told["failures"]
    (failed,) = told["failures"]  # the copy is a duplicate, and no failure
    assert set(failed) == {"source_name", "status", "reason"}
    assert told["by_status"][failed["status"]] == told["by_status"]["duplicate"] == 1
    assert prepared["warnings"] == told["warnings"]


def test_warnings_of_a_library_are_counted_and_listed(tmp_path, capsys):
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.update_faces(ball.triangles_center[:, 2] < 0.5)  # an open bowl
    ball.export(tmp_path / "open.obj")
    words = ["prepare", str(tmp_path / "open.obj"), "--out", str(tmp_path / "lib")]
    assert run([*words, "--executor", "inline"]) == 0
    assert "1 object with warnings, which `bidexdata info" in capsys.readouterr().out
    assert run(["info", str(tmp_path / "lib")]) == 0
    assert re.search("open.obj: warning: 1 hole closed", capsys.readouterr().out)


def test_scenes_without_a_grasp_are_named_by_synth_and_by_info(tmp_path, capsys):
    options = ("--executor", "inline", "--quiet")
    assert run(["prepare", "shapes:box", "--out", str(tmp_path / "lib"), *options]) == 0
    made = str(tmp_path / "run")
    synth = [
        *("synth", str(tmp_path / "lib"), "--out", made, "--hand", "capsule"),
        *("--sizes", "0.3,0.5", "--grasps", "1", "--candidates", "1", "--executor", "inline"),
        *("--set", "regions.anchors=60", "--set", "optimise.approach.steps=1"),
        *("--set", "selection.largest_residual=0"),
    ]
    assert run(synth) == 6
    said = capsys.readouterr().out
    assert run(["info", made]) == 0
    told = capsys.readouterr().out
    assert run(["info", made, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert [s.split("/", 1)[1] for s in data["without_grasp"]] == ["300/float", "500/float"]
    sentence = no_grasp_text(data["without_grasp"])
    assert "0.30 m" in sentence
    assert sentence in said.splitlines()
    assert sentence in told.splitlines()


def test_only_the_first_scenes_without_a_grasp_are_named():
    ids = [f"box-1/{mm}/{place}" for mm in (300, 305) for place in ("float", "table2")]
    assert no_grasp_text(ids[:1]) == "no grasp kept of 1 scene: box-1 0.30 m"
    assert no_grasp_text(ids) == (
        "no grasp kept of 4 scenes: box-1 0.30 m, box-1 0.30 m table2, box-1 0.305 m and 1 more"
    )


def test_figures_of_one_call_say_what_earlier_calls_did():
    assert earlier_text(0) == ""
    assert earlier_text(3) == "; 3 tasks of earlier calls not counted"
