"""Which rows of a release belong to which scene and object, from the scenes table alone.

Rows of the row tables and of the scenes table are sorted alike, so sums over the scenes of a split
say where each scene's rows lie: no text column of ten million rows is read to find an object.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Int

from bidexdata.errors import UnknownName
from bidexdata.formats import hdf5, parquet
from bidexdata.formats.row_tables import RowTables

if TYPE_CHECKING:
    import pyarrow as pa


class Piece(NamedTuple):
    """Rows of one file: [low, high) of it."""

    part: int
    """Number of the file in `Release.table_files`; of the split where there are none (HDF5)."""
    groups: tuple[int, ...]
    """Row groups that hold the rows."""
    low: int
    high: int
    """Rows of the file."""
    skip: int
    """Rows of the first group that come before `low`."""


class RowIndex:
    """Rows of one configuration and split, or of all splits one after the other."""

    def __init__(
        self, release: RowTables, configuration: str = "selected", split: str | None = None
    ) -> None:
        """Read the scenes table.

        Args:
            release: Opened.
            configuration: `selected` or `audit`.
            split: One split; None takes all in the release's order.
        """
        self._release, self._configuration, self._split = release, configuration, split
        scenes = release.scenes
        of = np.array(scenes.column("split").to_pylist(), str)
        self._names = names = release.split_names if split is None else (split,)
        self.scene_rows: Int[np.ndarray, " S"] = np.concatenate(
            [np.flatnonzero(of == name) for name in names] or [np.zeros(0, np.int64)]
        )
        """Row of the scenes table of every scene, in the order of the rows."""
        counts = scenes.column(f"{configuration}_rows").to_numpy()[self.scene_rows]
        self.ends: Int[np.ndarray, " S"] = np.cumsum(counts, dtype=np.int64)
        """Row behind each scene's last."""
        self.counts: Int[np.ndarray, " S"] = counts.astype(np.int64)
        """Rows of each scene."""

    def __len__(self) -> int:
        """Number of rows."""
        return int(self.ends[-1]) if len(self.ends) else 0

    @cached_property
    def scene_ids(self) -> tuple[str, ...]:
        """Scenes in the order of the rows; some may have none."""
        column = self._release.scenes.column("scene_id")
        return tuple(column.take(self.scene_rows).to_pylist())

    @cached_property
    def scene_objects(self) -> Int[np.ndarray, " S"]:
        """Object of each scene, a number of `Release.object_ids`."""
        numbers = {object_id: k for k, object_id in enumerate(self._release.object_ids)}
        ids = self._release.scenes.column("object_id").take(self.scene_rows).to_pylist()
        return np.array([numbers[object_id] for object_id in ids], np.int64)

    @cached_property
    def scene_index(self) -> Int[np.ndarray, " N"]:
        """Scene of each row, a number of `scene_ids`."""
        return np.repeat(np.arange(len(self.counts), dtype=np.int32), self.counts)

    @cached_property
    def object_index(self) -> Int[np.ndarray, " N"]:
        """Object of each row, a number of `Release.object_ids`."""
        return np.repeat(self.scene_objects.astype(np.int32), self.counts)

    @cached_property
    def size_mm(self) -> Int[np.ndarray, " N"]:
        """Size of each row [mm]."""
        sizes = self._release.scenes.column("size_mm").to_numpy()[self.scene_rows]
        return np.repeat(sizes.astype(np.int32), self.counts)

    @cached_property
    def tabletop(self) -> np.ndarray:
        """Whether each row's scene has a table, (N,) bool."""
        settings = self._release.scenes.column("setting").take(self.scene_rows).to_pylist()
        return np.repeat(np.array([s == "tabletop" for s in settings], bool), self.counts)

    def scene_range(self, scene: int) -> tuple[int, int]:
        """First row of a scene, a number of `scene_ids`, and the row behind its last."""
        end = int(self.ends[scene])
        return end - int(self.counts[scene]), end

    def object_ranges(self, object_id: str) -> list[tuple[int, int]]:
        """Rows of an object; one range per split that holds some.

        Raises:
            UnknownName: The release has no such object.
        """
        ids = self._release.object_ids
        if object_id not in ids:
            raise UnknownName("object", object_id, ids)
        mine = np.flatnonzero(self.scene_objects == ids.index(object_id))
        ranges: list[tuple[int, int]] = []
        for scene in mine.tolist():
            low, high = self.scene_range(scene)
            if ranges and ranges[-1][1] == low:
                low = ranges.pop()[0]
            if high > low:
                ranges.append((low, high))
        return ranges

    def pieces(self, low: int, high: int) -> list[Piece]:
        """Where the rows [low, high) lie in the files of any row table of this configuration."""
        found, start = [], 0
        for part, rows in enumerate(self._file_rows):
            a, b = max(low - start, 0), min(high - start, rows)
            if a < b:
                groups = tuple(range(a // parquet.ROW_GROUP, (b - 1) // parquet.ROW_GROUP + 1))
                found.append(Piece(part, groups, a, b, a - groups[0] * parquet.ROW_GROUP))
            start += rows
        return found

    def read(
        self, low: int, high: int, table: str = "grasps", columns: Sequence[str] | None = None
    ) -> pa.Table:
        """Read the rows [low, high) of a row table, whatever the form of the release.

        Args:
            low: First row.
            high: Row behind the last.
            table: `grasps`, `contacts` or `verdicts/<protocol>-<test>`.
            columns: Which; all when omitted.

        Raises:
            Contradiction: A file is damaged.
        """
        import pyarrow as pa

        release, place = self._release, (self._configuration, self._split)
        files = release.table_files(table, *place)
        found = []
        for piece in self.pieces(low, high):
            if files:
                groups = parquet.read_groups(files[piece.part], columns, piece.groups)
                rows = pa.concat_tables(groups).slice(piece.skip, piece.high - piece.low)
            else:
                where = (self._configuration, self._names[piece.part], piece.low, piece.high)
                rows = release.hdf5_rows(table, *where, columns)
            found.append(rows)
        if not found:
            return next(release.row_groups(table, *place, columns)).slice(0, 0)
        return pa.concat_tables(found)

    @cached_property
    def _file_rows(self) -> list[int]:
        """Rows of each file, from the manifest where it says so, else from the footers."""
        release, listed = self._release, self._release.manifest["files"]
        files = release.table_files("grasps", self._configuration, self._split)
        if not files:
            names = self._names
            return [hdf5.count_rows(release.path, self._configuration, name) for name in names]
        return [_rows_of(release.path, file, listed) for file in files]


def _rows_of(root: Path, file: Path, listed: dict[str, dict[str, int]]) -> int:
    said = listed.get(file.relative_to(root).as_posix(), {}).get("rows")
    return said if said is not None else sum(parquet.row_counts(file))
