"""All rows of a release, object by object, each row once and with all its verdicts.

A release holds a row that is selected and an audit row twice, in two tables; here it comes once.
What is held in memory is the rows of one object and a row group of each table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.errors import Contradiction
from bidexdata.formats.row_groups import aligned
from bidexdata.formats.rows import TestKey
from bidexdata.formats.tables import GRASP_COLUMNS, VERDICT_COLUMNS
from bidexdata.record import GraspBatch

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.formats.release import Release


class StoredRows(NamedTuple):
    """The rows of one object in one split: selected rows, then the other audit rows."""

    object_id: str
    scenes: tuple[Mapping[str, object], ...]
    """Rows of scenes.parquet, those without a grasp included."""
    batch: GraspBatch
    """Columns of the grasps table."""
    run: np.ndarray
    """Name of the run of each row, (N,)."""
    verdicts: Mapping[TestKey, Mapping[str, np.ndarray]]
    """Columns of each verdict table."""
    tested: Mapping[TestKey, np.ndarray]
    """Rows that the test was run on, (N,)."""


def stored_rows(release: Release) -> Iterator[StoredRows]:
    """Yield the objects of every split in the order of the tables.

    Raises:
        Contradiction: The tables have other rows than scenes.parquet.
    """
    scenes = release.scenes.to_pylist()
    for split in release.split_names:
        streams = {c: _Stream(release, c, split) for c in release.configurations}
        objects: dict[str, list[dict]] = {}
        for scene in scenes:
            if scene["split"] == split:
                objects.setdefault(scene["object_id"], []).append(scene)
        for object_id, mine in objects.items():
            parts = []
            for configuration, stream in streams.items():
                rows = stream.take(sum(scene[f"{configuration}_rows"] for scene in mine))
                again = configuration != "selected" and "selected" in release.configurations
                parts.append(rows.without_selected() if again else rows)
            yield _joined(release, object_id, tuple(mine), parts)


class _Rows(NamedTuple):
    grasps: pa.Table
    judged: tuple[pa.Table, ...]

    def without_selected(self) -> _Rows:
        import pyarrow as pa

        others = pa.array(~self.grasps.column("selected").to_numpy())
        return _Rows(self.grasps.filter(others), tuple(t.filter(others) for t in self.judged))


class _Stream:
    """The rows of one configuration and split, taken in order.

    State: the row groups to come, and the rows of the last one that were not taken yet.
    """

    def __init__(self, release: Release, configuration: str, split: str):
        self._where = f"{configuration} rows of split {split}"
        self._groups = _row_groups(release, configuration, split)
        self._waiting = next(self._groups)  # a table without rows still gives its schema

    def take(self, n: int) -> _Rows:
        """The next n rows."""
        import pyarrow as pa

        parts, missing = [], n
        while missing > self._waiting.grasps.num_rows:
            parts.append(self._waiting)
            missing -= self._waiting.grasps.num_rows
            following = next(self._groups, None)
            if following is None:
                raise Contradiction(f"scenes.parquet has more {self._where} than the tables")
            self._waiting = following
        parts.append(_sliced(self._waiting, 0, missing))
        self._waiting = _sliced(self._waiting, missing, None)
        tables = zip(*([p.grasps, *p.judged] for p in parts), strict=True)
        grasps, *judged = [pa.concat_tables(t) for t in tables]
        return _Rows(grasps, tuple(judged))


def _row_groups(release: Release, configuration: str, split: str) -> Iterator[_Rows]:
    grasps = [*(n for n in GRASP_COLUMNS if not release.header.lacks(n)), "run"]
    judged = {"verdicts/" + "-".join(key): None for key in release.protocols}
    for first, *others in aligned(release, {"grasps": grasps, **judged}, configuration, split):
        yield _Rows(first, tuple(others))


def _sliced(rows: _Rows, low: int, n: int | None) -> _Rows:
    return _Rows(rows.grasps.slice(low, n), tuple(t.slice(low, n) for t in rows.judged))


def _joined(
    release: Release, object_id: str, scenes: tuple[dict, ...], parts: list[_Rows]
) -> StoredRows:
    import pyarrow as pa

    grasps = pa.concat_tables([p.grasps for p in parts])
    batch = GraspBatch.from_arrow(grasps.drop_columns(["run"]))
    if np.any(batch["object_id"] != object_id):
        raise Contradiction(f"rows of {object_id} are not where scenes.parquet has them")
    verdicts, tested = {}, {}
    for i, key in enumerate(release.protocols):
        table = pa.concat_tables([p.judged[i] for p in parts])
        tested[key] = table.column("success").is_valid().to_numpy()
        at = table.schema.get_field_index("success")
        filled = table.set_column(at, "success", table.column("success").fill_null(False))
        found = GraspBatch.from_arrow(filled)
        verdicts[key] = {n: found[n] for n in VERDICT_COLUMNS if n in found}
    run = np.array(grasps.column("run").to_pylist(), str)
    return StoredRows(object_id, scenes, batch, run, verdicts, tested)
