"""The validator's verdicts against plain simulation: `python -m benchmarks.truth RUN`.

Plain: every load to its end and all of a step by the engine, as `Execution(plain=True)` runs it. Of
the rows with a grasp all audit rows are taken, and if too few of them fail, then the selected rows
that fail under plain simulation, by grasp_id, until there are enough. Plain runs cost 2 to 3 s of a
core each, and few selected rows fail: a run of 1200 rows takes half an hour.

How much of a difference is the engine's own: grasps that fail under plain simulation run plainly
once more with the object 0.1 um aside, and those whose verdicts differ eight times.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from benchmarks.rows import over_tasks, pool, task_rows
from bidexdata import Run
from bidexdata.record import GraspBatch, Status
from bidexdata.validation import Execution, load_protocol, validate_grasps

LEAST = 300
"""Grasps compared at least, or the run is too small."""
FAILING = 120
"""Of which fail under plain simulation, if the run has so many."""


ASIDE = 1e-7
"""How far aside the object starts when a plain run is repeated [m]."""
REPEATS = 8
"""Plain runs more of a grasp whose verdicts differ."""


class Pair(NamedTuple):
    """Verdicts on one grasp."""

    grasp_id: str
    quick: bool
    plain: bool
    again: tuple[bool, ...]
    """Plain verdicts with the object a little aside: none where both verdicts are passes."""

    @property
    def false_pass(self) -> bool:
        """Whether the quick verdict alone is a pass."""
        return self.quick and not self.plain


def measure(
    path: str, test: str, protocol: str, workers: int = 2, wanted: int = FAILING
) -> dict[str, Any]:
    """Compare audit rows, then selected rows that fail, until enough do."""
    run = Run.open(path)
    _require_enough(path, _rows_at_most(run, selected=wanted > 0))  # before anything is simulated
    with pool(workers) as executor:
        pairs = _pairs(executor, run, test, protocol, "audit")
        failing = sum(not p.plain for p in pairs)
        if failing < wanted:
            selected = _pairs(executor, run, test, protocol, "selected")
            more = sorted(p for p in selected if not p.plain)[: wanted - failing]
            pairs += more
            failing += len(more)
    _require_enough(path, len(pairs))
    return {
        "run": run.fingerprint,
        "test": test,
        "protocol": protocol,
        "n": len(pairs),
        "failing": failing,
        "different": sum(p.quick != p.plain for p in pairs),
        "false_passes": sum(p.false_pass for p in pairs),
        "false_passes_of_plain_itself": sum(not p.plain and p.again[0] for p in pairs),
        "plain_again_as_quick": {
            p.grasp_id: sum(again == p.quick for again in p.again)
            for p in pairs
            if p.quick != p.plain
        },
    }


def _rows_at_most(run: Run, *, selected: bool) -> int:
    """How many rows with a grasp can be compared: audit rows, and selected ones where they are."""
    batches = (run.task_batch(task) for task in run.tasks)
    return sum(
        int(np.sum((b.audit | (b.selected & selected)) & (b.synth_status == Status.OK)))
        for b in batches
    )


def _require_enough(path: str, grasps: int) -> None:
    if grasps < LEAST:
        raise SystemExit(f"{path}: {grasps} grasps; {LEAST} are needed")


def _pairs(
    executor: ProcessPoolExecutor, run: Run, test: str, protocol: str, which: str
) -> list[Pair]:
    parts = over_tasks(executor, run, _compare, test, protocol, which)
    return [pair for part in parts for pair in part]


def _compare(path: str, number: int, test: str, protocol: str, which: str) -> list[Pair]:
    batch, solid, hands = task_rows(path, number)
    batch = batch.select(batch.audit if which == "audit" else batch.selected & ~batch.audit)
    rules = load_protocol(protocol)

    def success(rows: GraspBatch, *, quick: bool) -> list[bool]:
        how = Execution(plain=not quick)
        return validate_grasps(rows, solid, hands, rules, test, execution=how)["success"].tolist()

    quick, plain = success(batch, quick=True), success(batch, quick=False)
    pairs = []
    for k, (q, p) in enumerate(zip(quick, plain, strict=True)):
        one = batch.select(np.arange(len(batch)) == k)
        shifts = range(1, 1 + (REPEATS if q != p else 0 if p else 1))
        again = tuple(success(_aside(one, n * ASIDE), quick=False)[0] for n in shifts)
        pairs.append(Pair(str(batch.grasp_id[k]), q, p, again))
    return pairs


def _aside(batch: GraspBatch, x: float) -> GraspBatch:
    """The same grasps with the object `x` aside [m]."""
    moved = batch.object_pos + np.array([x, 0.0, 0.0], np.float32)
    return GraspBatch(batch.header, {**batch.columns, "object_pos": moved})


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the comparison as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run")
    parser.add_argument("--test", default="f")
    parser.add_argument("--protocol", default="paper-1")
    parser.add_argument("--workers", type=int, default=2)
    words = "failing grasps to look for among selected rows; 0: audit rows alone (%(default)s)"
    parser.add_argument("--failing", type=int, default=FAILING, help=words)
    asked = parser.parse_args(arguments)
    how = (asked.test, asked.protocol, asked.workers, asked.failing)
    print(json.dumps(measure(asked.run, *how), indent=2))


if __name__ == "__main__":
    main()
