"""Stored rows of a release found by its index columns alone, and one row read by its row group.

Scene, object and size of every row follow from the scenes table (`RowIndex`); what became of it is
in integer columns of a byte a row, mapped from the training form where there is one. No text
column is read: ten million rows are open in a moment and take tens of megabytes.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Bool, Int

from bidexdata.formats import parquet
from bidexdata.formats.release import Release
from bidexdata.formats.row_columns import byte_column
from bidexdata.formats.row_index import RowIndex
from bidexdata.formats.table_join import join_tables
from bidexdata.formats.tables import GRASP_COLUMNS
from bidexdata.record import GraspBatch
from bidexdata.record.status import Status

if TYPE_CHECKING:
    import pyarrow as pa

Outcome = Literal["all", "passed", "failed", "not tested"]
Kept = Literal["all", "selected", "audit"]
OUTCOMES: tuple[Outcome, ...] = ("all", "passed", "failed", "not tested")
KEPT: tuple[Kept, ...] = ("all", "selected", "audit")

SYNTH_FAILURES = tuple(s for s in Status if 20 <= s < 50)
TEST_FAILURES = tuple(s for s in Status if s > Status.NOT_RUN)
NO_POSE = (Status.NO_REGION_PAIR, Status.NO_PLACEMENT, Status.NOT_FINITE)
"""Attempts that end so have no pose that could be shown."""

_CACHED_GROUPS = 12
"""Row groups of one table kept decoded: about 10 MB each."""
_TESTED = {"passed": 1, "failed": 0, "not tested": -1}


@dataclass(frozen=True, slots=True, kw_only=True)
class RowFilter:
    """Which rows are wanted; every condition must hold."""

    text: str = ""
    """Part of the object's id or category, in any case of letters."""
    category: str | None = None
    """Category of the object."""
    size_mm: int | None = None
    """Size of the scene [mm]."""
    test: str = "f"
    """Test that `outcome` and `reason` are of."""
    outcome: Outcome = "all"
    """What the test said; an attempt that failed before any test has failed it."""
    reason: Status | None = None
    """Why synthesis or the test failed."""
    kept: Kept = "all"
    """`selected` or `audit` rows."""


@dataclass(frozen=True)
class FoundRows:
    """Rows that match a filter; numbers are those of `ReleaseRowsIndex`."""

    counts: Int[np.ndarray, " K"]
    """Matching rows of each object of the release."""
    masks: tuple[Bool[np.ndarray, " N"], ...]
    """Which rows match, per configuration."""

    @property
    def total(self) -> int:
        """Number of rows."""
        return int(self.counts.sum())


class ReleaseRowsIndex:
    """Rows of a release: those of `selected`, then those of `audit`, numbered on."""

    def __init__(self, release: Release, protocol: str, tests: tuple[str, ...]):
        """Read the scenes table.

        Args:
            release: Opened.
            protocol: Whose verdicts are meant.
            tests: Tests of it that have verdicts.
        """
        self.release, self.protocol, self.tests = release, protocol, tests
        self._parts = [_Rows(release, c, protocol) for c in release.configurations]
        self._first = np.cumsum([0, *(len(p.index) for p in self._parts)]).tolist()
        self._groups: OrderedDict[tuple[str, str, int], pa.Table] = OrderedDict()

    @cached_property
    def categories(self) -> tuple[str, ...]:
        """Category of each object."""
        return tuple(c or "" for c in self.release.objects.column("category").to_pylist())

    @cached_property
    def sizes_mm(self) -> tuple[int, ...]:
        """Sizes that there are scenes of [mm]."""
        return tuple(np.unique(self.release.scenes.column("size_mm").to_numpy()).tolist())

    @cached_property
    def reasons(self) -> tuple[Status, ...]:
        """Failures that some attempt ended with, as the manifest says."""
        said = [self.release.figures, *self.release.other_figures.values()]
        labels = {label for figures in said for label in figures.get("by_status", {})}
        for figures in said:
            for test in figures.get("tests", {}).values():
                labels |= set(test.get("by_verdict", {}))
        return tuple(s for s in (*SYNTH_FAILURES, *TEST_FAILURES) if s.label in labels)

    def find(self, wanted: RowFilter) -> FoundRows:
        """Find the rows that match; rows without a pose only where their reason is asked for."""
        objects = objects_matching(self.release.object_ids, self.categories, wanted)
        counts = np.zeros(len(objects), np.int64)
        masks = []
        for part in self._parts:
            mask = part.matching(objects, wanted)
            per_scene = part.sums(mask)
            np.add.at(counts, part.index.scene_objects, per_scene)
            masks.append(mask)
        return FoundRows(counts, tuple(masks))

    def rows(self, found: FoundRows, object_id: str) -> list[int]:
        """Matching rows of one object, ordered by size, then as stored."""
        number, sized = self.release.object_ids.index(object_id), []
        for part, mask, first in zip(self._parts, found.masks, self._first, strict=False):
            for scene in np.flatnonzero(part.index.scene_objects == number).tolist():
                low, high = part.index.scene_range(scene)
                rows = low + np.flatnonzero(mask[low:high])
                sized += [(int(part.scene_sizes[scene]), first + r) for r in rows.tolist()]
        return [row for _, row in sorted(sized, key=lambda pair: pair[0])]

    def read(self, row: int, test: str = "") -> GraspBatch:
        """Read one row, its contacts and the verdict of one test, by their row groups.

        Raises:
            Contradiction: A page is damaged, or the tables do not hold the same rows.
        """
        which = int(np.searchsorted(self._first, row, side="right")) - 1
        part, at = self._parts[which], row - self._first[which]
        tables: dict[str, list[str] | None] = {
            "grasps": [n for n in GRASP_COLUMNS if not self.release.header.lacks(n)],
            "contacts": None,
        }
        if (self.protocol, test) in self.release.protocols:
            tables[f"verdicts/{self.protocol}-{test}"] = None
        rows = [self._row(part, at, table, columns) for table, columns in tables.items()]
        files = [self.release.path / table for table in tables]
        return join_tables(self.release.header, files, rows)

    def rows_named(self, digits: str) -> list[tuple[int, str]]:
        """Rows whose id begins so, and the ids; reads the ids, group by group, and keeps none."""
        found: list[tuple[int, str]] = []
        for part, first in zip(self._parts, self._first, strict=False):
            found += [(first + row, name) for row, name in part.named(digits)]
        ids: dict[str, int] = {}
        for row, name in found:  # a row of both configurations is one grasp
            ids.setdefault(name, row)
        return [(row, name) for name, row in ids.items()]

    def _row(self, part: _Rows, at: int, table: str, columns: list[str] | None) -> pa.Table:
        (piece,) = part.index.pieces(at, at + 1)
        first = at - piece.skip
        key = (part.configuration, table, first)
        if key not in self._groups:
            group = part.index.pieces(first, first + parquet.ROW_GROUP)[0]
            last = first + group.high - group.low
            self._groups[key] = part.index.read(first, last, table, columns)
            while len(self._groups) > _CACHED_GROUPS:
                self._groups.popitem(last=False)
        self._groups.move_to_end(key)
        return self._groups[key].slice(piece.skip, 1)


