"""Laws of the flat table: a row per grasp, empty where nothing is known, columns of the fields."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from made_dexgraspbench import OBJECTS, PER_SCENE, SCALES, made_dexgraspbench
from made_release import PER_SCENE as PER_RELEASE_SCENE
from made_release import SIZES, as_schema_1_0, made_release, made_verdicts

from bidexdata.errors import BadConfig, NotUsable, PathNotFound, UnknownName
from bidexdata.formats import flat
from bidexdata.formats.flat import flat_columns, flat_schema
from bidexdata.formats.release import Release
from bidexdata.objects.config import PrepareConfig, SdfConfig, SurfaceConfig
from bidexdata.record import FIELDS, Status
from bidexdata.runs import import_objects
from bidexdata.runs.import_ import ImportRequest, import_run
from bidexdata.runs.run import Run, verdict_fingerprint
from bidexdata.runs.run_rows import verdict_batch
from bidexdata.runs.shards import shard_path, write_shard
from bidexdata.runs.stage import TaskExecution
from bidexdata.runs.table import write_table
from bidexdata.validation.protocols import load_protocol

N = len(OBJECTS) * len(SCALES) * PER_SCENE


@pytest.fixture(scope="module")
def bare(tmp_path_factory) -> Path:
    """An imported run without verdicts; read only."""
    root = tmp_path_factory.mktemp("table")
    small = PrepareConfig(surface=SurfaceConfig(points=100), sdf=SdfConfig(cells=12))
    asked = ImportRequest(
        format="dexgraspbench", path=made_dexgraspbench(root / "bench"), hand="capsule"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_objects, "PrepareConfig", lambda: small)
        import_run(asked, root / "run", execution=TaskExecution(executor="inline", quiet=True))
    return root / "run"


@pytest.fixture
def run(bare, tmp_path) -> Run:
    """A copy to write verdicts into."""
    import shutil

    return Run.open(shutil.copytree(bare, tmp_path / "run"))


def judge(run: Run, protocol: str, test: str, tasks=None, seed=0) -> dict[str, dict]:
    """Write made verdicts of some tasks; give them by grasp id."""
    given = {}
    rng = np.random.default_rng(seed)
    for task in tasks if tasks is not None else run.tasks:
        batch = run.task_batch(task)
        made = made_verdicts(batch, rng)
        made["direction"][:] = np.where(made["success"], -1, 3)
        rows = verdict_batch(batch.header, batch["grasp_id"], made)
        path = shard_path(run.stage_folder("validate", protocol, test), task.task_id)
        write_shard(path, rows.to_arrow(), verdict_fingerprint(run, load_protocol(protocol), test))
        for i, grasp_id in enumerate(batch["grasp_id"].tolist()):
            given[grasp_id] = {k: v[i] for k, v in made.items()}
    return given


def read(path: Path) -> list[dict]:
    return pq.read_table(path).to_pylist()


def test_columns_are_all_scalars_of_the_field_table():
    columns = flat_columns()
    names = [c.name for c in columns]
    assert len(set(names)) == len(names)
    for field in FIELDS.values():
        there = [c for c in columns if c.field is field]
        if field.axes or field.table not in ("grasps", "verdicts", "arms"):
            assert not there, field.name
        elif field.table in ("grasps", "arms") or field.name in flat.OF_GRASP:
            assert [c.name for c in there] == [field.name]
        else:
            assert [c.test for c in there] == ["f", "l", "a"]
    known = {"grasp_id", "source_ref", "size", "suc_f", "suc_l", "suc_a", "drift_pos_f", "pd"}
    assert known < set(names)
    assert set(flat_schema().names) == {*names, "protocol", "rig"}


def test_a_run_without_verdicts_has_empty_verdicts(bare, tmp_path):
    report = write_table(bare, tmp_path / "t.parquet", quiet=True)
    rows = read(tmp_path / "t.parquet")
    assert (report.rows, report.kind, report.protocol) == (N, "run", "")
    assert len(rows) == N
    columns = flat_columns()
    for row in rows:
        assert all(row[c.name] is None for c in columns if c.field.table == "verdicts")
        assert row["protocol"] is row["energy_qp"] is row["seed"] is None
        assert row["synth_status"] == "ok"
        assert row["selected"] is True
        assert row["audit"] is False
        assert row["source_ref"].startswith("graspdata/")
        assert row["size"] == pytest.approx(row["size_mm"] / 1000, abs=0.00051)


def test_a_row_says_what_the_shards_say_and_nothing_of_untested_ones(run, tmp_path):
    given = judge(run, "paper-1", "f", run.tasks[:1])
    report = write_table(run.path, tmp_path / "t.parquet", quiet=True)
    assert report.protocol == "paper-1"
    rows = read(tmp_path / "t.parquet")
    assert [r["grasp_id"] for r in rows] == [
        i for b in run.batches() for i in b["grasp_id"].tolist()
    ]
    tested = [r for r in rows if r["suc_f"] is not None]
    assert {r["grasp_id"] for r in tested} == set(given)
    assert 0 < len(tested) < len(rows)
    for row in rows:
        if row not in tested:
            assert row["pd"] is row["verdict_status_f"] is row["drift_pos_f"] is None
            continue
        made = given[row["grasp_id"]]
        assert row["suc_f"] == made["success"]
        assert row["verdict_status_f"] == Status(int(made["verdict_status"])).label
        assert row["direction_f"] == (None if made["success"] else 3)
        assert row["drift_pos_f"] == made["drift_pos"]
        assert row["pd"] == made["pd"]
        assert row["contact_number"] == 8
        assert row["time_f"] is row["q1"] is row["suc_l"] is row["verdict_status_a"] is None
        assert row["protocol"] == "paper-1"


def test_metrics_of_a_row_are_of_the_first_test_that_was_run_on_it(run, tmp_path):
    first = judge(run, "paper-1", "f", run.tasks[:1])
    second = judge(run, "paper-1", "l", seed=1)
    write_table(run.path, tmp_path / "t.parquet", quiet=True)
    for row in read(tmp_path / "t.parquet"):
        made = first.get(row["grasp_id"], second[row["grasp_id"]])
        assert row["pd"] == made["pd"]
        assert (row["suc_f"] is None) == (row["grasp_id"] not in first)


def test_csv_has_the_same_cells_with_nothing_for_none(run, tmp_path):
    judge(run, "paper-1", "f", run.tasks[:1])
    write_table(run.path, tmp_path / "t.csv", quiet=True)
    write_table(run.path, tmp_path / "t.parquet", quiet=True)
    with open(tmp_path / "t.csv", newline="") as stream:
        cells = list(csv.DictReader(stream))
    table = pq.read_table(tmp_path / "t.parquet")
    assert list(cells[0]) == table.column_names
    for field in table.schema:
        values, texts = table.column(field.name).to_pylist(), [c[field.name] for c in cells]
        for value, text in zip(values, texts, strict=True):
            if value is None:
                assert text == ""
            elif pa.types.is_boolean(field.type):
                assert text == str(value).lower()
            elif pa.types.is_floating(field.type):
                assert np.float32(text) == np.float32(value)
            else:
                assert text == str(value)


def test_the_same_input_gives_the_same_bytes(run, tmp_path):
    judge(run, "paper-1", "f")
    for ending in ("csv", "parquet"):
        paths = [tmp_path / f"{k}.{ending}" for k in "ab"]
        for path in paths:
            write_table(run.path, path, quiet=True)
        assert paths[0].read_bytes() == paths[1].read_bytes()


def test_of_several_protocols_one_must_be_meant(run, tmp_path):
    other = judge(run, "dexgraspbench-1", "f", seed=1)
    out = tmp_path / "t.parquet"
    assert write_table(run.path, out, quiet=True).protocol == "dexgraspbench-1"
    judge(run, "paper-1-density25", "f", seed=2)
    with pytest.raises(NotUsable, match=r"several protocols.*dexgraspbench-1, paper-1-density25"):
        write_table(run.path, out, quiet=True)
    judge(run, "paper-1", "f", seed=3)
    assert write_table(run.path, out, quiet=True).protocol == "paper-1"
    report = write_table(run.path, out, protocol="dexgraspbench-1", quiet=True)
    assert report.protocol == "dexgraspbench-1"
    for row in read(out):
        assert row["pd"] == other[row["grasp_id"]]["pd"]
        assert row["protocol"] == "dexgraspbench-1"
    with pytest.raises(UnknownName, match="protocol with verdicts here"):
        write_table(run.path, out, protocol="paper-2", quiet=True)


def test_a_release_gives_every_row_once_selected_first(tmp_path):
    root = made_release(tmp_path / "r")
    report = write_table(root, tmp_path / "t.parquet", quiet=True)
    rows = read(tmp_path / "t.parquet")
    ids = [r["grasp_id"] for r in rows]
    assert len(set(ids)) == len(ids) == report.rows
    release = Release.open(root)
    selected, audit = release.grasps(), release.grasps(configuration="audit")
    assert set(ids) == {*selected["grasp_id"].tolist(), *audit["grasp_id"].tolist()}
    assert [r["selected"] for r in rows] == sorted((r["selected"] for r in rows), reverse=True)
    by_id = {r["grasp_id"]: r for r in rows}
    for batch in (selected, audit):
        for i, grasp_id in enumerate(batch["grasp_id"].tolist()):
            row = by_id[grasp_id]
            assert row["size"] == batch["size"][i]
            assert row["suc_f"] == batch["success"][i]
            assert row["suc_l"] is None
            assert row["verdict_status_f"] == Status(int(batch["verdict_status"][i])).label
            assert row["synth_status"] == Status(int(batch["synth_status"][i])).label
            assert (row["pd"] is None) == np.isnan(batch["pd"][i])
            assert row["source_ref"] is None
    count = 3 * len(SIZES) * (2 * PER_RELEASE_SCENE - 1)
    assert len(rows) == count


def test_untested_rows_of_a_release_are_empty_and_old_releases_have_sizes(tmp_path):
    root = made_release(tmp_path / "r", tested=False)
    as_schema_1_0(root)
    write_table(root, tmp_path / "t.parquet", quiet=True)
    for row in read(tmp_path / "t.parquet"):
        assert row["suc_f"] is row["verdict_status_f"] is row["pd"] is None
        assert row["size"] == np.float32(row["size_mm"] / 1000)


def test_a_library_gives_a_row_per_input(bare, tmp_path):
    report = write_table(bare / "library", tmp_path / "t.csv", quiet=True)
    assert (report.kind, report.rows) == ("library", len(OBJECTS))
    with open(tmp_path / "t.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert sorted(r["source_name"] for r in rows) == sorted(OBJECTS)
    for row in rows:
        assert row["status"] == "ok"
        assert row["object_id"].startswith(row["source_name"].lower())
        assert row["licence"] == "unknown"
        assert row["piece_method"] == "given"
    with pytest.raises(NotUsable, match="no verdicts of 'paper-1'"):
        write_table(bare / "library", tmp_path / "t.csv", protocol="paper-1")


def test_what_cannot_be_written_is_one_sentence(bare, tmp_path):
    with pytest.raises(BadConfig, match=r"one of \.csv, \.parquet"):
        write_table(bare, tmp_path / "t.xlsx")
    with pytest.raises(PathNotFound):
        write_table(tmp_path / "no", tmp_path / "t.csv")
