"""What two arms can take of the grasps that lift: `python -m benchmarks.reach RUN [RUN ...]`.

Per run and rig, two tables in Markdown, per size. Reach: of the grasps that pass test l (hands that
float), how many have a motion of the arms, and what stands against the others. Test a: over all
rows, and of those with a motion, with the reasons of failure. Intervals are over objects, 95 %.
Rows are the selected ones; `--rows unselected` takes those of the audit, where an attempt without a
grasp fails. `--half tune` and `--half held_out` count the objects whose file's sha256 begins with 0-7
alone, or the others. A rig's name follows with `--rig`; all that a run has solutions of when omitted.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from benchmarks.selection import tuned_on
from bidexdata import Run
from bidexdata.record import Status
from bidexdata.record.rates import Rate, clustered_interval

Kind = Literal["selected", "unselected"]
Half = Literal["all", "tune", "held_out"]


class Judged(NamedTuple):
    """Rows of one task, (N,) each."""

    object_id: str
    size_mm: np.ndarray
    arm_status: np.ndarray
    """NO_GRASP of rows without a grasp."""
    lifts: np.ndarray | None
    """Pass test l; None where it has not been run."""
    with_arms: np.ndarray | None
    """Verdict status of test a; None where it has not been run."""


class Tally:
    """Counts of one size, by object."""

    def __init__(self) -> None:
        self.objects: dict[str, Counter[str]] = defaultdict(Counter)
        self.arms: Counter[str] = Counter()
        """Arm statuses of the grasps that lift."""
        self.verdicts: Counter[str] = Counter()
        """Verdicts of test a but ok."""

    def add(self, one: Judged, rows: np.ndarray) -> None:
        """Count some rows of a task."""
        counts, reached = self.objects[one.object_id], one.arm_status[rows] == Status.OK
        if one.lifts is not None:
            lifts = one.lifts[rows]
            counts.update(lift=int(lifts.sum()), lift_reached=int((lifts & reached).sum()))
            self.arms.update(_labels(one.arm_status[rows][lifts]))
        if one.with_arms is not None:
            status = one.with_arms[rows]
            good = status == Status.OK
            counts.update(rows=len(status), good=int(good.sum()))
            counts.update(reached=int(reached.sum()), good_reached=int((good & reached).sum()))
            self.verdicts.update(_labels(status[~good]))

    def rate(self, k: str, n: str) -> Rate:
        """Pooled, with an interval over objects."""
        found = self.objects.values()
        return clustered_interval([c[k] for c in found], [c[n] for c in found])


def judged(
    run: Run, protocol: str, kind: Kind = "selected", half: Half = "all"
) -> Iterator[Judged]:
    """Rows of every task that the arms of the run's rig have been asked about."""
    tests = {test: run.done(protocol, test) for p, test in run.verdict_tests() if p == protocol}
    armed = run.armed()
    for task in run.tasks:
        if task.task_id not in armed or (
            half != "all" and tuned_on(task.object_id) != (half == "tune")
        ):
            continue
        batch = run.task_arms(task, run.task_batch(task))
        kept = batch["selected"] if kind == "selected" else batch["audit"]
        found: dict[str, np.ndarray | None] = {"l": None, "a": None}
        for test in found:
            if task.task_id in tests.get(test, ()):
                verdicts = run.task_verdicts(task, batch, protocol, test)
                found[test] = verdicts["verdict_status"][kept]
        lifts = None if found["l"] is None else np.equal(found["l"], Status.OK)
        arms = batch["arm_status"][kept]
        yield Judged(task.object_id, batch["size_mm"][kept], arms, lifts, found["a"])


def tallies(rows: Iterator[Judged]) -> dict[str, Tally]:
    """One per size, by its text in metres, and `all`."""
    found: dict[str, Tally] = {}
    for one in rows:
        for mm in np.unique(one.size_mm).tolist():
            tally = found.setdefault(f"{mm / 1000:.2f} m", Tally())
            tally.add(one, np.flatnonzero(one.size_mm == mm))
        found.setdefault("all", Tally()).add(one, np.arange(len(one.size_mm)))
    return {size: found[size] for size in sorted(found)}


def report(run: Run, protocol: str, kind: Kind = "selected", half: Half = "all") -> list[str]:
    """The two tables of one run and rig, as lines of Markdown."""
    made_for = run.spec.rig.name if run.spec.rig else "no rig"
    sizes = tallies(judged(run, protocol, kind, half))
    lines = [
        f"### {run.path.name} on {run.rig}: {kind} rows, made for {made_for}"
        + ("" if half == "all" else f", {half} objects"),
        "",
        *_table(
            ("size", f"of those that pass l of {protocol}, with a motion", "the others"),
            [(s, str(t.rate("lift_reached", "lift")), _reasons(t.arms)) for s, t in sizes.items()],
        ),
        "",
        *_table(
            ("size", "SUC-A over all", "have a motion", "SUC-A of those", "failures"),
            [
                (
                    size,
                    str(t.rate("good", "rows")),
                    str(t.rate("reached", "rows")),
                    str(t.rate("good_reached", "reached")),
                    _reasons(t.verdicts),
                )
                for size, t in sizes.items()
            ],
        ),
    ]
    return [*lines, ""]


def figures(run: Run, protocol: str, kind: Kind = "selected", half: Half = "all") -> dict[str, Any]:
    """The same as plain data."""
    pairs = {
        "lift_with_motion": ("lift_reached", "lift"),
        "suc_a": ("good", "rows"),
        "reachable": ("reached", "rows"),
        "suc_a_given_reachable": ("good_reached", "reached"),
    }
    return {
        size: {
            **{name: tally.rate(*of).to_dict() for name, of in pairs.items()},
            "arms": dict(tally.arms),
            "verdicts": dict(tally.verdicts),
        }
        for size, tally in tallies(judged(run, protocol, kind, half)).items()
    }


def _labels(status: np.ndarray) -> list[str]:
    return [Status(int(s)).label for s in status]


def _reasons(counts: Counter[str]) -> str:
    """`jump 3, collision_arms 1`, the most frequent first."""
    bad = sorted(
        ((n, label) for label, n in counts.items() if label != "ok"), key=lambda x: (-x[0], x[1])
    )
    return ", ".join(f"{label} {n}" for n, label in bad) or "none"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, or with `--json` the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", metavar="RUN")
    parser.add_argument("--rig")
    parser.add_argument("--protocol", default="paper-1")
    parser.add_argument("--rows", choices=("selected", "unselected"), default="selected")
    parser.add_argument("--half", choices=("all", "tune", "held_out"), default="all")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args(arguments)
    data = {}
    for path in asked.runs:
        rigs = Run.open(path).arm_rigs()
        if not rigs:
            parser.error(f"{path} has no arm solutions; `bidexdata arms {path}` makes them")
        for rig in [asked.rig] if asked.rig else rigs:
            run, of = Run.open(path, rig=rig), (asked.protocol, asked.rows, asked.half)
            if asked.json:
                data[f"{Path(path).name} {rig}"] = figures(run, *of)
            else:
                print("\n".join(report(run, *of)))
    if asked.json:
        print(json.dumps(data, indent=2))


if __name__ == "__main__":
    main()
