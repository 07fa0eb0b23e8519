"""Laws of the stage: a row per input, resumable, the same bytes whatever the workers."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from mesh_files import library_files as files
from mesh_files import mixed_folder

from bidexdata.errors import ConfigConflict, NotUsable
from bidexdata.objects.config import (
    LimitsConfig,
    PrepareConfig,
    RestConfig,
    SdfConfig,
    SelectConfig,
)
from bidexdata.objects.library import Library
from bidexdata.record.status import Status
from bidexdata.runs import object_folders
from bidexdata.runs.prepare import prepare_library
from bidexdata.runs.prepare_report import PrepareReport
from bidexdata.runs.prepare_task import prepare_one


@pytest.fixture(scope="module")
def small(small: PrepareConfig) -> PrepareConfig:
    """Few drops too: these tests are about what surrounds the objects."""
    return replace(small, rest=RestConfig(drops=24))


@pytest.fixture
def meshes(tmp_path: Path, box) -> Path:
    """A good box, the same bytes again, points without faces, and half an STL."""
    return mixed_folder(tmp_path / "meshes", box)


def run(sources, out: Path, config: PrepareConfig, **options) -> PrepareReport:
    options = {"executor": "inline", "quiet": True, **options}
    return prepare_library([str(s) for s in sources], out, config, **options)


def dead_process() -> str:
    return subprocess.run(
        [sys.executable, "-c", "import os; print(os.getpid())"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()


def test_every_input_is_one_row_with_its_status(tmp_path, meshes, small):
    report = run([meshes], tmp_path / "lib", small)
    labels = [row["status_label"] for row in report.rows]
    assert labels == ["ok", "duplicate", "no_faces", "unreadable", "ok"]
    assert [r["source_name"] for r in report.rows] == sorted(p.name for p in meshes.iterdir())
    assert report.rows[1]["duplicate_of"] == report.rows[0]["object_id"]
    assert all(row["reason"] for row in report.rows if row["status"])
    lib = Library.open(tmp_path / "lib")
    assert lib.object_ids == (report.rows[0]["object_id"], report.rows[4]["object_id"])
    assert lib.fingerprint == report.fingerprint
    assert lib.load(lib.object_ids[0]).volume > 0
    assert report.by_status == {"duplicate": 1, "no_faces": 1, "ok": 2, "unreadable": 1}
    assert json.loads(json.dumps(report.as_dict()))["prepared"] == 2


def test_pieces_that_fill_a_hollow_are_warned_of_and_shown(tmp_path, small):
    crude = replace(small, convex=replace(small.convex, max_pieces=1, finer_above=100.0))
    report = run(["shapes:bowl"], tmp_path / "lib", crude)
    (row,) = report.rows
    assert row["volume_ratio"] > 1.25
    said = f"the convex pieces have {row['volume_ratio']:.2f} times the volume of the mesh"
    assert said in row["warnings"]
    page = (tmp_path / "lib" / "report.html").read_text("utf-8")
    assert said in page
    assert f"{100 * row['solid_hausdorff']:.2f} % from the mesh" in page
    assert f"{100 * row['hausdorff']:.2f} % from the file" in page


def test_worker_processes_give_the_bytes_of_one_process(tmp_path, meshes, small):
    run([meshes, "shapes:bracket"], tmp_path / "inline", small)
    run([meshes, "shapes:bracket"], tmp_path / "two", small, executor="processes", workers=2)
    assert files(tmp_path / "inline") == files(tmp_path / "two")


def test_a_second_run_makes_only_what_is_missing(tmp_path, meshes, small):
    out = tmp_path / "lib"
    first = run([meshes], out, small)
    before = files(out)
    stamps = {p: p.stat().st_mtime_ns for p in out.rglob("object.json")}
    lost = Library.open(out).folder(first.rows[4]["object_id"])
    for path in lost.iterdir():
        path.unlink()
    lost.rmdir()
    (out / "index.parquet").unlink()
    (lost.parent / f".{lost.name}.{socket.gethostname()}.{dead_process()}.partial").mkdir()
    again = run([meshes], out, small)
    assert again.resumed == 1
    assert files(out) == before
    assert not list(out.rglob(".*.partial"))
    kept = [p for p, stamp in stamps.items() if p.stat().st_mtime_ns == stamp]
    assert len(kept) == 1


def test_a_folder_cut_short_is_made_again(tmp_path, meshes, small):
    out = tmp_path / "lib"
    report = run([meshes], out, small)
    before = files(out)
    (Library.open(out).folder(report.rows[0]["object_id"]) / "pieces.npz").unlink()
    assert run([meshes], out, small).resumed == 1
    assert files(out) == before


def test_a_cut_or_damaged_object_is_made_again_and_stops_nothing(tmp_path, meshes, small):
    out = tmp_path / "lib"
    report = run([meshes], out, small)
    before = files(out)
    folder = Library.open(out).folder(report.rows[0]["object_id"])
    for name, data in (
        ("object.json", b""),
        ("object.json", b"[]"),
        ("object.json", b'{"schema_version": "1.0"}'),
        ("object.json", (folder / "object.json").read_bytes()[:-9]),
        ("geometry.npz", b"damaged"),
        ("mesh.glb", (folder / "mesh.glb").read_bytes()[:-1] + b"!"),
    ):
        (folder / name).write_bytes(data)
        again = run([meshes], out, small)
        assert (again.made, again.resumed) == (1, 1), name
        assert files(out) == before


def test_a_damaged_object_that_a_selection_left_out_is_seen(tmp_path, meshes, small):
    out = tmp_path / "lib"
    report = run([meshes], out, small)
    folder = Library.open(out).folder(report.rows[0]["object_id"])
    none = replace(small, select=SelectConfig(max_aspect=1.0))
    run([meshes], out, none)
    (folder / "geometry.npz").write_bytes(b"damaged")
    assert run([meshes], out, small).fingerprint == report.fingerprint


def test_what_a_killed_writer_leaves_stops_nothing_and_goes(tmp_path, meshes, small):
    out, whole = tmp_path / "lib", tmp_path / "whole"
    run([meshes], whole, small)
    mark = f"{socket.gethostname()}.{dead_process()}"
    partial = out / "objects" / "00" / f".box-00000000.{mark}.partial"
    partial.mkdir(parents=True)
    (partial / "object.json").write_text('{"schema_version": "1.0", "config": {"other": 1}}')
    left = [out / f".report.html.{mark}.tmp", out / f".index.parquet.{mark}.partial"]
    left += [out / ".times" / f".times.js.{mark}.tmp", out / ".parts" / "x" / f".0.json.{mark}.tmp"]
    for path in left:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    run([meshes], out, small, limit=1)
    assert not any(path.exists() for path in (*left, partial))
    # A library that is whole loses them too.
    left[0].touch()
    run([meshes], out, small)
    assert files(out) == files(whole)


def test_each_object_folder_is_hashed_once(tmp_path, meshes, small, monkeypatch):
    out = tmp_path / "lib"
    run([meshes], out, small)
    hashed = []
    real = object_folders.content_sha256
    monkeypatch.setattr(
        object_folders, "content_sha256", lambda folder: (hashed.append(folder), real(folder))[1]
    )
    assert run([meshes], out, small).made == 0
    assert len(hashed) == len(set(hashed)) == 2


def test_a_copy_of_what_is_not_wanted_is_no_duplicate(tmp_path, meshes, small):
    (meshes / "INDEX.csv").write_text("file,category\na_box.stl,car\nb_copy.stl,mug\n")
    wanted = replace(small, select=SelectConfig(categories=("mug",)))
    first, second, *_ = run([meshes], tmp_path / "lib", wanted, limit=2).rows
    assert (first["status_label"], second["status_label"]) == ("not_selected", "ok")


def test_a_copy_is_made_once_the_first_is_gone(tmp_path, meshes, small):
    out = tmp_path / "lib"
    run([meshes], out, small)
    (meshes / "a_box.stl").unlink()
    assert run([meshes], out, small).rows[0]["status_label"] == "ok"


def test_a_failure_stays_what_it_was_beside_its_copy(tmp_path, small):
    for name in ("a", "b"):  # copies of one name have one id
        (tmp_path / "meshes" / name).mkdir(parents=True)
        (tmp_path / "meshes" / name / "points.obj").write_text("v 0 0 0\nv 1 0 0\n")
    for _ in range(2):
        report = run([tmp_path / "meshes"], tmp_path / "lib", small)
        assert [r["status_label"] for r in report.rows] == ["no_faces", "duplicate"]


def test_another_configuration_is_refused_with_the_key_that_differs(tmp_path, meshes, small):
    out = tmp_path / "lib"
    run([meshes], out, small)
    before = files(out)
    with pytest.raises(ConfigConflict, match=r"sdf\.cells: 40 -> 41") as caught:
        run([meshes], out, replace(small, sdf=SdfConfig(cells=41)))
    assert caught.value.exit_code == 5
    assert files(out) == before
    # Bounds on the worker decide whether there are bytes, not which.
    longer = replace(small, limits=LimitsConfig(wall_seconds=1e4))
    assert run([meshes], out, longer).resumed == 2


def test_limit_takes_the_first_inputs(tmp_path, meshes, small):
    report = run([meshes], tmp_path / "lib", small, limit=2)
    assert [r["source_name"] for r in report.rows] == ["a_box.stl", "b_copy.stl"]
    assert run([meshes], tmp_path / "lib", small).resumed == 1


def test_a_limit_that_would_drop_settled_objects_is_refused_and_writes_nothing(
    tmp_path, meshes, small
):
    out = tmp_path / "lib"
    whole = run([meshes], out, small)
    before, last = files(out), whole.rows[4]["source_name"]
    with pytest.raises(ConfigConflict) as caught:
        run([meshes], out, small, limit=3)
    assert caught.value.exit_code == 5
    said = str(caught.value)
    assert said.startswith(
        f"--limit 3 would drop 1 object of an earlier call from {out} (first: {last}"
    )
    assert "leave out --limit, or use another --out" in said
    assert files(out) == before
    assert len(run([meshes], out, small, limit=3, dry_run=True).rows) == 3
    # A limit that drops no object, and other sources, are no such thing.
    assert run([meshes], out, small, limit=5).fingerprint == whole.fingerprint
    assert run(["shapes:box", "shapes:cone"], out, small, limit=1).prepared == 1


def test_a_dry_run_lists_the_inputs_and_writes_nothing(tmp_path, meshes, small):
    report = run([meshes, "shapes"], tmp_path / "lib", small, dry_run=True)
    assert len(report.rows) > 10
    assert all(row["object_id"] for row in report.rows)
    assert not (tmp_path / "lib").exists()


def test_a_foreign_folder_is_left_alone(tmp_path, meshes, small):
    out = tmp_path / "mine"
    out.mkdir()
    (out / "thesis.tex").write_text("x")
    with pytest.raises(NotUsable, match=r"thesis\.tex"):
        run([meshes], out, small)
    with pytest.raises(NotUsable, match="file"):
        run([meshes], out / "thesis.tex", small)
    # A release and a run hold objects too, and are told apart from an unfinished library.
    (out / "thesis.tex").rename(out / "manifest.json")
    (out / "objects").mkdir()
    with pytest.raises(NotUsable, match="is a release and"):
        run([meshes], out, small)
    with pytest.raises(NotUsable, match="is a release; this needs a library"):
        Library.open(out)
    (out / "manifest.json").rename(out / "run.json")
    with pytest.raises(NotUsable, match="is a run; this needs a library"):
        Library.open(out)


def test_nothing_prepared_is_still_a_library_with_its_rows(tmp_path, meshes, small):
    report = run([meshes / "c_points.obj"], tmp_path / "lib", small)
    assert report.prepared == 0
    assert Library.open(tmp_path / "lib").object_ids == ()
    assert Library.open(tmp_path / "lib").index.num_rows == 1


def dies_of_the_first(task):
    if task.item.source_name == "a_box.stl":
        os.kill(os.getpid(), signal.SIGKILL)
    return prepare_one(task)


def test_a_worker_that_dies_costs_one_row_and_a_rerun_tries_again(
    tmp_path, meshes, small, monkeypatch
):
    out, sources = tmp_path / "lib", [meshes / "a_box.stl", meshes / "e_box.obj"]
    with monkeypatch.context() as patch:
        patch.setattr("bidexdata.runs.prepare.prepare_one", dies_of_the_first)
        first, other = run(sources, out, small, executor="processes", workers=1).rows
    assert (first["status"], other["status"]) == (Status.CRASHED, Status.OK)
    assert "SIGKILL" in first["reason"]
    again = run(sources, out, small)
    assert [row["status"] for row in again.rows] == [Status.OK] * 2
    assert again.made == 1


def raises_of_the_first(task):
    if task.item.source_name == "a_box.stl":
        raise KeyError("SIGXCPU")
    return prepare_one(task)


def test_an_exception_is_no_death_and_its_traceback_is_kept(tmp_path, meshes, small, monkeypatch):
    out, sources = tmp_path / "lib", [meshes / "a_box.stl", meshes / "e_box.obj"]
    with monkeypatch.context() as patch:
        patch.setattr("bidexdata.runs.prepare.prepare_one", raises_of_the_first)
        first, other = run(sources, out, small).rows
    # A word in its message is no signal.
    assert (first["status"], other["status"]) == (Status.CRASHED, Status.OK)
    assert first["reason"].endswith(
        "unexpected error, whose traceback is in the logs: KeyError: 'SIGXCPU'"
    )
    assert "died" not in first["reason"]
    (log,) = (out / ".logs").iterdir()
    text = log.read_text()
    assert first["object_id"] in text
    assert "in raises_of_the_first" in text
    again = run(sources, out, small)
    assert [row["status"] for row in again.rows] == [Status.OK] * 2


def test_a_worker_that_needs_too_much_memory_costs_one_row(tmp_path, meshes, small):
    fine = replace(small, sdf=SdfConfig(cells=4000, error=1e-9))
    bound = replace(fine, limits=LimitsConfig(memory_gib=1.5))
    (row,) = run([meshes / "a_box.stl"], tmp_path / "lib", bound, executor="processes").rows
    assert row["status"] == Status.TOO_COMPLEX
    assert "needs more than limits.memory_gib = 1.5 GiB" in row["reason"]


def test_a_worker_that_takes_too_long_costs_one_row(tmp_path, meshes, small):
    out = tmp_path / "lib"
    hasty = replace(small, limits=LimitsConfig(wall_seconds=0.05))
    report = run([meshes / "a_box.stl"], out, hasty, executor="processes", workers=1)
    assert report.rows[0]["status"] == Status.TIMED_OUT
    # A re-run tries it again.
    again = run([meshes / "a_box.stl"], out, small)
    assert again.rows[0]["status"] == Status.OK


def test_a_worker_that_uses_up_its_cpu_time_costs_one_row(tmp_path, meshes, small):
    # A fresh worker loads its libraries within the bound, which alone takes longer.
    busy = replace(small, limits=LimitsConfig(cpu_seconds=0.01))
    sources = [meshes / "a_box.stl", meshes / "c_points.obj"]
    report = run(sources, tmp_path / "lib", busy, executor="processes", workers=1)
    box, points = report.rows
    assert box["status"] == Status.TOO_COMPLEX
    assert "limits.cpu_seconds = 0.01" in box["reason"]
    assert points["status"] == Status.NO_FACES


def test_the_index_says_what_the_repair_did(tmp_path, meshes, small):
    run([meshes / "a_box.stl"], tmp_path / "lib", small)
    (row,) = Library.open(tmp_path / "lib").index.to_pylist()
    assert (row["repair"], row["repair_steps"]) == ("as_is", ["weld"])
    assert row["hausdorff"] < 1e-6


def test_listed_files_that_do_not_exist_are_rows(tmp_path, meshes, small):
    listed = meshes / "list.txt"
    listed.write_text("missing.obj\na_box.stl\n")
    report = run([listed], tmp_path / "lib", small)
    assert [r["status_label"] for r in report.rows] == ["no_file", "ok"]
    assert "the list's own folder" in report.rows[0]["reason"]


@pytest.mark.slow
def test_real_meshes_are_prepared_without_the_hull(tmp_path, shared):
    train = shared / "objects" / "train"
    names = ("duck.glb", "robosuite_cereal.obj", "aws_securitycamera.dae", "contactdb_table.stl")
    report = run([train / n for n in names], tmp_path / "lib", PrepareConfig())
    assert report.prepared == 4
    assert report.hulls == 0
    assert all(row["licence"] != "unknown" for row in report.rows)
    assert all(row["hausdorff"] < 0.02 for row in report.rows)
