"""Release: read a release folder as batches, tables, solids and clouds.

Three layers, each in terms of the one before: the folder (`ReleaseFolder`: manifest, small tables,
shapes), its row tables (`RowTables`), and here the batches that users ask for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from bidexdata.errors import Contradiction, NotUsable, UnknownName
from bidexdata.formats import tables
from bidexdata.formats.row_index import RowIndex
from bidexdata.formats.row_tables import RowTables
from bidexdata.formats.table_join import join_tables
from bidexdata.formats.tables import GRASP_COLUMNS
from bidexdata.record import GraspBatch

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Release(RowTables):
    """A release folder, opened; make it with `Release.open`."""

    def row_index(self, configuration: str = "selected", split: str | None = None) -> RowIndex:
        """Which rows belong to which scene and object; made once per configuration and split."""
        self._check_place(configuration, split)
        place = (configuration, split)
        if place not in self._row_indexes:
            self._row_indexes[place] = RowIndex(self, *place)
        return self._row_indexes[place]

    @cached_property
    def _row_indexes(self) -> dict[tuple[str, str | None], RowIndex]:
        return {}

    def index(
        self,
        configuration: str = "selected",
        split: str | None = None,
        columns: Sequence[str] | None = None,
    ) -> pa.Table:
        """Scalar columns of the grasps table: ids, sizes, flags, energies, `suc_*`, metrics."""
        import pyarrow as pa

        self._check_place(configuration, split)
        schema = self.table_schema("grasps", configuration)
        scalar = [f.name for f in schema if not pa.types.is_fixed_size_list(f.type)]
        for name in columns or ():
            if name not in scalar:
                raise UnknownName("scalar column", name, scalar)
        names = list(columns) if columns is not None else scalar
        return pa.concat_tables(self.row_groups("grasps", configuration, split, names))

    def grasps(
        self,
        object_id: str | None = None,
        *,
        size_mm: int | None = None,
        split: str | None = None,
        configuration: str = "selected",
        protocol: str | None = None,
        test: str = "f",
    ) -> GraspBatch:
        """Read grasps with their contacts and, where there are some, the verdicts of one test.

        Args:
            object_id: One object; all when omitted.
            size_mm: One size; all when omitted.
            split: One split; all when omitted.
            configuration: `selected` or `audit`.
            protocol: Protocol of the verdict columns; the release's default when omitted.
            test: `f`, `l` or `a`.

        Returns:
            Rows in stored order. Rows that were not tested have `verdict_status` NOT_RUN.
        """
        if object_id is not None:
            self._check_object(object_id)
        parts = [
            batch
            for batch in self.batches(configuration, split, protocol, test, object_id=object_id)
            if len(batch)
        ]
        if size_mm is not None:
            parts = [b.select(b["size_mm"] == size_mm) for b in parts]
        if parts:
            return GraspBatch.concat(parts)
        empty = next(self.batches(configuration, split, protocol, test))
        return empty.select(slice(0, 0))

    def with_arms(self, batch: GraspBatch) -> GraspBatch:
        """Join rows of this release with their arm solutions.

        Args:
            batch: Rows of one object, in any order.

        Raises:
            NotUsable: The release has no arm solutions.
            Contradiction: It has none of a row.
        """
        import pyarrow as pa

        if not self.rig:
            raise NotUsable(
                f"{self.path} has no arm solutions; pack runs that `bidexdata arms` solved"
            )
        table, parts = tables.arms_tables(self.header)[0], []
        for object_id in np.unique(batch["object_id"]).tolist():
            for configuration in self.configurations:
                rows = self.row_index(configuration)
                ranges = rows.object_ranges(object_id)
                parts += [rows.read(low, high, table, None) for low, high in ranges]
        found = pa.concat_tables(parts).to_batches() if parts else []
        solved = GraspBatch.from_arrow(pa.Table.from_batches(found, self.own_schema(table)))
        ids, first = np.unique(solved["grasp_id"], return_index=True)
        at = np.minimum(np.searchsorted(ids, batch["grasp_id"]), max(len(ids) - 1, 0))
        if len(batch) and (not len(ids) or np.any(ids[at] != batch["grasp_id"])):
            raise Contradiction(f"{self.path}: {table} lacks rows of the grasps")
        chosen = solved.select(first[at] if len(batch) else slice(0, 0))
        more = {n: chosen[n] for n in tables.ARM_COLUMNS}
        return GraspBatch(self.header, {**batch.columns, **more})

    def stored(
        self, object_id: str | None = None, *, protocol: str | None = None, test: str = "f"
    ) -> GraspBatch:
        """Read every stored row once: selected rows, then audit rows that are not selected too.

        Args:
            object_id: One object; all when omitted.
            protocol: Protocol of the verdict columns; the release's default when omitted.
            test: `f`, `l` or `a`.
        """
        parts = []
        for configuration in self.configurations:
            rows = self.grasps(object_id, configuration=configuration, protocol=protocol, test=test)
            parts.append(rows.select(~rows["selected"]) if configuration == "audit" else rows)
        return GraspBatch.concat(parts)

    def batches(
        self,
        configuration: str = "selected",
        split: str | None = None,
        protocol: str | None = None,
        test: str = "f",
        *,
        object_id: str | None = None,
    ) -> Iterator[GraspBatch]:
        """Yield what `grasps` gives, one row group at a time; at least one batch."""
        self._check_place(configuration, split)
        key = (protocol or self.default_protocol, test)
        names = ["grasps", "contacts"]
        if key in self.protocols:
            names.append("verdicts/" + "-".join(key))
        columns = [[n for n in GRASP_COLUMNS if not self.header.lacks(n)], None, None]
        wanted = list(zip(names, columns, strict=False))
        if object_id is not None:
            yield from self._object_batches(object_id, configuration, split, wanted)
            return
        streams = [self.row_groups(t, configuration, split, c) for t, c in wanted]
        for parts in zip(*streams, strict=True):
            yield join_tables(self.header, [self.path / n for n in names], parts)

    def _object_batches(
        self,
        object_id: str,
        configuration: str,
        split: str | None,
        wanted: Sequence[tuple[str, Sequence[str] | None]],
    ) -> Iterator[GraspBatch]:
        rows = self.row_index(configuration, split)
        for low, high in rows.object_ranges(object_id) or [(0, 0)]:
            parts = [rows.read(low, high, table, columns) for table, columns in wanted]
            batch = join_tables(self.header, [self.path / table for table, _ in wanted], parts)
            if np.any(batch["object_id"] != object_id):
                raise Contradiction(
                    f"{self.path}: the rows of {object_id} are not where scenes.parquet says"
                )
            yield batch
