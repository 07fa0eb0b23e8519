"""Raw attempts a second on a whole library: `python -m benchmarks.throughput LIBRARY`.

Exactly 20 attempts for every object at six sizes by two worker processes, as `bidexdata synth` does
it: reading objects, regions, placement, optimisation, squeeze, selection and shards included, the start
of the processes and the compilation of kernels not. Median of three runs; the paper's GPU makes 6.73
a second.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.report import report
from bidexdata.objects.library import Library
from bidexdata.runs.stage import TaskExecution
from bidexdata.runs.synth import SynthRequest, synth_library
from bidexdata.synthesis.config import SynthConfig

SIZES_MM = (300, 400, 500, 600, 700, 800)
ATTEMPTS, GRASPS = 20, 5
WORKERS = 2
REPEATS = 3
PAPER = 6.73
"""Grasps a second on an RTX 3090, BiDexGrasp, section 6."""


def measure(library: Path, hand: str) -> dict[str, Any]:
    """Attempts a second of each run, and what they cost."""
    objects = len(Library.open(library).object_ids)
    request = SynthRequest(
        config=SynthConfig(), hand=hand, sizes_mm=SIZES_MM, grasps=GRASPS, candidates=ATTEMPTS
    )
    attempts, rates, cost = objects * len(SIZES_MM) * ATTEMPTS, [], []
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory() as folder:
            ended, cpu = [], []

            def hear(_: object, summary: Any, ended: list = ended, cpu: list = cpu) -> None:
                ended.append(time.perf_counter())
                cpu.append((summary.cpu_seconds, sum(summary.by_status.values())))

            synth_library(
                *(library, Path(folder) / "run", request),
                execution=TaskExecution(workers=WORKERS, quiet=True),
                on_task=hear,
            )
            # From the end of the first task of each worker on: processes start slowly, once.
            counted = sum(n for _, n in cpu[WORKERS:])
            rates.append(counted / (ended[-1] - ended[WORKERS - 1]))
            cost.append(sum(s for s, _ in cpu) / sum(n for _, n in cpu))
    return {
        "objects": objects,
        "attempts": attempts,
        "attempts_per_second": statistics.median(rates),
        "of_each_run": rates,
        "cpu_ms_per_attempt": 1e3 * statistics.median(cost),
        "over_the_papers_gpu": statistics.median(rates) / PAPER,
    }


def main(argv: Sequence[str] | None = None) -> None:
    """Read the command line and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("library", type=Path)
    parser.add_argument("--hand", default="shadow")
    given = parser.parse_args(argv)
    report("throughput", measure(given.library, given.hand))


if __name__ == "__main__":
    main()
