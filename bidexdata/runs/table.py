"""One flat row per grasp of a run or release, or per input of a library, as CSV or Parquet.

Rows go from shard or row group to the file, one object at a time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.errors import BadConfig
from bidexdata.formats.flat import ARMS, GRASP, Verdicts, flat_rows, flat_schema
from bidexdata.formats.tables import VERDICT_COLUMNS, arms_tables
from bidexdata.record import GraspBatch
from bidexdata.runs.browse import open_browsable
from bidexdata.runs.browse_library import LibrarySource
from bidexdata.runs.browse_release import ReleaseSource
from bidexdata.runs.browse_run import RunSource
from bidexdata.runs.finished import Finished
from bidexdata.runs.progress import Progress
from bidexdata.runs.shards import write_atomically

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.formats.release import Release
    from bidexdata.objects.library import Library
    from bidexdata.runs.run import Run

ENDINGS = (".csv", ".parquet")


@dataclass(frozen=True, slots=True, kw_only=True)
class TableReport:
    """What was written."""

    out: Path
    kind: str
    """`library`, `run` or `release`."""
    rows: int
    columns: tuple[str, ...]
    protocol: str = ""
    """Whose verdicts; empty where there are none."""


def write_table(
    path: str | Path,
    out: str | Path,
    *,
    protocol: str | None = None,
    rig: str | Path | None = None,
    quiet: bool = False,
) -> TableReport:
    """Write the flat table of whatever is at `path`; an existing file is replaced.

    Args:
        path: A library, a run or a release.
        out: `.csv` or `.parquet`.
        protocol: Whose verdicts; when omitted a release's default, else `paper-1` or the only one.
        rig: Whose arms; see `Run.rig` when omitted.
        quiet: No progress.

    Raises:
        BadConfig: The file's ending is none of these.
        NotUsable: There is nothing of the kind, or no saying which protocol is meant.
        UnknownName: There are no verdicts of this protocol.
        PathNotFound: Nothing is there.
    """
    out = Path(out)
    if out.suffix.lower() not in ENDINGS:
        raise BadConfig(f"--out {out}: a table is written as one of {', '.join(ENDINGS)}")
    source = open_browsable(path, protocol, rig)
    if isinstance(source, LibrarySource):
        whole = library_rows(source.library)
        schema, tables, total, quiet = whole.schema, iter([whole]), 1, True
    elif isinstance(source, RunSource):
        run = source.run
        schema, total = flat_schema(), len(run.object_ids)
        tables = run_rows(run, source.protocol)
    else:
        assert isinstance(source, ReleaseSource)
        release, quiet = source.release, True  # row groups: seconds, and no objects to count
        schema, tables, total = flat_schema(), release_rows(release, source.protocol), 0
    rows = _write(out, schema, tables, total, quiet)
    return TableReport(
        out=out, kind=source.kind, rows=rows, columns=tuple(schema.names), protocol=source.protocol
    )


def library_rows(library: Library) -> pa.Table:
    """The index of a library: one row per input, the status in a word, lists joined by `; `."""
    import pyarrow as pa

    table = library.index.drop_columns(["status"])
    names = ["status" if n == "status_label" else n for n in table.column_names]
    table = table.rename_columns(names)
    for at, field in enumerate(table.schema):
        if pa.types.is_list(field.type):
            joined = ["; ".join(w) if w else None for w in table.column(at).to_pylist()]
            table = table.set_column(at, field.name, pa.array(joined, pa.string()))
    return table


def run_rows(run: Run, protocol: str) -> Iterator[pa.Table]:
    """The finished rows of a run, object by object."""
    import pyarrow as pa

    finished = Finished.of(run)
    tests = [t for p, t in finished.tests if p == protocol]
    for object_id in run.object_ids:
        parts = []
        for task in finished.tasks_of(run, object_id):
            batch = run.task_batch(task)
            arms = run.task_arms(task, batch).columns if task.task_id in finished.armed else {}
            verdicts = {
                t: Verdicts(run.task_verdicts(task, batch, protocol, t), np.ones(len(batch), bool))
                for t in tests
                if task.task_id in finished.verdicts[protocol, t]
            }
            columns = {**arms, **batch.columns}
            parts.append(flat_rows(columns, verdicts, protocol, run.rig if arms else ""))
        if parts:
            yield pa.concat_tables(parts)


def release_rows(release: Release, protocol: str) -> Iterator[pa.Table]:
    """The selected rows of a release, then the audit rows that are not selected too."""
    tests = [t for p, t in release.protocols if p == protocol]
    names = [n for n in GRASP if not release.header.lacks(n)]
    for configuration in release.configurations:
        own = arms_tables(release.header)
        tables = ["grasps", *own, *(f"verdicts/{protocol}-{t}" for t in tests)]
        chosen = [names, *(["grasp_id", *ARMS] for _ in own), *(None for _ in tests)]
        streams = [
            release.row_groups(table, configuration, columns=columns)
            for table, columns in zip(tables, chosen, strict=True)
        ]
        for grasps, *others in zip(*streams, strict=True):
            columns = dict(GraspBatch.from_arrow(grasps).columns)
            for solved in others[: len(own)]:
                columns |= GraspBatch.from_arrow(solved).columns
            judged = others[len(own) :]
            verdicts = {t: _verdicts(v) for t, v in zip(tests, judged, strict=True)}
            rows = flat_rows(columns, verdicts, protocol, release.rig)
            if configuration == "audit":
                rows = rows.filter(~columns["selected"])
            if rows.num_rows:
                yield rows


def _verdicts(table: pa.Table) -> Verdicts:
    import pyarrow as pa

    tested = table.column("success").is_valid().to_numpy(zero_copy_only=False)
    at = table.schema.get_field_index("success")
    filled = table.column("success").fill_null(False)
    batch = GraspBatch.from_arrow(table.set_column(at, pa.field("success", pa.bool_()), filled))
    return Verdicts({n: batch[n] for n in VERDICT_COLUMNS if n in batch}, tested)


def _write(
    out: Path, schema: pa.Schema, tables: Iterator[pa.Table], total: int, quiet: bool
) -> int:
    from pyarrow import csv
    from pyarrow import parquet as pq

    rows = 0

    def fill(temporary: Path) -> None:
        nonlocal rows
        kind: Any = pq.ParquetWriter if out.suffix.lower() == ".parquet" else csv.CSVWriter
        with (
            kind(str(temporary), schema) as writer,
            Progress(total, "object", quiet=quiet) as progress,
        ):
            for table in tables:
                writer.write_table(table)
                rows += table.num_rows
                progress.advance()

    write_atomically(out, fill)
    return rows
