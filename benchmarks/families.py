"""Success by the shape of the object: `python -m benchmarks.families RUN [--test l]`.

Families go by the sides a >= b >= c of the bounding box and by how much of its hull the simulated
solid fills; the first that fits is an object's. Then by size, by the half that constants were tuned on
or not, and on tables by how high the object stands. Beside the rates: what fails, and the three worst
objects of each.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.report import report
from benchmarks.selection import tuned_on
from bidexdata import Run
from bidexdata.frames import matrix_from_quat
from bidexdata.objects.prepared import PreparedObject
from bidexdata.record import GraspBatch, Status
from bidexdata.record.rates import Rate, clustered_interval

BAR, PLATE, ROUND, HOLLOW = 0.3, 0.15, 0.75, 0.2
"""Largest b/a of a bar, largest c/b of a plate, least c/a of a round object, largest share of the
hull that a hollow one fills [-]."""
HIGH = 0.04
"""An object that stands at least so high leaves room for fingers beside it [m]."""


@dataclass(slots=True)
class Trials:
    """Rows of an object that belong to a group: how many were tested, and what became of them."""

    audit: list[bool] = field(default_factory=list)
    selected: list[bool] = field(default_factory=list)
    causes: Counter[str] = field(default_factory=Counter)
    """Of selected rows that fail."""

    def add(self, rows: GraspBatch, among: np.ndarray) -> None:
        """Count the rows of a mask."""
        passed = rows["success"] == 1
        self.audit += passed[among & rows.audit].tolist()
        self.selected += passed[among & rows.selected].tolist()
        failed = rows["verdict_status"][among & rows.selected & ~passed]
        self.causes.update(Status(int(s)).label for s in failed)


def family_of(obj: PreparedObject) -> str:
    """Name the family of an object."""
    from scipy.spatial import ConvexHull

    c, b, a = np.sort(np.ptp(obj.hull.vertices, axis=0))
    if b < BAR * a:
        return "bar"
    if c < PLATE * b:
        return "plate"
    if obj.volume < HOLLOW * ConvexHull(obj.hull.vertices).volume:
        return "hollow"
    return "round" if c > ROUND * a else "other"


def heights(obj: PreparedObject, rows: GraspBatch) -> np.ndarray:
    """How high the object of each row stands [m], (N,)."""
    R = matrix_from_quat(rows["object_quat_wxyz"].astype(np.float64))
    return np.ptp(R[:, 2] @ obj.hull.vertices.T, axis=1) * rows["size"]


def groups_of(
    obj: PreparedObject, rows: GraspBatch, *, table: bool
) -> Iterator[tuple[str, np.ndarray]]:
    """Names of the groups that rows of one object belong to, with those that do, (N,)."""
    every = np.ones(len(rows), bool)
    half = "tune" if tuned_on(obj.object_id) else "held_out"
    yield "all", every
    yield half, every
    yield family_of(obj), every
    if table:
        high = heights(obj, rows) >= HIGH
        yield f"at least {100 * HIGH:g} cm high", high
        yield f"{half}, at least {100 * HIGH:g} cm high", high
        yield "lower", ~high
    for size in np.unique(rows["size_mm"]):
        yield f"{size} mm", rows["size_mm"] == size


def measure(path: str, protocol: str, test: str) -> dict[str, object]:
    """Rates of each group."""
    run = Run.open(path)
    found: dict[str, dict[str, Trials]] = defaultdict(lambda: defaultdict(Trials))
    for object_id in run.object_ids:
        obj = run.library.load(object_id)
        for task in run.tasks_of(object_id):
            rows = run.task_batch(task, protocol, test)
            for name, among in groups_of(obj, rows, table=test == "l"):
                found[name][object_id].add(rows, among)
    of = {name: _figures(trials) for name, trials in found.items()}
    return {"run": run.fingerprint, "protocol": protocol, "test": test, **of}


def _figures(trials: dict[str, Trials]) -> dict[str, object]:
    worst = sorted(trials, key=lambda name: trials[name].selected.count(False), reverse=True)[:3]
    return {
        "objects": sum(bool(t.audit or t.selected) for t in trials.values()),
        "unselected": str(_rate([t.audit for t in trials.values()])),
        "selected": str(_rate([t.selected for t in trials.values()])),
        # As many rows are drawn for the audit as are to be selected.
        "kept": sum(len(t.selected) for t in trials.values())
        / max(1, sum(len(t.audit) for t in trials.values())),
        "causes": dict(sum((t.causes for t in trials.values()), Counter()).most_common()),
        "worst": {n: _share(trials[n].selected) for n in worst if not all(trials[n].selected)},
    }


def _rate(of: Sequence[Sequence[bool]]) -> Rate:
    return clustered_interval([sum(passed) for passed in of], [len(passed) for passed in of])


def _share(passed: Sequence[bool]) -> str:
    return f"{sum(passed)} of {len(passed)}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run")
    parser.add_argument("--protocol", default="paper-1")
    parser.add_argument("--test", default="f")
    asked = parser.parse_args(arguments)
    report("families", measure(asked.run, asked.protocol, asked.test))


if __name__ == "__main__":
    main()
