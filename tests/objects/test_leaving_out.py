"""Laws of selections: what is left out has its reason, stays on disk, and comes back with other bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mesh_files import write_obj

from bidexdata.errors import BadConfig
from bidexdata.kinds import REPORT
from bidexdata.objects.closed import as_mesh
from bidexdata.objects.config import SelectConfig
from bidexdata.objects.library import Library
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.selection import near_duplicates, outside, unwanted
from bidexdata.runs.library_report import TIMES, Taken, append_time, read_times
from bidexdata.runs.prepare import prepare_library

TRAITS = {"aspect": 4.0, "thickness": 0.01, "components": 2, "genus": 1}


@pytest.mark.parametrize(
    ("bound", "said"),
    [
        ({"max_aspect": 3.9}, "aspect 4 > select.max_aspect 3.9"),
        ({"min_thickness": 0.02}, "thickness 0.01 < select.min_thickness 0.02"),
        ({"max_components": 1}, "components 2 > select.max_components 1"),
        ({"max_genus": 0}, "genus 1 > select.max_genus 0"),
    ],
)
def test_a_broken_bound_is_named_with_its_figures(bound, said):
    assert outside(TRAITS, SelectConfig(**bound)) == said
    at_it = {k: TRAITS[k.partition("_")[2]] for k in bound}
    assert outside(TRAITS, SelectConfig(**at_it)) == ""
    assert outside(TRAITS, SelectConfig()) == ""


def test_categories_are_wanted_or_not():
    assert unwanted("mug", SelectConfig()) == ""
    assert unwanted("mug", SelectConfig(categories=("mug", "cup"))) == ""
    assert "select.categories" in unwanted("car", SelectConfig(categories=("mug",)))
    assert "select.without_categories" in unwanted("car", SelectConfig(without_categories=("car",)))


def test_the_first_of_like_shapes_stays_whatever_follows():
    rng = np.random.default_rng(3)
    one, other = rng.random(5), rng.random(5)
    shapes = [
        {"descriptor": d, "mesh_hash": h}
        for d, h in (
            (one, "a"),
            (other, "b"),
            (one + 1e-3, "c"),
            (other + 9, "b"),
            (one - 1e-3, "d"),
        )
    ]
    assert near_duplicates(shapes, SelectConfig()) == {2: 0, 3: 1, 4: 0}
    assert near_duplicates(shapes, SelectConfig(alike=1e-4)) == {3: 1}
    assert near_duplicates([], SelectConfig()) == {}


def test_alike_must_be_positive():
    with pytest.raises(BadConfig, match="alike"):
        SelectConfig(alike=0.0)


def prepared(sources, out, config, **options):
    options = {"executor": "inline", "quiet": True, **options}
    return prepare_library([str(s) for s in sources], out, config, **options)


def labels(report):
    return [row["status_label"] for row in report.rows]


@pytest.fixture
def boxes(tmp_path, box):
    """A box, the same one bigger and elsewhere with other triangles, and a long one."""
    folder = tmp_path / "meshes"
    folder.mkdir()
    fine = as_mesh(_manifold(box).refine(2))
    write_obj(folder / "a.obj", box)
    write_obj(folder / "b.obj", TriangleMesh(3 * fine.vertices + 5, fine.faces))
    write_obj(folder / "c.obj", TriangleMesh(box.vertices * [9, 1, 1], box.faces))
    return folder


def _manifold(mesh):
    from bidexdata.objects.closed import as_manifold

    solid = as_manifold(mesh)
    assert solid is not None
    return solid


def test_another_selection_of_a_library_makes_nothing_anew(tmp_path, boxes, small):
    out = tmp_path / "lib"
    first = prepared([boxes], out, small)
    assert labels(first) == ["ok", "ok", "ok"]
    assert first.rows[1]["near_duplicate_of"] == first.rows[0]["object_id"]
    stamps = {p: p.stat().st_mtime_ns for p in out.rglob("object.json")}
    strict = replace(small, select=SelectConfig(max_aspect=5.0, near_duplicates=False))
    second = prepared([boxes], out, strict)
    assert labels(second) == ["ok", "near_duplicate", "not_selected"]
    assert "aspect 18 > select.max_aspect 5" in second.rows[2]["reason"]
    assert Library.open(out).object_ids == (first.rows[0]["object_id"],)
    assert second.as_dict()["failures"] == []
    third = prepared([boxes], out, small)
    assert third.fingerprint == first.fingerprint
    assert stamps == {p: p.stat().st_mtime_ns for p in out.rglob("object.json")}


def test_a_dry_run_counts_what_would_be_left_out_and_writes_nothing(tmp_path, boxes, small):
    strict = replace(small, select=SelectConfig(max_aspect=5.0))
    report = prepared([boxes], tmp_path / "lib", strict, dry_run=True)
    assert report.by_status == {"not_selected": 1, "ok": 2}
    assert not (tmp_path / "lib").exists()


def test_a_finished_library_is_left_alone_failures_too(tmp_path, boxes, small, monkeypatch):
    (boxes / "bad.obj").write_text("not a mesh")
    strict = replace(small, select=SelectConfig(max_aspect=5.0))
    out = tmp_path / "lib"
    first = prepared([boxes], out, strict)
    assert first.made == 4

    def fail(task):
        raise AssertionError(task)

    monkeypatch.setattr("bidexdata.runs.prepare.prepare_one", fail)
    again = prepared([boxes], out, strict)
    assert again.made == 0
    assert again.rows == first.rows
    monkeypatch.undo()
    other = prepared([boxes], out, replace(strict, select=SelectConfig()))
    assert other.made == 2, "what other bounds might keep, and what another version might read"


def test_the_report_shows_every_input_with_its_picture_and_time(tmp_path, boxes, small):
    (boxes / "<bad>.obj").write_text("not a mesh")
    out = tmp_path / "lib"
    report = prepared([boxes], out, small)
    page = (out / REPORT).read_text()
    for row in report.rows:
        assert row["source_name"].replace("<", "&lt;").replace(">", "&gt;") in page
        if row["status"] == 0:
            assert f"{row['object_id']}/thumbnail.png" in page
            assert (Library.open(out).folder(row["object_id"]) / "thumbnail.png").is_file()
    assert "<bad>" not in page
    assert set(read_times(out)) == {row["object_id"] for row in report.rows}


def test_half_a_line_of_a_killed_process_loses_no_other_time(tmp_path):
    append_time(tmp_path, "one", Taken(1.5, 1.0, 0.25))
    for cut in ("two", "two,", "two,1.x", "two,1,1", "two,1,1,", "two,1,1,1,1"):
        (tmp_path / TIMES / "killed.csv").write_text(f"zero,0.5,0.25,0\n{cut}")
        assert read_times(tmp_path) == {"one": (1.5, 1.0, 0.25), "zero": (0.5, 0.25, 0.0)}


def test_the_cpu_seconds_of_the_worker_and_of_the_decomposition_are_kept_apart(tmp_path, small):
    out = tmp_path / "lib"
    report = prepared(["shapes:box", "shapes:bracket"], out, small)
    box, bracket = (read_times(out)[row["object_id"]] for row in report.rows)
    assert box.search_cpu == 0  # it is its hull: nothing was searched
    assert bracket.search_cpu > 0.05
    assert box.cpu > 0


def test_objects_that_other_inputs_do_not_name_leave_the_index_and_are_told(tmp_path, boxes, small):
    out = tmp_path / "lib"
    first = prepared([boxes], out, small)
    assert first.no_longer == ()
    second = prepared([sorted(boxes.glob("*"))[0]], out, small)
    assert len(second.rows) == 1
    gone = {r["object_id"] for r in first.rows} - {r["object_id"] for r in second.rows}
    assert set(second.no_longer) == gone
    assert len(gone) > 0
    assert prepared([boxes], out, small).fingerprint == first.fingerprint  # their files stayed
