"""What becomes of a folder of broken files: `python -m benchmarks.hostile FOLDER [--out PAGE.md]`.

One worker prepares them one by one, as `bidexdata prepare FOLDER --workers 1` would. The page has a
row per file: what became of it, its wall-clock and processor time, and the largest resident memory of its
worker (Linux).
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.machine import describe_machine
from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.library import object_folder
from bidexdata.objects.sources import resolve_sources
from bidexdata.objects.storage import read_document
from bidexdata.record.status import Status
from bidexdata.runs.executors import TaskFailure, run_tasks
from bidexdata.runs.prepare import prepare_library
from bidexdata.runs.prepare_task import PrepareTask, prepare_one
from bidexdata.runs.worker_limits import CPU_SIGNAL

PAGE = Path("docs/hostile_files.md")
_STATUS, _CLEAR_REFS = Path("/proc/self/status"), Path("/proc/self/clear_refs")


class Told(NamedTuple):
    """What became of one file."""

    label: str
    """A status, as the index has it."""
    text: str
    """The reason, or how it was repaired and its warnings."""
    seconds: float
    """Wall-clock time [s]."""
    busy: float
    """Processor time of the worker and its decomposition [s], whatever else the machine does; of a worker
    that died, its wall-clock time, which is more."""
    mebibytes: int
    """Largest resident memory of the worker; 0 where the system does not say. Of a worker that
    died, the largest of any that ended so far."""
    child: int
    """The same of any decomposition so far; of a worker that died, it is in the other."""


def told_of(folder: Path, config: PrepareConfig) -> Iterator[tuple[str, Told]]:
    """Name every file of a folder and what became of it, in a worker and a library thrown away."""
    with tempfile.TemporaryDirectory() as place:
        tasks = _tasks(folder, Path(place), config)
        start, wall = time.perf_counter(), config.limits.wall_seconds
        for task, result in run_tasks(tasks, measured, workers=1, timeout=wall):
            now = time.perf_counter()
            failed = isinstance(result, TaskFailure)
            yield task.item.source_name, _lost(result, now - start) if failed else result
            start = now


def measured(task: PrepareTask) -> Told:
    """Prepare one file in a worker and measure it."""
    _forget_peak()
    start, before = time.perf_counter(), _processor_time()
    row = prepare_one(task)
    seconds, busy = time.perf_counter() - start, _processor_time() - before
    memory, child = _peak(), _peak_of_children()
    if row.get("status"):
        return Told(Status(row["status"]).label, str(row["reason"]), seconds, busy, memory, child)
    known = read_document(task.library / object_folder(task.object_id))["provenance"]
    text = f"{known['repair']}, {known['hausdorff']:.2%} of the diagonal from the input"
    return Told("ok", "; ".join([text, *known["warnings"]]), seconds, busy, memory, child)


def main(arguments: Sequence[str]) -> int:
    """Prepare the files of a folder and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hostile", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=PAGE)
    options = parser.parse_args(arguments)
    told: dict[str, Told] = {}
    for name, what in told_of(options.folder, PrepareConfig()):
        told[name] = what
        print(f"{name}: {what.label} in {what.seconds:.1f} s", flush=True)
    options.out.write_text(page(told), encoding="utf-8")
    return 0


def _tasks(folder: Path, library: Path, config: PrepareConfig) -> list[PrepareTask]:
    """One per file, also for those that have the bytes of an earlier one."""
    sources = [str(folder)]
    rows = prepare_library(sources, library, config, dry_run=True, quiet=True).rows
    return [
        PrepareTask(item, row["object_id"], row["source_sha256"], library, config)
        for item, row in zip(resolve_sources(sources), rows, strict=True)
    ]


def _lost(failure: TaskFailure, seconds: float) -> Told:
    """What `prepare` says of a worker that died or was ended."""
    status = Status.TIMED_OUT if failure.kind == "timeout" else Status.CRASHED
    status = Status.TOO_COMPLEX if CPU_SIGNAL in failure.reason else status
    return Told(status.label, failure.reason, seconds, seconds, _peak_of_children(), 0)


def page(told: dict[str, Told]) -> str:
    """The page as Markdown."""
    counts = Counter(t.label for t in told.values())
    slowest = max(told, key=lambda name: told[name].seconds)
    largest = max(told, key=lambda name: told[name].mebibytes)
    machine = describe_machine()
    lines = [
        "# Broken and hostile files",
        "",
        "What `bidexdata prepare` makes of files that are cut off, lie about themselves, hold meshes that",
        "no solid can be made of, or attack the reader. Names state the defect; those that begin with",
        "`legal` are valid. Written by `python -m benchmarks.hostile FOLDER`; the files are no part of the",
        "project. Bounds and rules are in [sources.md](sources.md).",
        "",
        f"{len(told)} files: "
        + ", ".join(f"{n} {label}" for label, n in counts.most_common())
        + ".",
        f"Slowest: `{slowest}`, {told[slowest].seconds:.1f} s, {told[slowest].busy:.1f} s of it processor time.",
        "Largest memory:",
        f"`{largest}`, {told[largest].mebibytes} MiB resident; the decomposition, a process of its own,",
        f"at most {max(t.child for t in told.values())} MiB.",
        f"Machine: {machine['cpu']}, {machine['cores']} cores, one worker, load average {_load():.0f}:",
        "other work beside it makes the seconds longer.",
        "",
        "| file | what became of it | why, or how | s | processor s | MiB |",
        "|---|---|---|---|---|---|",
    ]
    for name, t in told.items():
        text = t.text.replace("|", "\\|").replace("<", "&lt;")
        figures = f"{t.seconds:.1f} | {t.busy:.1f} | {t.mebibytes}"
        lines.append(f"| `{name}` | {t.label} | {text} | {figures} |")
    return "\n".join(lines) + "\n"


def _processor_time() -> float:
    """Of this process and its children that have ended [s]."""
    used = (resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in used)


def _load() -> float:
    """Processes that wanted a core, in the mean over the last 5 minutes; our worker is one."""
    return os.getloadavg()[1]


def _peak_of_children() -> int:
    """Largest resident memory of a child process that has ended [MiB]; Linux counts in KiB."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss // 1024


def _forget_peak() -> None:
    """Begin to measure the largest resident memory anew."""
    try:
        _CLEAR_REFS.write_text("5")
    except OSError:
        return


def _peak() -> int:
    try:
        text = _STATUS.read_text()
    except OSError:
        return 0
    return next(int(x.split()[1]) // 1024 for x in text.splitlines() if x.startswith("VmHWM"))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