def objects_matching(
    object_ids: tuple[str, ...], categories: tuple[str, ...], wanted: RowFilter
) -> Bool[np.ndarray, " K"]:
    """Which objects match the text and the category of a filter."""
    text = wanted.text.strip().lower()
    return np.array(
        [
            (text in object_id.lower() or text in category.lower())
            and wanted.category in (None, category)
            for object_id, category in zip(object_ids, categories, strict=True)
        ],
        bool,
    )


class _Rows:
    """Rows of one configuration and the columns of a byte a row, read when they are first asked for."""

    def __init__(self, release: Release, configuration: str, protocol: str):
        self.release, self.configuration, self.protocol = release, configuration, protocol
        self.index = RowIndex(release, configuration)
        self.scene_sizes = release.scenes.column("size_mm").to_numpy()[self.index.scene_rows]
        self._columns: dict[tuple[str, str], Int[np.ndarray, " N"]] = {}

    def matching(
        self, objects: Bool[np.ndarray, " K"], wanted: RowFilter
    ) -> Bool[np.ndarray, " N"]:
        """Which rows match; of `audit`, those that `selected` has too only where asked for."""
        if wanted.kept not in ("all", self.configuration):
            return np.zeros(len(self.index), bool)
        scenes = objects[self.index.scene_objects]
        if wanted.size_mm is not None:
            scenes &= self.scene_sizes == wanted.size_mm
        mask = np.repeat(scenes, self.index.counts)
        if self.configuration != "selected" and wanted.kept == "all":
            mask &= self.column("selected") != 1
        synth = self.column("synth_status")
        if wanted.reason in SYNTH_FAILURES:
            mask &= synth == wanted.reason
        else:
            for status in NO_POSE:
                mask &= synth != status
        if wanted.outcome != "all":
            mask &= self.outcome(wanted.test) == _TESTED[wanted.outcome]
        if wanted.reason in TEST_FAILURES:
            mask &= (synth == Status.OK) & (self.verdict(wanted.test) == wanted.reason)
        return mask

    def sums(self, mask: Bool[np.ndarray, " N"]) -> Int[np.ndarray, " S"]:
        """Rows of the mask in each scene."""
        out = np.zeros(len(self.index.counts), np.int64)
        some = self.index.counts > 0
        if some.any():
            starts = (self.index.ends - self.index.counts)[some]
            out[some] = np.add.reduceat(mask, starts, dtype=np.int64)
        return out

    def outcome(self, test: str) -> Int[np.ndarray, " N"]:
        """What a test said of each row: 1 passed, 0 failed (also before it), -1 not tested."""
        if self.protocol == self.release.default_protocol:
            outcome = self.column(f"suc_{test}").copy()
        else:
            status = self.verdict(test)
            outcome = (status == Status.OK).astype(np.int8)
            outcome[(status == Status.NOT_RUN) | (status < 0)] = -1
        outcome[self.column("synth_status") != Status.OK] = 0
        return outcome

    def verdict(self, test: str) -> Int[np.ndarray, " N"]:
        """`verdict_status` of a test; that of no test where it was not run."""
        if (self.protocol, test) not in self.release.protocols:
            return np.full(len(self.index), Status.NOT_RUN, np.int8)
        return self.column("verdict_status", f"verdicts/{self.protocol}-{test}")

    def column(self, name: str, table: str = "grasps") -> Int[np.ndarray, " N"]:
        """A column of all rows, read once."""
        if (table, name) not in self._columns:
            found = byte_column(self.release, self.configuration, name, table)
            self._columns[table, name] = found
        return self._columns[table, name]

    def named(self, digits: str) -> Iterator[tuple[int, str]]:
        """Rows whose id begins so, and the ids."""
        import pyarrow.compute as pc

        first = 0
        for table in self.release.row_groups("grasps", self.configuration, None, ["grasp_id"]):
            ids = table.column("grasp_id")
            begins = pc.starts_with(ids, digits)  # pyright: ignore[reportAttributeAccessIssue]  (made at import)
            hits = np.flatnonzero(begins.to_numpy(zero_copy_only=False))
            for at in hits.tolist():
                yield first + at, str(ids[at])
            first += table.num_rows
