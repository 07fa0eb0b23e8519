"""Statistics of a release are those of its selected rows, component by component."""

from __future__ import annotations

import warnings

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_release import made_release

from bidexdata.errors import Contradiction
from bidexdata.formats import parquet
from bidexdata.formats.release import Release
from bidexdata.formats.statistics import STATISTICS, StatisticsTally, read_statistics

CLOSE = {"rtol": 2e-8, "atol": 1e-12}  # nine digits are stored


@pytest.mark.parametrize("split", ["train", "test"])
def test_they_are_those_of_the_rows(tmp_path, monkeypatch, split):
    monkeypatch.setattr(parquet, "ROW_GROUP", 5)
    release = Release.open(made_release(tmp_path / "r"))
    batch, found = release.grasps(split=split), read_statistics(release, split)
    for name in ("joints", "hand_pos", "size", "contact_point", "pd", "q1", "energy_qp"):
        if name == "q1":
            assert name not in found  # only of one protocol and test
            continue
        values = batch[name].astype(np.float64)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            expected = [f(values, axis=0) for f in (np.nanmean, np.nanstd, np.nanmin, np.nanmax)]
        mine = found[name]
        np.testing.assert_array_equal(mine.n, np.isfinite(values).sum(axis=0))
        for value, right in zip(mine[1:], expected, strict=True):
            np.testing.assert_allclose(value, right, **CLOSE)


@settings(deadline=None, max_examples=50)
@given(
    values=st.lists(st.floats(width=32, allow_subnormal=False), max_size=30),
    cut=st.integers(0, 30),
)
def test_parts_add_up_to_the_whole(values, cut):
    def column(part):
        return pa.table({"x": pa.array(np.array(part, np.float32))})

    whole, parts = StatisticsTally(), StatisticsTally()
    whole.add(column(values))
    for part in (values[:cut], values[cut:]):
        parts.add(column(part))
    a, b = (t.columns()["x"] for t in (whole, parts))
    assert a["count"] == b["count"] == [sum(map(np.isfinite, values))]
    assert (a["min"], a["max"]) == (b["min"], b["max"])
    if a["count"][0]:
        scale = max(abs(v) for v in values if np.isfinite(v)) or 1.0
        for key in ("mean", "std"):
            assert abs(a[key][0] - b[key][0]) <= 1e-7 * scale


def test_they_are_covered_by_the_manifest_and_absent_before_schema_1_3(copied):
    release = Release.open(copied)
    assert STATISTICS in release.manifest["files"]
    (copied / STATISTICS).write_text("{}")
    with pytest.raises(Contradiction, match="damaged statistics"):
        read_statistics(release)
    (copied / STATISTICS).unlink()
    assert read_statistics(release) == {}
