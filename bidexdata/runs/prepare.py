"""The stage `prepare`: sources to a library, one worker process and one report row per input.

An object's folder is written whole or not at all, so a killed command resumes where it stopped.
The index is written at the end, in the order of the inputs, whatever the order of completion:
the same inputs and configuration give the same bytes.
"""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from bidexdata import __version__
from bidexdata.config import differing_keys, to_plain
from bidexdata.errors import BidexError, ConfigConflict, Contradiction, NotUsable
from bidexdata.kinds import INDEX, OBJECTS, REPORT, kind_of
from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.identity import object_id_of, source_identity
from bidexdata.objects.library import (
    Library,
    failures_of,
    left_out_of,
    object_folder,
    warnings_of,
    write_index,
)
from bidexdata.objects.prepare import check_selected, prepare_object
from bidexdata.objects.prepared import PreparedObject
from bidexdata.objects.selection import has_bounds, unwanted
from bidexdata.objects.sources import SourceItem, fetched, resolve_sources
from bidexdata.objects.storage import read_document, write_object
from bidexdata.record.status import Status
from bidexdata.runs.executors import TaskFailure, check_executor, run_tasks
from bidexdata.runs.left_out import leave_out, reason_row
from bidexdata.runs.library_report import Taken, append_time, write_report
from bidexdata.runs.object_folders import index_columns, made_columns, remove_partials
from bidexdata.runs.plan import take_shard
from bidexdata.runs.prepare_kernels import load_kernels
from bidexdata.runs.prepare_parts import Parts, Row
from bidexdata.runs.progress import Progress
from bidexdata.runs.thumbnails import THUMBNAIL, thumbnail
from bidexdata.runs.worker_limits import CPU_SIGNAL, cpu_used, limit_memory, limited_cpu

R = TypeVar("R")
TAKEN = "taken"
"""Key of a task's result that goes into no index: how long it took."""
_TRY_AGAIN = (Status.TIMED_OUT, Status.CRASHED)
"""Failures that the machine may be to blame for."""


@dataclass(frozen=True, slots=True)
class PrepareTask:
    """One input that has to be prepared: all that its worker needs."""

    item: SourceItem
    object_id: str
    sha256: str
    library: Path
    config: PrepareConfig
    content: str = ""
    """What its folder hashes to by the index of an earlier call, if there is one."""


