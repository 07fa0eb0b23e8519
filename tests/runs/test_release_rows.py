"""Rows of a release found by index columns are those that reading everything finds."""

from __future__ import annotations

import itertools
import shutil
from dataclasses import replace

import numpy as np
import pytest
from made_release import OBJECTS, PAPER_F, made_release, made_rows, made_verdicts

from bidexdata.errors import Contradiction
from bidexdata.formats import parquet
from bidexdata.formats.hdf5 import TRAINING_FILE
from bidexdata.formats.release import Release
from bidexdata.record import Status
from bidexdata.runs.browse import open_browsable, rows_by_test, verdicts_of
from bidexdata.runs.release_rows import KEPT, NO_POSE, OUTCOMES, RowFilter

OTHER_L = ("other-1", "l")


def rows_of(object_id):
    rows = made_rows(object_id, seed=3)
    other = made_verdicts(rows.batch, np.random.default_rng(5))
    other["verdict_status"][other["verdict_status"] == Status.SLIP] = Status.NOT_LIFTED
    return [replace(rows, verdicts={**rows.verdicts, OTHER_L: other})]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Row groups of three rows, so that every object has several."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parquet, "ROW_GROUP", 3)
        patch.setattr(parquet, "ROWS_PER_FILE", 8)
        out = tmp_path_factory.mktemp("rows") / "release"
        yield made_release(out, rows_of=rows_of, tests=[PAPER_F, OTHER_L])


@pytest.fixture(scope="module", params=["both", "parquet", "hdf5"])
def shown(path, request, tmp_path_factory):
    if request.param == "hdf5":
        out = tmp_path_factory.mktemp("hdf5") / "release"
        return made_release(out, rows_of=rows_of, tests=[PAPER_F, OTHER_L], form="hdf5")
    if request.param == "parquet":
        path = shutil.copytree(path, tmp_path_factory.mktemp("parquet") / "release")
        (path / TRAINING_FILE).unlink()
    return path


def expected(batch, object_id, wanted: RowFilter) -> list[str]:
    """Ids of an object's rows that match, by looking at every one."""
    synth = batch["synth_status"]
    keep = np.ones(len(batch), bool)
    if wanted.text not in object_id or wanted.category not in (None, object_id.split("-")[0]):
        return []
    if wanted.reason not in NO_POSE:
        keep &= ~np.isin(synth, NO_POSE)
    if wanted.size_mm:
        keep &= batch["size_mm"] == wanted.size_mm
    if wanted.outcome != "all":
        keep &= verdicts_of(batch) == {"passed": 1, "failed": 0, "not tested": -1}[wanted.outcome]
    if wanted.reason is not None:
        keep &= (synth == wanted.reason) | (batch["verdict_status"] == wanted.reason)
    if wanted.kept != "all":
        keep &= batch[wanted.kept]
    return sorted(batch["grasp_id"][keep].tolist())


FILTERS = [
    RowFilter(test=test, outcome=outcome, reason=reason, kept=kept, size_mm=size, text=text)
    for test, outcome, reason, kept, size, text in itertools.product(
        ("f", "l"),
        OUTCOMES,
        (None, Status.SLIP, Status.NOT_LIFTED, Status.NO_PLACEMENT, Status.CONTACT_LOST),
        KEPT,
        (None, 500),
        ("", "a-c"),
    )
]


