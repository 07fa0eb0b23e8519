"""Parquet files of a release: how they are written, and reading that checks every page.

zstd with BYTE_STREAM_SPLIT on floats, dictionaries on strings only, page checksums and page index,
row groups of 8192 rows. The same rows give the same bytes however they arrive: `TableWriter`
cuts row groups and files by row number and object, not by the batches it is given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bidexdata.errors import Contradiction
from bidexdata.formats.tables import value_type

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

ROW_GROUP = 8192
"""Rows of a row group. Source: 4k to 16k measured best for archive and query together."""
ROWS_PER_FILE = 262_144
"""Rows after which the next object begins a new file: about 200 MB of grasps."""
ZSTD_LEVEL = 1
"""Levels above 3 were measured to save 1 % at 4 to 18 times the write time."""


class TableWriter:
    """Write the rows of one table and split to `<folder>/<stem>-00000.parquet` and so on.

    State: the open file, its rows so far, and fewer than `ROW_GROUP` rows waiting for their group.
    """

    def __init__(
        self,
        folder: Path,
        stem: str,
        schema: pa.Schema,
        sorted_by: Sequence[str] = (),
        rows_per_file: int | None = None,
        *,
        watch: Callable[[pa.Table], Any] | None = None,
        do: Callable[[Callable[[], Any]], Any] | None = None,
    ):
        """Say where rows go.

        Args:
            folder: Of the table.
            stem: What file names begin with: the split.
            schema: Of the table.
            sorted_by: Columns that the rows are sorted by.
            rows_per_file: Rows after which the next object begins a new file; `ROWS_PER_FILE` when
                omitted.
            watch: Sees every row group that is written, in order.
            do: Does a job, in order; in place, unless something like `Background.do` is given.
        """
        self.folder, self.stem, self.schema = folder, stem, schema
        self.sorted_by, self.rows_per_file = tuple(sorted_by), rows_per_file or ROWS_PER_FILE
        self.files: dict[Path, int] = {}
        """Rows of every file so far."""
        self._watch, self._do = watch, do or _at_once
        self._part = 0
        self._in_file = 0
        self._waiting: list[pa.Table] = []
        self._writer: pq.ParquetWriter | None = None

    def add_object(self, table: pa.Table) -> None:
        """Append all rows of one object; files are cut between objects only."""
        if table.num_rows == 0:
            return
        if self._in_file >= self.rows_per_file:
            self._end_file()
        self._in_file += table.num_rows
        self._waiting.append(table)
        self._write_groups(ROW_GROUP)

    def close(self) -> None:
        """Write what is waiting; a table without rows still gets one file with its schema."""
        self._end_file()

    def _write_groups(self, smallest: int) -> None:
        import pyarrow as pa

        waiting = sum(t.num_rows for t in self._waiting)
        if waiting < smallest:
            return
        table = pa.concat_tables(self._waiting)
        at = 0
        while waiting - at >= smallest and at < waiting:
            group = table.slice(at, ROW_GROUP).combine_chunks()
            self._do(partial(self._write, self._open(), group))
            self.files[self._path] += group.num_rows
            at += group.num_rows
        self._waiting = [table.slice(at)] if at < waiting else []

    def _open(self) -> pq.ParquetWriter:
        if self._writer is None:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._writer = _parquet_writer(self._path, self.schema, self.sorted_by)
            self.files[self._path] = 0
        return self._writer

    @property
    def _path(self) -> Path:
        return self.folder / f"{self.stem}-{self._part:05d}.parquet"

    def _write(self, writer: pq.ParquetWriter, group: pa.Table) -> None:
        writer.write_table(group, row_group_size=ROW_GROUP)
        if self._watch is not None:
            self._watch(group)

    def _end_file(self) -> None:
        self._write_groups(1)
        self._do(self._open().close)
        self._writer, self._in_file, self._waiting = None, 0, []
        self._part += 1


def write_table(path: Path, table: pa.Table, sorted_by: Sequence[str] = ()) -> None:
    """Write a small table (objects, scenes, runs) with the options of this file."""
    writer = _parquet_writer(path, table.schema, sorted_by)
    writer.write_table(table.combine_chunks(), row_group_size=ROW_GROUP)
    writer.close()


def read_table(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a Parquet file with every page checksum verified.

    Raises:
        Contradiction: The file is missing or damaged.
    """
    parts = list(read_groups(path, columns))
    import pyarrow as pa

    return pa.concat_tables(parts)