@dataclass(frozen=True, slots=True)
class PrepareReport:
    """What became of the inputs."""

    library: Path
    rows: tuple[Row, ...]
    """One per input, in order (the rows of the index); for a dry run only names and ids.

    Of a part that does not finish the library, only its own."""
    resumed: int
    """Objects of this part that were complete before."""
    seconds: float
    """Wall-clock time."""
    fingerprint: str
    """Of the library; empty while it has no index."""
    made: int = 0
    """Inputs that this call worked on."""
    waiting: int = 0
    """Inputs of other parts that nobody has settled yet; the index is written when none is left."""
    no_longer: tuple[str, ...] = ()
    """Objects that the index listed before and that these inputs do not name; their files stay."""

    @property
    def by_status(self) -> dict[str, int]:
        """Number of inputs per status label."""
        return dict(sorted(Counter(Status(r["status"]).label for r in self.rows).items()))

    @property
    def prepared(self) -> int:
        """Number of prepared objects."""
        return sum(r["status"] == Status.OK for r in self.rows)

    @property
    def hulls(self) -> int:
        """Number of prepared objects that had to be replaced by their hull."""
        return sum(r.get("piece_method") == "hull" for r in self.rows)

    def as_dict(self) -> dict[str, Any]:
        """Figures for `--json`."""
        return {
            "library": str(self.library),
            "inputs": len(self.rows),
            "prepared": self.prepared,
            "hulls": self.hulls,
            "resumed": self.resumed,
            "made": self.made,
            "no_longer": list(self.no_longer),
            "by_status": self.by_status,
            "failures": failures_of(self.rows),
            "left_out": left_out_of(self.rows),
            "warnings": warnings_of(self.rows),
            "waiting": self.waiting,
            "seconds": round(self.seconds, 3),
            "fingerprint": self.fingerprint,
        }


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
        limit: Only the first so many inputs.
        dry_run: List the inputs and write nothing. With bounds on shapes (`select`) every input is
            read and repaired, to tell which would be left out; near duplicates are not looked for.
        executor: `processes`, or `inline` or `ray`, which set no limits of memory and time.
        workers: Number of workers; 0 means one per core.
        shard: Part i of n of the inputs, i from 0. Several machines may prepare one folder; the
            part that finds all others done writes the index (see `prepare_parts`).
        quiet: Show no progress.

    Raises:
        PathNotFound: A source does not exist.
        ConfigConflict: The folder holds objects that were made with another configuration.
    """
    check_executor(executor, workers)
    config = config or PrepareConfig()
    start = time.monotonic()
    items = resolve_sources(sources)[: None if limit is None else max(limit, 0)]
    _check_out(out, config)
    items = fetched(items)
    earlier = _earlier(out)
    rows, tasks = _plan(items, out, config, _contents(earlier))
    mine = take_shard(range(len(items)), shard)
    my_tasks = {n: tasks[n] for n in mine if n in tasks}
    if dry_run:
        if has_bounds(config.select):
            _work(my_tasks, rows, _checked_one, config, executor, workers, quiet=quiet)
        return PrepareReport(out, tuple(rows[n] for n in mine), 0, time.monotonic() - start, "")

    parts = Parts(out, rows, _asked(config))
    remove_partials(out)
    known = {n: columns for n, t in my_tasks.items() if (columns := _made(t)) is not None}
    there = set(known)
    for number, failure in parts.failures().items():
        if number in my_tasks and number not in known and failure["status"] not in _TRY_AGAIN:
            rows[number].update(failure)
            there.add(number)
    to_do = {n: t for n, t in my_tasks.items() if n not in there}
    _work(to_do, rows, prepare_one, config, executor, workers, quiet=quiet, already=len(there))
    if shard is not None:
        parts.write(shard, {n: rows[n] for n in my_tasks if rows[n]["status"] != Status.OK})
    others = {n: t for n, t in tasks.items() if n not in my_tasks}
    waiting = _settle_others(others, rows, parts, known)
    settled = mine if waiting else range(len(items))
    folders = {n: _folder(tasks[n]) for n in settled if rows[n]["status"] == Status.OK}
    for number, folder in folders.items():
        rows[number].update(known[number] if number in known else index_columns(folder))
    gone: set[str] = set()
    if not waiting:
        before = set(earlier.object_ids) if earlier else set()
        gone = before - {str(r.get("object_id", "")) for r in rows}
        rows = leave_out(rows, folders, config.select)
        write_index(out, rows, _identity(config), _asked(config))
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


def _contents(earlier: Library | None) -> dict[str, str]:
    """What the files of each object hash to by an index, also of those that a selection left out."""
    rows = earlier.index.to_pylist() if earlier else []
    return {r["object_id"]: r["content_sha256"] for r in rows if r["content_sha256"]}


def prepare_one(task: PrepareTask) -> Row:
    """Prepare one input and write its folder: the work of a task.

    Returns:
        The columns that are known here: status and reason, empty when everything succeeded.
    """
    started, (own, search) = time.monotonic(), cpu_used()
    made, row = _within_limits(task, _made_and_drawn)
    if made is not None and _made(task) is None:  # else it was made by another machine, meanwhile
        obj, picture = made
        write_object(_folder(task), obj, _identity(task.config), {THUMBNAIL: picture})
    cpu = cpu_used()
    return {**row, TAKEN: Taken(time.monotonic() - started, cpu[0] - own, cpu[1] - search)}


def _made_and_drawn(item: SourceItem, config: PrepareConfig) -> tuple[PreparedObject, bytes]:
    obj = prepare_object(item, config)
    return obj, thumbnail(obj)


def _checked_one(task: PrepareTask) -> Row:
    """Find out what the selection says of one input, and write nothing."""
    return _within_limits(task, check_selected)[1]


def _within_limits(
    task: PrepareTask, work: Callable[[SourceItem, PrepareConfig], R]
) -> tuple[R | None, Row]:
    """What `work` makes of an input, and the columns that say why there is nothing."""
    limits = task.config.limits
    limit_memory(limits.memory_gib)
    load_kernels()
    try:
        with limited_cpu(limits.cpu_seconds):
            return work(task.item, task.config), {}
    except PrepareFailure as failure:
        return None, reason_row(failure.status, failure.reason)
    except MemoryError:
        bound = f"needs more than limits.memory_gib = {limits.memory_gib:g} GiB"
        return None, reason_row(Status.TOO_COMPLEX, bound)


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
) -> None:
    """Run the tasks and put what becomes of them into the rows."""
    with Progress(len(tasks) + already, "object", quiet=quiet, already=already) as progress:
        for number, result in _run(tasks, work, config, executor, workers):
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
) -> Iterator[tuple[int, Row]]:
    """Run the tasks; whatever a worker dies of becomes a row."""
    wall = config.limits.wall_seconds
    numbers = {task.object_id: number for number, task in tasks.items()}
    done = run_tasks(list(tasks.values()), work, executor=executor, workers=workers, timeout=wall)
    for task, result in done:
        number = numbers[task.object_id]
        if not isinstance(result, TaskFailure):
            yield number, result
        elif result.kind == "timeout":
            yield number, reason_row(Status.TIMED_OUT, f"took longer than {wall:g} s")
        elif CPU_SIGNAL in result.reason:
            bound = f"limits.cpu_seconds = {config.limits.cpu_seconds:g} CPU s used up"
            yield number, reason_row(Status.TOO_COMPLEX, f"{bound}: decimate the mesh")
        else:
            yield number, reason_row(Status.CRASHED, result.reason)


def _settle_others(
    others: Mapping[int, PrepareTask], rows: list[Row], parts: Parts, known: dict[int, Row]
) -> int:
    """Count the inputs of other parts that are not settled.

    What is known of the rest goes into their rows, the columns of their objects into `known`.
    """
    if not others:
        return 0
    failures = parts.failures()
    there = {n for n, t in others.items() if _folder(t).is_dir()}
    waiting = others.keys() - there - failures.keys()
    if not waiting:  # a cut, damaged or foreign folder counts as none; looking inside takes long
        whole = {n: columns for n in there if (columns := _made(others[n])) is not None}
        known.update(whole)
        waiting = others.keys() - whole.keys() - failures.keys()
        for number in others.keys() - whole.keys() - waiting:
            rows[number].update(failures[number])
    return len(waiting)


def _folder(task: PrepareTask) -> Path:
    return task.library / object_folder(task.object_id)


def _made(task: PrepareTask) -> Row | None:
    """Columns of the object's folder; None where it has to be made."""
    return made_columns(_folder(task), task.sha256, content=task.content)


