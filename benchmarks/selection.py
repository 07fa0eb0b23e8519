"""How well analytic figures foretell failure: `python -m benchmarks.selection RUN`.

Area under the ROC curve over the audit rows with a grasp that a run's verdicts are of: the chance
that a grasp that fails has the larger figure than one that passes. 0.5 says nothing, 1 is perfect.
Beside it, how many pre-grasps overlap the object on the hands' own geometry, and how many of those
and of the others pass. The tables go into docs/measurements.md.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bidexdata import Run
from bidexdata.record import GraspBatch, Status
from bidexdata.simulation.distances import pregrasp_penetration
from bidexdata.synthesis.selection import doubts

CRITERIA = {
    "qp_residual": "coupled residual",
    "qp_residual_shifted": "coupled residual of moved contacts",
    "energy_distance": "distances of the pads",
    "energy_penetration": "penetration energy",
    "energy_self": "overlaps of the hands",
    "energy_pad": "angles of the pads",
}


def auc(figure: NDArray[np.float64], failed: NDArray[np.bool_]) -> float:
    """Chance that a failed row has the larger figure than a passed one; ties count half."""
    from scipy.stats import mannwhitneyu

    bad, good = figure[failed], figure[~failed]
    if not len(bad) or not len(good):
        return float("nan")
    return float(mannwhitneyu(bad, good).statistic / (len(bad) * len(good)))


def measure(path: str, protocol: str, test: str) -> dict[str, Any]:
    """The figure of every criterion, over all audit rows and for each cause of failure."""
    batches = [b.select(b.audit) for b in Run.open(path).batches(protocol, test)]
    rows = GraspBatch.concat([b.select(b["synth_status"] == Status.OK) for b in batches])
    failed, status = ~rows["success"], rows["verdict_status"]
    causes = [Status(int(s)) for s in np.unique(status[failed])]
    found: dict[str, Any] = {"n": len(rows), "failed": int(failed.sum()), "auc": {}}
    for name, words in CRITERIA.items():
        figure = rows[name].astype(np.float64)
        of = {"all": auc(figure, failed)}
        for cause in causes:
            among = ~failed | (status == cause)
            of[cause.label] = auc(figure[among], failed[among])
        found["auc"][words] = of
    hands = rows["qp_residual_hand"].astype(np.float64).max(axis=1)
    contacts = np.sum(rows["contact_index"] >= 0, axis=(1, 2))
    doubt = doubts(
        rows["qp_residual_shifted"].astype(np.float64),
        np.sqrt(rows["energy_distance"] / contacts),
        np.sqrt(rows["energy_self"].astype(np.float64)),
    )
    found["auc"]["doubt, the order of the selection"] = {"all": auc(doubt, failed)}
    found["auc"]["residual of the worse hand alone"] = {"all": auc(hands, failed)}
    return found


def measure_overlaps(path: str, protocol: str, test: str) -> dict[str, float]:
    """Share of audit rows whose pre-grasp overlaps the object, and the success of both kinds."""
    run = Run.open(path)
    hands, depth, passed = run.hands(), [], []
    for task in run.tasks:
        rows = run.task_batch(task, protocol, test)
        rows = rows.select(rows.audit & (rows["synth_status"] == Status.OK))
        solid = run.load_solid(task.object_id)
        for scene_id in np.unique(rows.scene_id):
            one = rows.select(rows.scene_id == scene_id)
            start = (
                one[c][:, :, 0].astype(float) for c in ("hand_pos", "hand_quat_wxyz", "joints")
            )
            where = (one.object_pos[0].astype(float), one.object_quat_wxyz[0].astype(float))
            found = pregrasp_penetration(hands, solid, float(one["size"][0]), *where, *start)
            depth.append(found[0])
            passed.append(one["success"])
    deep, success = np.concatenate(depth), np.concatenate(passed)
    overlaps = deep > 0
    return {
        "share": float(overlaps.mean()),
        "largest_m": float(deep.max()),
        "success_overlapping": float(success[overlaps].mean()) if overlaps.any() else np.nan,
        "success_clear": float(success[~overlaps].mean()),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run")
    parser.add_argument("--protocol", default="paper-1")
    parser.add_argument("--test", default="f")
    asked = parser.parse_args(arguments)
    of = (asked.run, asked.protocol, asked.test)
    print(json.dumps({**measure(*of), "overlaps": measure_overlaps(*of)}, indent=2))


if __name__ == "__main__":
    main()
