"""Shards: one Arrow file per task and stage; that it exists is the only mark of "done".

A shard is written to a temporary name beside its place, synced, and renamed, so a reader or a
resumed run never sees half of one. It carries a mark: the fingerprint of the configuration, and
the device and package versions that made it. The same task on the same kind of machine gives the
same bytes, so computing one twice does no harm.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bidexdata.errors import ConfigConflict, Contradiction, PathNotFound
from bidexdata.runs.made_with import made_with
from bidexdata.temporaries import orphans as orphans
from bidexdata.temporaries import sync_folder, temporary_beside

if TYPE_CHECKING:
    import pyarrow as pa

_KEY = b"bidexdata_shard"
_SUFFIX = ".arrow"


class Mark(NamedTuple):
    """What a shard says of itself."""

    fingerprint: str
    """Of the configuration that made it."""
    rows: int
    made_with: Mapping[str, str]
    """Device and versions; information only, empty where an older version wrote the shard."""
    notes: Mapping[str, Any]
    """How the rows were computed, where that is no part of the configuration; plain data."""


def shard_path(stage_folder: Path, task_id: str) -> Path:
    """Place of a task's shard: `<stage>/<first 2 hex digits>/<task_id>.arrow`."""
    return stage_folder / task_id[:2] / f"{task_id}{_SUFFIX}"


def done_tasks(stage_folder: Path) -> set[str]:
    """Ids of the tasks whose shard is there."""
    return {p.stem for p in stage_folder.glob(f"??/*{_SUFFIX}") if not p.name.startswith(".")}


def write_shard(
    path: Path,
    table: pa.Table,
    fingerprint: str,
    *,
    device: str = "cpu",
    notes: Mapping[str, Any] | None = None,
) -> None:
    """Write a table as a shard, atomically, with a mark of what made it.

    Args:
        path: From `shard_path`.
        table: Rows in their final order; may be empty.
        fingerprint: Of the configuration that made the rows.
        device: The Warp device that they were made on.
        notes: What else the mark says, see `Mark`.
    """
    import pyarrow as pa
    from pyarrow import ipc

    mark = Mark(fingerprint, table.num_rows, made_with(device), dict(notes or {}))
    text = json.dumps(mark._asdict(), sort_keys=True)
    metadata = {**(table.schema.metadata or {}), _KEY: text.encode()}
    table = table.replace_schema_metadata(metadata).combine_chunks()
    options = ipc.IpcWriteOptions(compression="zstd")

    def write(temporary: Path) -> None:
        with (
            pa.OSFile(str(temporary), "wb") as sink,
            ipc.new_file(sink, table.schema, options=options) as writer,
        ):
            writer.write_table(table)

    write_atomically(path, write)


def read_shard(path: Path, fingerprint: str | None = None) -> pa.Table:
    """Read a shard.

    Args:
        path: From `shard_path`.
        fingerprint: Expected; any when None.

    Raises:
        PathNotFound: The task is not done.
        ConfigConflict: Another configuration made the shard.
        Contradiction: The file is damaged.
    """
    import pyarrow as pa
    from pyarrow import ipc

    if not path.is_file():
        raise PathNotFound(path, "the shard of a finished task")
    try:
        # Not memory-mapped: a file changed under a map would change numbers or crash.
        table = ipc.open_file(pa.BufferReader(path.read_bytes())).read_all()
        table.validate(full=True)
        mark = _mark_of(table.schema)
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as err:
        raise _damaged(path, err) from err
    if mark.rows != table.num_rows:
        rows = f"{table.num_rows} of {mark.rows} rows"
        raise Contradiction(f"{path}: damaged shard ({rows}); delete it")
    if fingerprint is not None:
        _compare(path, mark, fingerprint)
    return table


def check_mark(path: Path, fingerprint: str) -> None:
    """Check which configuration made a shard, without reading its rows.

    Raises:
        ConfigConflict: Another one than `fingerprint` did.
        Contradiction: The file is damaged.
    """
    _compare(path, read_mark(path), fingerprint)


def read_mark(path: Path) -> Mark:
    """Read what a shard says of itself, without its rows.

    Raises:
        Contradiction: The file is damaged.
    """
    import pyarrow as pa
    from pyarrow import ipc

    try:
        with pa.OSFile(str(path), "rb") as source:
            return _mark_of(ipc.open_file(source).schema)
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as err:
        raise _damaged(path, err) from err


def _mark_of(schema: pa.Schema) -> Mark:
    data = json.loads((schema.metadata or {})[_KEY])
    more = (dict(data.get(key, {})) for key in ("made_with", "notes"))
    return Mark(data["fingerprint"], int(data["rows"]), *more)


def _compare(path: Path, mark: Mark, fingerprint: str) -> None:
    if mark.fingerprint != fingerprint:
        raise ConfigConflict(path, [f"fingerprint: {mark.fingerprint!r} -> {fingerprint!r}"])


def _damaged(path: Path, err: Exception) -> Contradiction:
    what = str(err).splitlines()[0] if str(err) else "unreadable"
    return Contradiction(f"{path}: damaged shard ({what}); delete it and run the command again")


def write_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` fill a temporary file, sync it and rename it to `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_beside(path, "tmp")
    try:
        write(temporary)
        with temporary.open("rb") as handle:
            os.fsync(handle.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""

    def write(temporary: Path) -> None:
        temporary.write_text(text, encoding="utf-8")

    write_atomically(path, write)


def sweep(folders: Iterable[Path]) -> int:
    """Delete temporary files that killed writers left; count them."""
    removed = 0
    for folder in folders:
        for path in orphans(folder.glob("**/.*.tmp")):
            with contextlib.suppress(OSError):
                path.unlink()
                removed += 1
    return removed
