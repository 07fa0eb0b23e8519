"""Row tables of a release, row group by row group, whatever the form.

From Parquet with page checksums verified, or from `grasps.h5` where the rows stand in it alone;
`verify.verify_release` is what checks every byte.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.errors import UnknownName
from bidexdata.formats import hdf5, parquet, tables
from bidexdata.formats.release_folder import ReleaseFolder
from bidexdata.formats.tables import CONFIGURATIONS

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class RowTables(ReleaseFolder):
    """The tables of a row per grasp: `grasps`, `contacts`, `arms` and one of verdicts per test."""

    def table_files(self, table: str, configuration: str, split: str | None = None) -> list[Path]:
        """Parquet files of a row table in reading order: splits as in the manifest, then parts.

        None where the rows stand in `grasps.h5` alone; `row_groups` reads either form.

        Args:
            table: `grasps`, `contacts` or `verdicts/<protocol>-<test>`.
            configuration: `selected` or `audit`.
            split: One split; all when omitted.
        """
        self._check_place(configuration, split)
        return [
            path
            for name in self._chosen(split)
            for path in hdf5.split_files(self.path, table, configuration, name)
        ]

    def table_schema(self, table: str, configuration: str = "selected") -> pa.Schema:
        """Arrow schema of a row table, whatever the form.

        Raises:
            Contradiction: The file is damaged.
        """
        files = self.table_files(table, configuration)
        return parquet.read_schema(files[0]) if files else self.own_schema(table)

    def row_groups(
        self,
        table: str,
        configuration: str = "selected",
        split: str | None = None,
        columns: Sequence[str] | None = None,
    ) -> Iterator[pa.Table]:
        """Yield the rows of a row table a row group at a time, in order, whatever the form.

        All row tables of a configuration come in equal groups. There is at least one, which may be
        empty.

        Args:
            table: `grasps`, `contacts` or `verdicts/<protocol>-<test>`.
            configuration: `selected` or `audit`.
            split: One split; all when omitted.
            columns: Which; all when omitted.

        Raises:
            UnknownName: No such split or configuration.
            Contradiction: A file is damaged.
        """
        files = self.table_files(table, configuration, split)
        for file in files:
            yield from parquet.read_groups(file, columns)
        for name in () if files else self._chosen(split):
            rows = hdf5.count_rows(self.path, configuration, name)
            for low in range(0, max(rows, 1), parquet.ROW_GROUP):
                high = min(low + parquet.ROW_GROUP, rows)
                yield self.hdf5_rows(table, configuration, name, low, high, columns)

    def hdf5_rows(
        self,
        table: str,
        configuration: str,
        split: str,
        low: int,
        high: int,
        columns: Sequence[str] | None = None,
    ) -> pa.Table:
        """Read rows [low, high) of one split of a row table from `grasps.h5`, form `hdf5` only."""
        schema = self.own_schema(table)
        if columns is not None:
            fields = [schema.field(name) for name in columns]
            schema = tables.with_fields(schema, fields)
        return hdf5.read_rows(self.path, table, configuration, split, schema, low, high)

    def own_schema(self, table: str) -> pa.Schema:
        """Arrow schema of a row table by the header: the columns that this release has."""
        schema = tables.row_schema(table, self.header)
        return tables.with_fields(schema, [f for f in schema if not self.header.lacks(f.name)])

    def _chosen(self, split: str | None) -> tuple[str, ...]:
        return (split,) if split is not None else self.split_names

    def _check_place(self, configuration: str, split: str | None) -> None:
        if configuration not in CONFIGURATIONS:
            raise UnknownName("configuration", configuration, CONFIGURATIONS)
        if split is not None and split not in self.split_names:
            raise UnknownName("split", split, self.split_names)
