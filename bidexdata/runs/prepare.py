"""The stage `prepare`: sources to a library, one worker process and one report row per input.

An object's folder is written whole or not at all, so a killed command resumes where it stopped.
The index is written at the end, in the order of the inputs, whatever the order of completion:
the same inputs and configuration give the same bytes.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from bidexdata.errors import BidexError, LimitDropsObjects
from bidexdata.extras import require
from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.identity import object_id_of, source_identity
from bidexdata.objects.library import Library, write_index
from bidexdata.objects.selection import has_bounds, unwanted
from bidexdata.objects.sources import SourceItem, fetched, resolve_sources
from bidexdata.record.status import Status
from bidexdata.runs.executors import TaskFailure, check_executor, run_tasks
from bidexdata.runs.left_out import leave_out, reason_row
from bidexdata.runs.library_report import append_time, write_report
from bidexdata.runs.object_folders import index_columns, remove_partials
from bidexdata.runs.plan import take_shard
from bidexdata.runs.prepare_folder import LOGS, check_out, prepare_asked, prepare_identity
from bidexdata.runs.prepare_parts import Parts, Row
from bidexdata.runs.prepare_report import PrepareReport
from bidexdata.runs.prepare_task import TAKEN, PrepareTask, checked_one, made, prepare_one
from bidexdata.runs.progress import Progress
from bidexdata.runs.task_failures import failure_row, log_raised

NEEDED = ("coacd", "manifold3d", "scipy", "trimesh", "warp")
"""Modules that workers import; without them every object would fail."""
_TRY_AGAIN = (Status.TIMED_OUT, Status.CRASHED)
"""Failures that the machine may be to blame for."""


def prepare_library(
    sources: Sequence[str],
    out: Path,
    config: PrepareConfig | None = None,
    *,
    limit: int | None = None,
    dry_run: bool = False,
    executor: str = "processes",
    workers: int = 0,
    shard: tuple[int, int] | None = None,
    quiet: bool = False,
) -> PrepareReport:
    """Prepare the objects that the sources name and write the library.

    Args:
        sources: As `bidexdata.objects.sources.resolve_sources` takes them.
        out: Folder of the library; complete objects in it are kept.
        config: Every tolerance and bound.
        limit: Only the first so many inputs; refused where the library has objects of the others.
        dry_run: List the inputs and write nothing. With bounds on shapes (`select`) every input is
            read and repaired, to tell which would be left out; near duplicates are not looked for.
        executor: `processes`, or `inline` or `ray`, which set no limits of memory and time.
        workers: Number of workers; 0 means one per core.
        shard: Part i of n of the inputs, i from 0. Several machines may prepare one folder; the
            part that finds all others done writes the index (see `prepare_parts`).
        quiet: Show no progress.

    Raises:
        PathNotFound: A source does not exist.
        ConfigConflict: The folder holds objects that were made with another configuration, or of
            inputs beyond `limit`.
        MissingExtra: A package that geometry needs is not installed.
    """
    check_executor(executor, workers)
    require(*NEEDED)
    config = config or PrepareConfig()
    start = time.monotonic()
    every = resolve_sources(sources)
    number = len(every) if limit is None else max(limit, 0)
    check_out(out, config)
    earlier = _earlier(out)
    if earlier is not None and not dry_run:
        _refuse_to_drop(earlier, every, number)
    items = fetched(every[:number])
    rows, tasks = _plan(items, out, config, _contents(earlier))
    mine = take_shard(range(len(items)), shard)
    my_tasks = {n: tasks[n] for n in mine if n in tasks}
    how = (config, executor, workers)
    if dry_run:
        if has_bounds(config.select):
            _work(my_tasks, rows, checked_one, *how, quiet=quiet)
        return PrepareReport(out, tuple(rows[n] for n in mine), 0, time.monotonic() - start, "")

    parts = Parts(out, rows, prepare_asked(config))
    remove_partials(out)
    known = {n: columns for n, t in my_tasks.items() if (columns := made(t)) is not None}
    there = set(known)
    for number, failure in parts.failures().items():
        if number in my_tasks and number not in known and failure["status"] not in _TRY_AGAIN:
            rows[number].update(failure)
            there.add(number)
    to_do = {n: t for n, t in my_tasks.items() if n not in there}
    _work(to_do, rows, prepare_one, *how, quiet=quiet, already=len(there), logs=out / LOGS)
    if shard is not None:
        parts.write(shard, {n: rows[n] for n in my_tasks if rows[n]["status"] != Status.OK})
    others = {n: t for n, t in tasks.items() if n not in my_tasks}
    waiting = _settle_others(others, rows, parts, known)
    settled = mine if waiting else range(len(items))
    folders = {n: tasks[n].folder for n in settled if rows[n]["status"] == Status.OK}
    for number, folder in folders.items():
        rows[number].update(known[number] if number in known else index_columns(folder))
    gone: set[str] = set()
    if not waiting:
        before = set(earlier.object_ids) if earlier else set()
        gone = before - {str(r.get("object_id", "")) for r in rows}
        rows = leave_out(rows, folders, config.select)
        write_index(out, rows, prepare_identity(config), prepare_asked(config))
        write_report(out, rows)
        parts.remove()
    return PrepareReport(
        library=out,
        rows=tuple(rows[n] for n in settled),
        resumed=len(folders.keys() - to_do.keys()),
        made=len(to_do),
        seconds=time.monotonic() - start,
        fingerprint="" if waiting else Library.open(out).fingerprint,
        waiting=waiting,
        no_longer=tuple(sorted(gone)),
    )


def _earlier(out: Path) -> Library | None:
    """The library as an earlier call left it; None without an index that can be read."""
    try:
        return Library.open(out)
    except BidexError:
        return None


def _refuse_to_drop(earlier: Library, items: Sequence[SourceItem], number: int) -> None:
    """Refuse to take the first inputs alone where the library has objects of the others.

    Objects are told by their source's name: nothing beyond the limit is read or downloaded.
    """
    rows = (r for r in earlier.index.to_pylist() if r["status"] == Status.OK)
    there = Counter(r["source_name"] for r in rows)
    first, rest = (Counter(i.source_name for i in p) for p in (items[:number], items[number:]))
    dropped = list(((there - first) & rest).elements())
    if dropped:
        raise LimitDropsObjects(earlier.path, number, dropped)


def _contents(earlier: Library | None) -> dict[str, str]:
    """What the files of each object hash to by an index, also of those that a selection left out."""
    rows = earlier.index.to_pylist() if earlier else []
    return {r["object_id"]: r["content_sha256"] for r in rows if r["content_sha256"]}


def _plan(
    items: Sequence[SourceItem], out: Path, config: PrepareConfig, contents: Mapping[str, str]
) -> tuple[list[Row], dict[int, PrepareTask]]:
    """One row per input, and a task for each that is not a duplicate or unreadable."""
    rows: list[Row] = []
    tasks: dict[int, PrepareTask] = {}
    first: dict[str, str] = {}
    for number, item in enumerate(items):
        row: Row = {
            "source_name": item.source_name,
            "source": item.source,
            "licence": item.licence,
            "author": item.author,
            "category": item.category,
            "warnings": [],
            **reason_row(Status.OK, ""),
        }
        rows.append(row)
        try:
            sha256, size = source_identity(item, config.load.max_bytes)
        except PrepareFailure as failure:
            row.update(reason_row(failure.status, failure.reason))
            continue
        object_id = object_id_of(item, sha256)
        row.update(object_id=object_id, source_sha256=sha256, source_bytes=size)
        not_wanted = unwanted(item.category, config.select)
        if not_wanted:
            row.update(reason_row(Status.NOT_SELECTED, not_wanted))
            continue
        if sha256 in first:
            row.update(reason_row(Status.DUPLICATE, f"same bytes as {first[sha256]}"))
            row["duplicate_of"] = first[sha256]
            continue
        first[sha256] = object_id
        content = contents.get(object_id, "")
        tasks[number] = PrepareTask(item, object_id, sha256, out.resolve(), config, content)
    return rows, tasks


def _work(
    tasks: Mapping[int, PrepareTask],
    rows: Sequence[Row],
    work: Callable[[PrepareTask], Row],
    config: PrepareConfig,
    executor: str,
    workers: int,
    *,
    quiet: bool,
    already: int = 0,
    logs: Path | None = None,
) -> None:
    """Run the tasks and put what becomes of them into the rows; tracebacks go to `logs`."""
    with Progress(len(tasks) + already, "object", quiet=quiet, already=already) as progress:
        for number, result in _run(tasks, work, config, executor, workers, logs):
            if TAKEN in result:
                append_time(tasks[number].library, tasks[number].object_id, result.pop(TAKEN))
            rows[number].update(result)
            progress.advance(note=tasks[number].object_id)


def _run(
    tasks: Mapping[int, PrepareTask],
    work: Callable[[PrepareTask], Row],
    config: PrepareConfig,
    executor: str,
    workers: int,
    logs: Path | None,
) -> Iterator[tuple[int, Row]]:
    """Run the tasks; whatever a worker dies of becomes a row."""
    limits = config.limits
    numbers = {task.object_id: number for number, task in tasks.items()}
    done = run_tasks(
        list(tasks.values()), work, executor=executor, workers=workers, timeout=limits.wall_seconds
    )
    for task, result in done:
        number = numbers[task.object_id]
        if not isinstance(result, TaskFailure):
            yield number, result
            continue
        if result.kind == "exception":
            log_raised(task.object_id, result, logs)
        yield number, failure_row(result, limits)


def _settle_others(
    others: Mapping[int, PrepareTask], rows: list[Row], parts: Parts, known: dict[int, Row]
) -> int:
    """Count the inputs of other parts that are not settled.

    What is known of the rest goes into their rows, the columns of their objects into `known`.
    """
    if not others:
        return 0
    failures = parts.failures()
    there = {n for n, t in others.items() if t.folder.is_dir()}
    waiting = others.keys() - there - failures.keys()
    if not waiting:  # a cut, damaged or foreign folder counts as none; looking inside takes long
        whole = {n: columns for n in there if (columns := made(others[n])) is not None}
        known.update(whole)
        waiting = others.keys() - whole.keys() - failures.keys()
        for number in others.keys() - whole.keys() - waiting:
            rows[number].update(failures[number])
    return len(waiting)