@pytest.mark.parametrize(("protocol", "test"), [PAPER_F, OTHER_L])
def test_the_index_finds_what_reading_every_row_finds(shown, monkeypatch, protocol, test):
    monkeypatch.setattr(parquet, "ROW_GROUP", 3)
    source = open_browsable(shown, protocol)
    index = source.index()
    assert source.tests == (test,)
    stored = {object_id: rows_by_test(source, object_id)[test] for object_id in OBJECTS}
    every = range(sum(len(release_rows) for release_rows in map(source.release.index, KEPT[1:])))
    read = [index.read(row, test) for row in every]
    ids = [str(batch["grasp_id"][0]) for batch in read]
    sizes = [int(batch["size_mm"][0]) for batch in read]
    some = 0
    for wanted in [*FILTERS, RowFilter(test=test, category="flat")]:
        if wanted.test != test:
            continue
        found = index.find(wanted)
        for number, object_id in enumerate(OBJECTS):
            rows = index.rows(found, object_id)
            same = expected(stored[object_id], object_id, wanted)
            assert sorted(ids[row] for row in rows) == same, wanted
            assert found.counts[number] == len(rows)
            assert [sizes[row] for row in rows] == sorted(sizes[row] for row in rows)
        some += found.total > 0
    assert some > 30


def same_values(a, b) -> bool:
    if a.dtype.kind == "f":
        return a.dtype == b.dtype and a.tobytes() == b.tobytes()
    return np.array_equal(a, b)


def test_a_row_read_by_its_row_group_is_the_stored_row(shown, monkeypatch):
    monkeypatch.setattr(parquet, "ROW_GROUP", 3)
    source = open_browsable(shown)
    index = source.index()
    for object_id in OBJECTS:
        stored = source.grasps(object_id)
        at = {str(name): k for k, name in enumerate(stored["grasp_id"])}
        found = index.find(RowFilter())
        for row in index.rows(found, object_id):
            one = index.read(row, "f")
            same = stored.select(slice(at[str(one["grasp_id"][0])], None)).select(slice(0, 1))
            assert set(one.columns) == set(same.columns)
            for name, values in one.columns.items():
                assert same_values(values, same[name]), name
            assert index.rows_named(str(one["grasp_id"][0])) == [(row, str(one["grasp_id"][0]))]


def test_finding_reads_no_text_and_one_grasp_one_row_group(path, monkeypatch):
    monkeypatch.setattr(parquet, "ROW_GROUP", 3)
    read = []
    plain = parquet.read_groups

    def watched(file, columns=None, groups=None):
        read.append((file.relative_to(path).as_posix(), columns, groups))
        return plain(file, columns, groups)

    monkeypatch.setattr(parquet, "read_groups", watched)
    index = open_browsable(path).index()
    found = index.find(RowFilter(outcome="failed"))
    assert {name for name, _, _ in read} <= {"scenes.parquet", "objects.parquet"}
    index.find(RowFilter(reason=Status.SLIP))
    rows = [columns for name, columns, _ in read if name.startswith(("grasps", "verdicts"))]
    assert rows
    assert all(columns == ["verdict_status"] for columns in rows)
    read.clear()
    index.read(index.rows(found, OBJECTS[1])[0], "f")
    assert sorted(name.split("/")[0] for name, _, _ in read) == ["contacts", "grasps", "verdicts"]
    assert all(len(groups) == 1 for _, _, groups in read)


def test_reasons_are_those_that_occur(path):
    index = open_browsable(path).index()
    assert set(index.reasons) == {Status.NO_PLACEMENT, Status.SLIP, Status.NOT_LIFTED}
    assert index.sizes_mm == (300, 500)
    assert index.categories == ("box", "flat", "tetra")


def test_a_damaged_training_form_is_named(path, tmp_path):
    broken = shutil.copytree(path, tmp_path / "release")
    (broken / TRAINING_FILE).write_bytes(b"no such thing")
    index = open_browsable(broken).index()
    with pytest.raises(Contradiction, match=TRAINING_FILE):
        index.find(RowFilter())


def test_a_release_without_rows_is_open_and_finds_nothing(tmp_path):

    def none_of(object_id):
        rows = made_rows(object_id)
        return [replace(rows, batch=rows.batch.select(slice(0, 0)), verdicts={})]

    empty = made_release(tmp_path / "release", rows_of=none_of, tests=[])
    index = open_browsable(empty).index()
    assert index.find(RowFilter()).total == 0
    assert len(Release.open(empty).index()) == 0
