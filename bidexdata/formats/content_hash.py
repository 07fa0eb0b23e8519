"""Content hash: sha256 over the decoded columns of a release, whatever form or file holds them.

Per column and table (of one configuration and split): sha256 of the null mask (one byte a row, 1 =
there is a value), of the values (little-endian, row-major; 0 where null; booleans one byte; text
UTF-8, one after the other) and, for text, of the lengths in bytes (uint32). These digests, in this
order, are one line of text `<table> <column> <rows> <digest> <digest> [<digest>]`; the content hash
is the sha256 of all lines, sorted, each ended by a newline. Where files are cut, how they are
compressed and which version of a package wrote them has no part in it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.formats.tables import arms_tables, plain_lacks

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.formats.release import Release
    from bidexdata.record import Header

LEFT_OUT = {"runs": ("generator_version",)}
"""Columns that name package versions."""
SMALL_TABLES = ("objects", "scenes", "runs")


class ContentTally:
    """Add the rows of tables in order, in parts of any size, then read `digest()`.

    State: three running hashes per column. Different tables may be added from different threads.
    """

    def __init__(self) -> None:
        self._tables: dict[str, dict[str, _ColumnHash]] = {}

    def add(self, name: str, table: pa.Table) -> None:
        """Add rows of a table.

        Args:
            name: Of the table: `<configuration>/<split>/<table>`, `objects`, `scenes` or `runs`.
            table: The next rows; none at all make the columns known.
        """
        left_out = LEFT_OUT.get(name, ())
        columns = self._tables.setdefault(
            name, {c: _ColumnHash() for c in table.column_names if c not in left_out}
        )
        for column, digest in columns.items():
            digest.add(table.column(column))

    def lines(self) -> list[str]:
        """One line per column, sorted."""
        found = []
        for name, columns in self._tables.items():
            found += [f"{name} {column} {digest.text()}" for column, digest in columns.items()]
        return sorted(found)

    def digest(self) -> str:
        """The content hash, 64 hex digits."""
        return hashlib.sha256("".join(f"{line}\n" for line in self.lines()).encode()).hexdigest()


class _ColumnHash:
    def __init__(self) -> None:
        self._rows = 0
        self._valid, self._values = hashlib.sha256(), hashlib.sha256()
        self._lengths: Any = None

    def add(self, column: pa.ChunkedArray) -> None:
        import pyarrow as pa

        self._rows += len(column)
        is_text = pa.types.is_string(column.type)
        if is_text and self._lengths is None:
            self._lengths = hashlib.sha256()
        for array in column.chunks:
            valid = array.is_valid().to_numpy(zero_copy_only=False)
            self._valid.update(np.ascontiguousarray(valid, np.uint8).data)
            if is_text:
                lengths, data = text_bytes(array)
                self._lengths.update(lengths.data)
                self._values.update(data.data)
            else:
                self._values.update(number_bytes(array).data)

    def text(self) -> str:
        digests = [h for h in (self._valid, self._values, self._lengths) if h is not None]
        return " ".join([str(self._rows), *(h.hexdigest() for h in digests)])


def number_bytes(array: pa.Array) -> np.ndarray:
    """Values of a numeric or boolean column, nulls as 0, little-endian and contiguous."""
    import pyarrow as pa

    flat: Any = array.flatten() if pa.types.is_fixed_size_list(array.type) else array
    if flat.null_count:
        flat = flat.fill_null(False if pa.types.is_boolean(flat.type) else 0)
    values = flat.to_numpy(zero_copy_only=False)
    dtype = np.uint8 if values.dtype == bool else values.dtype.newbyteorder("<")
    return np.ascontiguousarray(values, dtype)


def text_bytes(array: pa.Array) -> tuple[np.ndarray, np.ndarray]:
    """Lengths in bytes of the texts of a column, and their UTF-8 bytes one after the other."""
    filled: Any = array.fill_null("") if array.null_count else array
    if not len(filled):
        return np.zeros(0, "<u4"), np.zeros(0, np.uint8)
    _, offsets, data = filled.buffers()
    ends = np.frombuffer(offsets, np.int32)[filled.offset : filled.offset + len(filled) + 1]
    letters = np.frombuffer(data, np.uint8) if data is not None else np.zeros(0, np.uint8)
    return np.diff(ends).astype("<u4"), letters[ends[0] : ends[-1]]


def content_hash(release: Release) -> str:
    """Hash the decoded columns of all tables of a release; equal for every form.

    Raises:
        Contradiction: A file is damaged.
    """
    tally = ContentTally()
    for name, table in _row_tables(release):
        tally.add(name, table)
    for name in SMALL_TABLES:
        table = getattr(release, name)
        late = [c for c in table.column_names if plain_lacks(release.header, c)]
        tally.add(name, table.drop_columns(late))
    return tally.digest()


def row_table_names(header: Header, tests: Sequence[tuple[str, str]]) -> list[str]:
    """The row tables of a release with these arms and verdicts."""
    verdicts = (f"verdicts/{p}-{t}" for p, t in sorted(tests))
    return ["grasps", "contacts", *arms_tables(header), *verdicts]


def _row_tables(release: Release) -> Iterator[tuple[str, pa.Table]]:
    for configuration in release.configurations:
        for split in release.split_names:
            for table in row_table_names(release.header, release.protocols):
                for rows in release.row_groups(table, configuration, split):
                    yield f"{configuration}/{split}/{table}", rows
