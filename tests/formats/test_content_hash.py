"""Equal content has one hash, whatever holds it; anything else has another."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from made_release import OBJECTS, made_release, made_rows

from bidexdata.formats import content_hash as content
from bidexdata.formats import parquet
from bidexdata.formats.content_hash import ContentTally, content_hash
from bidexdata.formats.release import Release


@pytest.mark.parametrize("form", ["both", "parquet", "hdf5"])
def test_every_form_has_the_hash_that_the_writer_took(packed, tmp_path, form):
    out = made_release(tmp_path / "r", form=form)
    stated = Release.open(packed).manifest["content_hash"]
    assert Release.open(out).manifest["content_hash"] == stated
    assert content_hash(Release.open(out)) == stated


def test_cuts_of_files_and_row_groups_change_nothing(packed, tmp_path, monkeypatch):
    monkeypatch.setattr(parquet, "ROW_GROUP", 5)
    monkeypatch.setattr(parquet, "ROWS_PER_FILE", 5)
    out = Release.open(made_release(tmp_path / "r"))
    whole = Release.open(packed)
    assert len(out.table_files("grasps", "selected")) > len(whole.table_files("grasps", "selected"))
    assert content_hash(out) == content_hash(whole)


def test_the_version_of_the_package_changes_nothing(tmp_path, packed, monkeypatch):
    monkeypatch.setattr("bidexdata.formats.writer._package_version", lambda: "9.9.9")
    out = Release.open(made_release(tmp_path / "r"))
    assert out.manifest["generator"]["version"] == "9.9.9"
    assert content_hash(out) == Release.open(packed).manifest["content_hash"]


@pytest.mark.parametrize("column", ["joints", "grasp_id", "success", "contact_index", "attempt"])
def test_one_changed_value_changes_the_hash(tmp_path, packed, column):
    def changed(object_id):
        rows = made_rows(object_id)
        if object_id != OBJECTS[0]:
            return [rows]
        held = rows.batch.columns if column in rows.batch else rows.verdicts["paper-1", "f"]
        values = held[column].copy()
        at = (0,) * values.ndim
        values[at] = "0" * 16 if column == "grasp_id" else values[at] == 0
        if column == "success":
            return [replace(rows, verdicts={("paper-1", "f"): {**held, column: values}})]
        batch = replace(rows.batch, columns={**held, column: values})
        return [replace(rows, batch=batch)]

    out = Release.open(made_release(tmp_path / "r", rows_of=changed))
    assert content_hash(out) != Release.open(packed).manifest["content_hash"]


def test_the_hash_is_what_the_page_says():
    table = pa.table(
        {
            "x": pa.array([1.5, None], pa.float32()),
            "name": pa.array(["é", "b"], pa.string()),
            "ok": pa.array([True, False]),
        }
    )

    def sha(data: bytes) -> str:
        return hashlib.sha256(data).hexdigest()

    both = sha(b"\1\1")
    lines = [
        f"t name 2 {both} {sha('éb'.encode())} {sha(np.array([2, 1], '<u4').tobytes())}",
        f"t ok 2 {both} {sha(bytes([1, 0]))}",
        f"t x 2 {sha(bytes([1, 0]))} {sha(np.array([1.5, 0], '<f4').tobytes())}",
    ]
    for cut in (0, 1, 2):
        tally = ContentTally()
        for part in (table.slice(0, cut), table.slice(cut)):
            tally.add("t", part)
        assert tally.lines() == lines
        assert tally.digest() == sha("".join(f"{line}\n" for line in lines).encode())


def test_text_is_read_where_a_slice_of_it_lies():
    column = pa.array(["ab", "", "größe", "z"]).slice(1, 2)
    lengths, data = content.text_bytes(column)
    assert lengths.tolist() == [0, 7]
    assert data.tobytes().decode() == "größe"
