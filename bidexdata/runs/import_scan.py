"""The first pass of an import: what every foreign file holds, and which cannot be used.

Files are read in chunks by worker processes of bounded memory, whatever the executor: whatever a
file does to its reader costs that file alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bidexdata.errors import Contradiction, NotUsable
from bidexdata.runs.executors import TaskFailure
from bidexdata.runs.import_reader import read_apart, read_tasks
from bidexdata.runs.progress import Progress
from bidexdata.runs.shards import write_atomically
from bidexdata.runs.worker_limits import limit_memory

if TYPE_CHECKING:
    from bidexdata.formats.importers.format import ForeignGrasps, Format
    from bidexdata.formats.importers.rows import Placed
    from bidexdata.runs.stage import TaskExecution

FILES = "files.parquet"
"""Of an imported run: one row per file."""
MEMORY_GIB = 6.0
"""Address space of a worker [GiB]."""
_GROUP = 4096
_CHUNK = 256
"""Files of a task: small enough for a bar that moves."""


class FileRow(NamedTuple):
    """What became of one file."""

    file: str
    """Path relative to the imported folder."""
    sha256: str = ""
    object_name: str = ""
    """As the file names its object."""
    object_id: str = ""
    rows: int = 0
    """Grasps that were read."""
    left_out: int = 0
    """Other grasps of the file."""
    reason: str = ""
    """Why the file was not imported, or why grasps of it were left out."""
    places: tuple[Placed, ...] = ()
    """Where its object stands, each place once."""

    @property
    def failed(self) -> bool:
        """Whether nothing of the file can be imported."""
        return self.rows == 0

    def refused(self, reason: str) -> FileRow:
        """The same file, not imported after all."""
        return self._replace(rows=0, left_out=self.left_out + self.rows, reason=reason)


def scan(form: Format, root: Path, names: Sequence[str], execution: TaskExecution) -> list[FileRow]:
    """Read every file once; the result is in the order of `names`."""
    chunks = [tuple(names[i : i + _CHUNK]) for i in range(0, len(names), _CHUNK)]
    found: dict[str, FileRow] = {}
    with Progress(len(names), "file read", quiet=execution.quiet) as progress:
        for chunk, rows in _read_all(form, root, chunks, execution):
            found.update((row.file, row) for row in rows)
            progress.advance(len(chunk))
    return [found[name] for name in names]


def read_file(form: Format, root: Path, name: str) -> tuple[str, ForeignGrasps]:
    """Read one file; give the sha256 of its bytes and its grasps.

    Raises:
        BadFile: It cannot be imported.
    """
    from bidexdata.formats.importers.format import BadFile

    path = root / name
    try:
        if not path.is_file():
            raise BadFile("it is no plain file")  # reading a pipe would wait for ever
        size = path.stat().st_size
        if size > form.max_bytes:
            raise BadFile(f"its {size} bytes are more than the {form.max_bytes} that are read")
        data = path.read_bytes()
    except OSError as err:
        raise BadFile(err.strerror or type(err).__name__) from err
    return hashlib.sha256(data).hexdigest(), form.read(data, name)


def read_bounded(
    form_name: str, root: str, names: Sequence[str]
) -> list[tuple[str, ForeignGrasps]]:
    """Read files in a process of bounded memory: this one if it is a worker, else a child of it.

    Raises:
        NotUsable: One of them cannot be read now.
    """
    result = read_apart(tuple(names), partial(_read_chunk, form_name, root))
    if isinstance(result, TaskFailure):
        raise NotUsable(f"reading {names[0]} and the files after it failed: {result.reason}")
    return result


def write_files(path: Path, rows: Iterable[FileRow]) -> None:
    """Write `files.parquet`."""
    import pyarrow as pa
    from pyarrow import parquet

    names = ("file", "sha256", "object_name", "object_id", "rows", "left_out", "reason")
    kinds = {"rows": pa.int64(), "left_out": pa.int64()}
    rows = list(rows)
    table = pa.table(
        {n: pa.array([getattr(r, n) for r in rows], kinds.get(n, pa.string())) for n in names}
    )
    # Files of one object lie together: with small groups a reader of one skips the others.
    write_atomically(
        path, lambda temporary: parquet.write_table(table, temporary, row_group_size=_GROUP)
    )


def read_files(run: Path, object_id: str | None = None) -> list[FileRow]:
    """Read `files.parquet` of an imported run, without the places.

    Args:
        run: The run's folder.
        object_id: Files of one object; all when omitted.

    Raises:
        Contradiction: It is missing or damaged.
    """
    import pyarrow as pa
    from pyarrow import parquet

    try:
        only = None if object_id is None else [("object_id", "=", object_id)]
        table = parquet.read_table(run / FILES, filters=only)
        return [FileRow(**row) for row in table.to_pylist()]
    except (pa.ArrowException, OSError, TypeError) as err:
        raise Contradiction(
            f"{run / FILES}: missing or damaged ({type(err).__name__}); delete it and run "
            "`bidexdata import` again"
        ) from err


def _read_all(
    form: Format, root: Path, chunks: Sequence[tuple[str, ...]], execution: TaskExecution
) -> Iterable[tuple[tuple[str, ...], list[FileRow]]]:
    """Read chunk by chunk; a chunk that ended its worker is read again file by file."""
    work = partial(_scan_chunk, form.name, str(root))
    again: list[tuple[str, ...]] = []
    for chunk, result in read_tasks(chunks, work, execution):
        if isinstance(result, TaskFailure):
            again += [(name,) for name in chunk]
        else:
            yield chunk, result
    for chunk, result in read_tasks(again, work, execution):
        if isinstance(result, TaskFailure):
            yield chunk, [FileRow(chunk[0], reason=f"reading it failed: {result.reason}")]
        else:
            yield chunk, result


def _read_chunk(
    form_name: str, root: str, names: tuple[str, ...]
) -> list[tuple[str, ForeignGrasps]]:
    from bidexdata.formats.importers import load_format

    limit_memory(MEMORY_GIB)
    form = load_format(form_name)
    return [read_file(form, Path(root), name) for name in names]


def _scan_chunk(form_name: str, root: str, names: tuple[str, ...]) -> list[FileRow]:
    from bidexdata.formats.importers import load_format

    limit_memory(MEMORY_GIB)
    form = load_format(form_name)
    return [_scan_file(form, Path(root), name) for name in names]


def _scan_file(form: Format, root: Path, name: str) -> FileRow:
    from bidexdata.formats.importers.format import BadFile
    from bidexdata.formats.importers.rows import placed

    try:
        sha256, grasps = read_file(form, root, name)
    except BadFile as bad:
        return FileRow(name, reason=bad.reason)
    out = grasps.left_out
    more = f" and {len(out) - 1} more" if len(out) > 1 else ""
    return FileRow(
        name,
        sha256,
        grasps.object_name,
        rows=len(grasps),
        left_out=len(out),
        reason=f"{out[0]}{more}" if out else "",
        places=tuple(dict.fromkeys(placed(grasps))),
    )
