"""Success by the shape of the object: `python -m benchmarks.families RUN`.

Families go by the sides a >= b >= c of the bounding box and by how much of its hull the simulated
solid fills; the first that fits is an object's. Beside the rates: what fails, and the three
worst objects of each.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.report import report
from bidexdata import Run
from bidexdata.objects.prepared import PreparedObject
from bidexdata.record import Status
from bidexdata.record.rates import clustered_interval

BAR, PLATE, ROUND, HOLLOW = 0.3, 0.15, 0.75, 0.2
"""Largest b/a of a bar, largest c/b of a plate, least c/a of a round object, largest share of the
hull that a hollow one fills [-]."""


class Trials(NamedTuple):
    """What became of an object's rows."""

    object_id: str
    family: str
    unselected: tuple[int, int]
    """Passed, tested."""
    selected: tuple[int, int]
    causes: Counter[str]
    """Of selected rows that fail."""


def family_of(obj: PreparedObject) -> str:
    """Name the family of an object."""
    from scipy.spatial import ConvexHull

    c, b, a = np.sort(np.ptp(obj.hull.vertices, axis=0))
    filled = obj.volume / ConvexHull(obj.hull.vertices).volume
    if b < BAR * a:
        return "bar"
    if c < PLATE * b:
        return "plate"
    if filled < HOLLOW:
        return "hollow"
    return "round" if c > ROUND * a else "other"


def measure(path: str, protocol: str, test: str) -> dict[str, object]:
    """Rates of each family, `kept` selected rows per attempt wanted included."""
    run = Run.open(path)
    found = [_trials(run, object_id, protocol, test) for object_id in run.object_ids]
    families = {}
    for name in sorted({t.family for t in found}):
        mine = [t for t in found if t.family == name]
        worst = sorted(mine, key=lambda t: t.selected[0] - t.selected[1])[:3]
        families[name] = {
            "objects": len(mine),
            "unselected": str(clustered_interval(*zip(*(t.unselected for t in mine), strict=True))),
            "selected": str(clustered_interval(*zip(*(t.selected for t in mine), strict=True))),
            "causes": dict(sum((t.causes for t in mine), Counter()).most_common()),
            "worst": {
                t.object_id: f"{t.selected[0]} of {t.selected[1]}"
                for t in worst
                if t.selected[0] < t.selected[1]
            },
        }
    return {"run": run.fingerprint, "protocol": protocol, "test": test, "families": families}


def _trials(run: Run, object_id: str, protocol: str, test: str) -> Trials:
    audited, kept, causes = [0, 0], [0, 0], Counter()
    for task in run.tasks_of(object_id):
        rows = run.task_batch(task, protocol, test)
        passed = rows["success"] == 1
        for count, flag in ((audited, rows.audit), (kept, rows.selected)):
            count[0] += int((passed & flag).sum())
            count[1] += int(flag.sum())
        failed = rows["verdict_status"][rows.selected & ~passed]
        causes.update(Status(int(s)).label for s in failed)
    family = family_of(run.library.load(object_id))
    return Trials(object_id, family, (audited[0], audited[1]), (kept[0], kept[1]), causes)


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