def read_groups(
    path: Path, columns: Sequence[str] | None = None, groups: Sequence[int] | None = None
) -> Iterator[pa.Table]:
    """Yield the row groups of a Parquet file in order, page checksums verified.

    A file without row groups yields one table without rows, so that the schema arrives.

    Raises:
        Contradiction: The file is missing, damaged or no Parquet file.
    """
    with _open_checked(path) as file:
        names = list(columns) if columns is not None else None
        chosen = range(file.num_row_groups) if groups is None else groups
        if file.num_row_groups == 0:
            schema = file.schema_arrow
            empty = schema.empty_table()
            yield empty.select(names) if names is not None else empty
        for group in chosen:
            yield _with_columns(file.read_row_group(group, columns=names), names, path)


def _with_columns(table: pa.Table, names: list[str] | None, path: Path) -> pa.Table:
    # Arrow leaves out a column that a file has not: one flipped bit may rename it.
    missing = sorted(set(names or ()) - set(table.column_names))
    if missing:
        raise Contradiction(f"{path}: column {missing[0]} is missing")
    return table


def read_schema(path: Path) -> pa.Schema:
    """Read the Arrow schema of a Parquet file.

    Raises:
        Contradiction: The file is missing or its footer damaged.
    """
    with _open_checked(path) as file:
        return file.schema_arrow


def row_counts(path: Path) -> list[int]:
    """Rows of each row group of a Parquet file.

    Raises:
        Contradiction: The file is missing or its footer damaged.
    """
    with _open_checked(path) as file:
        meta = file.metadata
        return [meta.row_group(g).num_rows for g in range(meta.num_row_groups)]


def _at_once(job: Callable[[], Any]) -> None:
    job()


@contextmanager
def _open_checked(path: Path) -> Iterator[pq.ParquetFile]:
    """Open a file; whatever fails while it is open is damage.

    Raises:
        Contradiction: The file is missing or damaged.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not path.is_file():
        raise Contradiction(f"{path} is missing")
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            yield file
    except (OSError, pa.ArrowException, UnicodeDecodeError) as err:
        raise Contradiction(f"{path}: damaged Parquet file ({_first_line(err)})") from err


def _parquet_writer(path: Path, schema: pa.Schema, sorted_by: Sequence[str]) -> pq.ParquetWriter:
    import pyarrow as pa
    import pyarrow.parquet as pq

    strings = [f.name for f in schema if pa.types.is_string(f.type)]
    floats = [_leaf(f) for f in schema if pa.types.is_floating(value_type(f.type))]
    order = None
    if sorted_by:
        order = pq.SortingColumn.from_ordering(schema, [(c, "ascending") for c in sorted_by])
    return pq.ParquetWriter(
        path,
        schema,
        compression="zstd",
        compression_level=ZSTD_LEVEL,
        use_dictionary=strings or False,  # pyright: ignore[reportArgumentType]  (a list is allowed)
        column_encoding=dict.fromkeys(floats, "BYTE_STREAM_SPLIT") or None,
        write_page_checksum=True,
        write_page_index=True,
        sorting_columns=order,
        version="2.6",
    )


def _leaf(field: pa.Field) -> str:
    # Parquet names a list's leaf column "<name>.list.element".
    import pyarrow as pa

    return f"{field.name}.list.element" if pa.types.is_fixed_size_list(field.type) else field.name


def _first_line(err: Exception) -> str:
    return str(err).strip().splitlines()[0] if str(err).strip() else type(err).__name__
