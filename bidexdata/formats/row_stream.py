"""The row tables of a release side by side, object after object.

What is held in memory is the row group of each table that is being read.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bidexdata.formats.row_groups import aligned
from bidexdata.formats.tables import (
    ARM_COLUMNS,
    CONTACT_COLUMNS,
    GRASP_COLUMNS,
    VERDICT_COLUMNS,
    arms_tables,
)
from bidexdata.record import GraspBatch, Header

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.formats.release import Release


class TableRows(NamedTuple):
    """Equal rows of the row tables."""

    grasps: pa.Table
    contacts: pa.Table | None
    """None where contacts are not read."""
    judged: tuple[pa.Table, ...]
    """One table per (protocol, test), in the order of `Release.protocols`."""
    arms: pa.Table | None = None
    """None where the release has no rig, or contacts are not read."""

    @property
    def n(self) -> int:
        """Number of rows."""
        return self.grasps.num_rows

    def slice(self, low: int, high: int) -> TableRows:
        """Rows [low, high)."""
        return self._each(lambda table: table.slice(low, high - low))

    def select(self, mask: np.ndarray) -> TableRows:
        """Keep rows."""
        import pyarrow as pa

        return self._each(lambda table: table.filter(pa.array(mask)))

    def text(self, name: str) -> np.ndarray:
        """A text column of the grasps table."""
        return np.array(self.grasps.column(name).to_pylist(), np.str_)

    def flags(self, name: str) -> np.ndarray:
        """A boolean column of the grasps table."""
        return self.grasps.column(name).to_numpy()

    def tested(self, test: int) -> np.ndarray:
        """Rows that a test was run on, by its place among the verdict tables."""
        return self.judged[test].column("success").is_valid().to_numpy()

    def batch(self, header: Header) -> GraspBatch:
        """Columns of grasps and contacts as stored; an older schema lacks some."""
        found = GraspBatch.from_arrow(self.grasps)
        columns = {n: found[n] for n in GRASP_COLUMNS if n in found}
        if self.contacts is not None:
            found = GraspBatch.from_arrow(self.contacts)
            columns |= {n: found[n] for n in CONTACT_COLUMNS if n in found}
        return GraspBatch(header, columns)

    def verdicts(self, test: int) -> dict[str, np.ndarray]:
        """Columns of one verdict table, all rows of which were tested."""
        found = GraspBatch.from_arrow(self.judged[test])
        return {n: found[n] for n in VERDICT_COLUMNS if n in found}

    def solved(self) -> dict[str, np.ndarray]:
        """Columns of the arm solutions; none where they are not read."""
        if self.arms is None:
            return {}
        found = GraspBatch.from_arrow(self.arms)
        return {n: found[n] for n in ARM_COLUMNS if n in found}

    def _each(self, change: Callable[[pa.Table], pa.Table]) -> TableRows:
        contacts, arms = (None if t is None else change(t) for t in (self.contacts, self.arms))
        return TableRows(change(self.grasps), contacts, tuple(change(t) for t in self.judged), arms)


def joined(parts: Sequence[TableRows]) -> TableRows:
    """Rows one after the other; at least one part, which may be empty."""
    import pyarrow as pa

    def one(tables: Sequence[Any]) -> Any:
        return pa.concat_tables(tables).combine_chunks()

    contacts, arms = [part.contacts for part in parts], [part.arms for part in parts]
    return TableRows(
        one([part.grasps for part in parts]),
        None if contacts[0] is None else one(contacts),
        tuple(one(tables) for tables in zip(*(part.judged for part in parts), strict=True)),
        None if arms[0] is None else one(arms),
    )


class RowStream:
    """The rows of one configuration and split; objects are asked for in ascending order.

    A row that is selected and an audit row is in both configurations; it comes with the selected
    ones alone.

    State: the row groups to come, and the rows of the last one that were not taken yet.
    """

    def __init__(self, release: Release, configuration: str, split: str, *, contacts: bool):
        """Open the tables.

        Args:
            release: Where.
            configuration: `selected` or `audit`.
            split: One split.
            contacts: Read the contacts and the arms too.
        """
        self._tests = ["verdicts/" + "-".join(key) for key in release.protocols]
        self._more = ("contacts", *arms_tables(release.header)) if contacts else ()
        names = ("grasps", *self._more, *self._tests)
        self._groups = aligned(release, dict.fromkeys(names), configuration, split)
        self._others = configuration != "selected" and "selected" in release.configurations
        self._wait_for(next(self._groups))  # a table without rows still gives its schema

    def take(self, object_id: str) -> list[TableRows]:
        """The rows of an object, which may be none; at least one part.

        Rows of objects that are not asked for are passed over.

        Raises:
            Contradiction: A file is damaged, or the tables have not the same rows.
        """
        parts: list[TableRows] = []
        while True:
            at = bisect_left(self._owners, object_id)
            mine = at < len(self._owners) and self._owners[at] == object_id
            low, high = self._starts[at], self._starts[at + int(mine)]
            parts.append(self._part(low, high))
            left = high < self._waiting.n
            following = None if left else next(self._groups, None)
            if following is None:
                self._waiting = self._waiting.slice(high, self._waiting.n)
                self._owners = self._owners[at + int(mine) :]
                self._starts = [start - high for start in self._starts[at + int(mine) :]]
                return parts
            self._wait_for(following)

    def _wait_for(self, tables: tuple[pa.Table, ...]) -> None:
        grasps, *others = tables
        more = [*others[: len(self._more)], None, None]
        judged = tuple(others[len(self._more) :])
        self._waiting = TableRows(grasps, more[0], judged, more[1])
        # The objects of a group as text: one string per object, not one per row.
        ends = grasps.column("object_id").combine_chunks().dictionary_encode()
        self._owners: list[str] = ends.dictionary.to_pylist()
        counts = np.bincount(ends.indices.to_numpy(), minlength=len(self._owners))
        self._starts: list[int] = [0, *np.cumsum(counts).tolist()]

    def _part(self, low: int, high: int) -> TableRows:
        part = self._waiting.slice(low, high)
        return part.select(~part.flags("selected")) if self._others else part
