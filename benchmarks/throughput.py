"""Raw attempts a second on a whole library: `python -m benchmarks.throughput LIBRARY`.

Exactly 20 attempts for every object at six sizes by two worker processes, as `bidexdata synth` does
it: reading objects, regions, placement, optimisation, squeeze, selection and shards included, the start
of the processes and the compilation of kernels not. So each worker counts from the end of its own
first task on. Median of three runs; the paper's GPU makes 6.73 a second. Beside it what the attempts
are worth before any test: how many give a grasp, and the QP residual of the audit rows.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.report import report
from bidexdata import Library, Run
from bidexdata.record import GraspBatch, Status
from bidexdata.runs.plan import Task
from bidexdata.runs.stage import StageReport, TaskExecution, TaskSummary
from bidexdata.runs.synth import SynthRequest, synth_library
from bidexdata.synthesis.config import SynthConfig
from bidexdata.wording import counted

SIZES_MM = (300, 400, 500, 600, 700, 800)
ATTEMPTS, GRASPS = 20, 5
WORKERS = 2
REPEATS = 3
PAPER = 6.73
"""Grasps a second on an RTX 3090, BiDexGrasp, section 6."""


class Done(NamedTuple):
    """One task that a worker has done."""

    process: int
    """The worker's."""
    ended: float
    """When it was heard of [s]; clocks of one process."""
    attempts: int
    cpu_seconds: float


class Speed(NamedTuple):
    """Of all workers together."""

    per_second: float
    """Attempts."""
    cpu_seconds: float
    """Per attempt."""


def speed_of(done: Sequence[Done], workers: int = WORKERS) -> Speed | None:
    """Add up the workers' speeds, each from the end of its own first task to the end of the run.

    Args:
        done: In the order of their ends.
        workers: How many there are.

    Returns:
        None where not every worker has done a second task.
    """
    began: dict[int, float] = {}
    attempts, cpu = Counter[int](), 0.0
    for one in done:
        if one.process in began:
            attempts[one.process] += one.attempts
            cpu += one.cpu_seconds
        else:
            began[one.process] = one.ended
    if len(attempts) < workers:
        return None
    rates = (n / (done[-1].ended - began[process]) for process, n in attempts.items())
    return Speed(sum(rates), cpu / attempts.total())


def measure(library: Path, hand: str) -> dict[str, Any]:
    """Attempts a second of each run, what they cost, and the quality of the last run's rows."""
    request = SynthRequest(
        config=SynthConfig(), hand=hand, sizes_mm=SIZES_MM, grasps=GRASPS, candidates=ATTEMPTS
    )
    speeds, figures = [], {}
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory() as folder:
            speed, made = _timed(library, Path(folder) / "run", request)
            speeds.append(speed)
            figures = quality(Run.open(Path(folder) / "run"), made)  # the same each time
    rates = [speed.per_second for speed in speeds]
    return {
        "objects": len(Library.open(library).object_ids),
        **figures,
        "attempts_per_second": statistics.median(rates),
        "of_each_run": rates,
        "cpu_ms_per_attempt": 1e3 * statistics.median(speed.cpu_seconds for speed in speeds),
        "over_the_papers_gpu": statistics.median(rates) / PAPER,
    }


def quality(run: Run, made: StageReport) -> dict[str, Any]:
    """Which run it is, how many attempts gave a grasp, and the median residual of its audit rows."""
    rows = GraspBatch.concat(list(run.batches()))
    residual = rows["qp_residual"][rows["audit"] & (rows["synth_status"] == Status.OK)]
    attempts = sum(made.by_status.values())
    return {
        "run": run.fingerprint,
        "attempts": attempts,
        "attempts_with_a_grasp": made.by_status.get(Status.OK.label, 0) / attempts,
        "qp_residual_median": float(np.median(residual)) if len(residual) else None,
    }


def _timed(library: Path, out: Path, request: SynthRequest) -> tuple[Speed, StageReport]:
    done: list[Done] = []

    def hear(_: Task, summary: TaskSummary) -> None:
        attempts = sum(summary.by_status.values())
        done.append(Done(summary.process, time.perf_counter(), attempts, summary.cpu_seconds))

    execution = TaskExecution(workers=WORKERS, quiet=True)
    made = synth_library(library, out, request, execution=execution, on_task=hear)
    if made.failures:
        raise SystemExit(f"{library}: {made.failures[0].reason}")
    speed = speed_of(done)
    if speed is None:
        raise SystemExit(
            f"{library}: {counted(made.tasks, 'task')} for {WORKERS} workers: speed counts from the end "
            "of each worker's first task, so each must do a second; give a library of more objects"
        )
    return speed, made


def main(argv: Sequence[str] | None = None) -> None:
    """Read the command line and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("library", type=Path)
    parser.add_argument("--hand", default="shadow")
    given = parser.parse_args(argv)
    report("throughput", measure(given.library, given.hand))


if __name__ == "__main__":
    main()
