"""Laws of tabletop runs: rest poses stand on z = 0, the first are used, who has none is named."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from bidexdata.cli.main import run
from bidexdata.errors import BadConfig, ConfigConflict, UnknownChoice
from bidexdata.frames import matrix_from_quat
from bidexdata.objects.library import Library
from bidexdata.record import Status
from bidexdata.record.scene import setting_of
from bidexdata.runs.info import describe
from bidexdata.runs.plan import scene_of
from bidexdata.runs.run import Run
from bidexdata.runs.synth import SynthRequest, start_run
from bidexdata.synthesis.config import SynthConfig


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A box and a bracket, and a sphere none of whose rest poses is probable enough."""
    folder = tmp_path_factory.mktemp("tabletop") / "library"
    options = ["--set", "rest.min_probability=0.05", "--executor", "inline", "--quiet"]
    assert run(["prepare", "shapes:box,bracket,sphere", "--out", str(folder), *options]) == 0
    return folder


def planned(library: Path, out: Path, **options) -> Run:
    request = SynthRequest(
        config=SynthConfig(), hand="capsule", sizes_mm=(300, 500), setting="tabletop", **options
    )
    return start_run(Library.open(library), out, request)


@pytest.mark.parametrize(("asked", "used"), [(None, 1), (1, 1), (4, 4), (100, 6)])
def test_the_most_probable_rest_poses_are_used_at_every_size(library, tmp_path, asked, used):
    made = planned(library, tmp_path / "run", rest_poses=asked)
    box = Library.open(library).object_ids[0]
    ids = {s for t in made.tasks_of(box) for s in t.scene_ids}
    assert ids == {f"{box}/{mm}/table{k}" for mm in (300, 500) for k in range(used)}
    assert made.spec.rest_poses == (asked or 1)


def test_an_object_without_a_rest_pose_is_named_and_gives_no_scene(library, tmp_path):
    made = planned(library, tmp_path / "run")
    box, bracket, sphere = Library.open(library).object_ids
    assert made.object_ids == tuple(sorted((box, bracket)))
    assert made.spec.without_scene == (sphere,)
    assert describe(tmp_path / "run")["without_scene"] == [sphere]
    request = SynthRequest(config=SynthConfig(), hand="capsule", sizes_mm=(300,))
    floating = start_run(Library.open(library), tmp_path / "floating", request)
    assert floating.object_ids == tuple(sorted((box, bracket, sphere)))
    assert floating.spec.without_scene == ()


def test_another_number_of_rest_poses_is_another_run(library, tmp_path):
    first = planned(library, tmp_path / "run")
    assert planned(library, tmp_path / "run", rest_poses=1).fingerprint == first.fingerprint
    with pytest.raises(ConfigConflict, match="rest_poses: 1 -> 2"):
        planned(library, tmp_path / "run", rest_poses=2)


@pytest.mark.parametrize("options", [{"rest_poses": 1}, {"rest_poses": 0, "setting": "tabletop"}])
def test_a_number_that_means_nothing_is_refused(options):
    with pytest.raises(BadConfig, match="--rest-poses"):
        SynthRequest(config=SynthConfig(), **options)


@pytest.mark.parametrize("setting", ["table", "Floating", ""])
def test_a_setting_that_there_is_not_is_refused_with_those_there_are(setting):
    with pytest.raises(UnknownChoice, match="one of floating, tabletop"):
        setting_of(setting)
    made = object.__new__(SynthRequest)  # a caller whose types nobody checks
    for field in dataclasses.fields(SynthRequest):
        object.__setattr__(made, field.name, field.default)
    object.__setattr__(made, "setting", setting)
    with pytest.raises(UnknownChoice, match="--setting"):
        made.__post_init__()


def test_synth_says_so_and_ends_with_6_where_no_object_can_rest(tmp_path, capsys):
    options = ["--set", "rest.min_probability=0.05", "--executor", "inline", "--quiet"]
    assert run(["prepare", "shapes:sphere", "--out", str(tmp_path / "lib"), *options]) == 0
    table = ["--setting", "tabletop", "--hand", "capsule", "--json", "--executor", "inline"]
    for _ in range(2):
        made = ["synth", str(tmp_path / "lib"), "--out", str(tmp_path / "run"), *table]
        assert run(made) == 6
        data = json.loads(capsys.readouterr().out)
        assert (data["tasks"], data["n"], len(data["without_scene"])) == (0, 0, 1)
    assert run(["info", str(tmp_path / "run")]) == 0
    assert "no scene: 1 object has no rest pose" in capsys.readouterr().out


def test_in_every_rest_pose_the_lowest_point_is_on_the_table(library):
    opened = Library.open(library)
    seen = 0
    for object_id in opened.object_ids:
        solid = opened.load_solid(object_id)
        assert np.all(np.diff(solid.rest_probabilities) <= 1e-9)
        for k in range(len(solid.rest_heights)):
            for mm in (300, 800):
                scene = scene_of(f"{object_id}/{mm}/table{k}", solid)
                R = matrix_from_quat(np.array(scene.object_quat_wxyz))
                points = np.concatenate([p.vertices for p in solid.pieces]) * scene.size
                world = points @ R.T + np.array(scene.object_pos)
                assert abs(world[:, 2].min()) < 1e-4
                assert scene.object_pos[:2] == (0.0, 0.0)
                seen += 1
    assert seen > 8


def test_one_worker_and_two_give_the_same_bytes_on_a_table(library, tmp_path):
    few = ("--hand", "capsule", "--sizes", "0.3", "--grasps", "2", "--candidates", "4", "--quiet")
    fast = ("--set", "regions.anchors=60", "--set", "optimise.approach.steps=40")
    made = {}
    for workers in ("1", "2"):
        out = tmp_path / workers
        table = ("--setting", "tabletop", "--workers", workers)
        assert run(["synth", str(library), "--out", str(out), *few, *fast, *table]) == 0
        shards = sorted((out / "synth").rglob("*.arrow"))
        made[workers] = {p.name: p.read_bytes() for p in shards}
        for batch in Run.open(out).batches():
            assert set(batch["setting"].tolist()) == {"tabletop"}
            assert np.all(batch["synth_status"][batch["selected"]] == Status.OK)
            assert np.all(batch["object_pos"][:, 2] > 0)
    assert len(made["1"]) == 2
    assert made["1"] == made["2"]