def _check_out(out: Path, config: PrepareConfig) -> None:
    """Refuse a folder that holds something else or was made with another configuration."""
    if not out.exists():
        return
    if not out.is_dir():
        raise NotUsable(f"{out} is a file; --out needs a folder")
    own = {INDEX, OBJECTS, REPORT}
    foreign = [p.name for p in out.iterdir() if p.name not in own and not p.name.startswith(".")]
    if foreign:
        # A release has `objects` too, and must not be written to.
        kind = kind_of(out)
        what = f"holds {sorted(foreign)[0]}" if kind in ("nothing", "library") else f"is a {kind}"
        raise NotUsable(f"{out} {what} and is no folder for a library; choose another --out")
    before, now = _made_with(out), _identity(config)
    if before is not None and before != now:
        raise ConfigConflict(out, differing_keys(before, now))


def _made_with(out: Path) -> Any:
    """The configuration that made a library, by one of its objects; None where none can be read."""
    for path in (out / OBJECTS).glob("[!.]*/[!.]*/object.json"):
        with contextlib.suppress(Contradiction):  # a cut one is made again
            return read_document(path.parent).get("config")
    return None


def _identity(config: PrepareConfig) -> dict[str, Any]:
    """The configuration that decides bytes: limits and selection decide whether there are any."""
    plain = to_plain(config)
    del plain["limits"], plain["select"]
    return plain


def _asked(config: PrepareConfig) -> dict[str, Any]:
    """What decides which inputs give no object: a failure is final until one of these changes."""
    return {**to_plain(config), "bidexdata": __version__}
