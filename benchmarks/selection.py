"""How well analytic figures foretell failure: `python -m benchmarks.selection RUN`.

Area under the ROC curve over the audit rows with a grasp that a run's verdicts are of: the chance
that a grasp that fails has the larger figure than one that passes. 0.5 says nothing, 1 is perfect.
Constants were tuned on objects whose file's sha256 begins with 0 to 7 (`tune`), the others are `held_out`.
`--set friction=0.5` closes the hands on the objects anew, with other numbers of the quasi-static model.
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
from bidexdata.config import with_overrides
from bidexdata.loaders.poses import poses_in_object_frame
from bidexdata.objects.distance_field import device_field
from bidexdata.record import GraspBatch, Status
from bidexdata.simulation.distances import pregrasp_penetration
from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.selection import LEAST_RESIDUAL, LEAST_TURN, doubts
from bidexdata.synthesis.settling import Settled, SettlingConfig, settled

TUNE = "01234567"
"""First digits of the sha256 of files that constants were tuned on."""
CRITERIA = {
    "qp_residual": "coupled residual",
    "qp_residual_shifted": "coupled residual of moved contacts",
    "energy_distance": "distances of the pads",
    "energy_penetration": "penetration energy",
    "energy_self": "overlaps of the hands",
    "energy_pad": "angles of the pads",
    "settled_pressed": "closed: how hard the weaker hand presses",
    "settled_touching": "closed: contacts that press",
    "settled_turned": "closed: how far the object has turned",
}
FEWER_FAIL = ("settled_pressed", "settled_touching")
"""Of these the smaller figure is a grasp's that fails."""


def tuned_on(object_id: str) -> bool:
    """Tell whether constants were tuned on an object: by the first digit of its file's sha256."""
    return object_id.rsplit("-", 1)[-1][0] in TUNE


def auc(figure: NDArray[np.float64], failed: NDArray[np.bool_]) -> float:
    """Chance that a failed row has the larger figure than a passed one; ties count half."""
    from scipy.stats import mannwhitneyu

    bad, good = figure[failed], figure[~failed]
    if not len(bad) or not len(good):
        return float("nan")
    return float(mannwhitneyu(bad, good).statistic / (len(bad) * len(good)))


def measure(
    path: str, protocol: str, test: str, model: SettlingConfig | None = None
) -> dict[str, Any]:
    """The figure of every criterion, over all audit rows and for each cause of failure.

    Args:
        path: Of the run.
        protocol: Whose verdicts.
        test: `f` or `l`.
        model: Closes the hands anew by these numbers; the figures of the run when omitted.
    """
    run = Run.open(path)
    batches = [run.task_batch(task, protocol, test) for task in run.tasks]
    batches = [b.select(b.audit & (b["synth_status"] == Status.OK)) for b in batches]
    rows = GraspBatch.concat(batches)
    if model is None:
        rest = Settled(*(rows[f"settled_{name}"].astype(np.float64) for name in Settled._fields))
    else:
        anew = [_closed_anew(run, b, model) for b in batches if len(b)]
        rest = Settled(*(np.concatenate(parts) for parts in zip(*anew, strict=True)))
    closed = {f"settled_{name}": values for name, values in rest._asdict().items()}
    failed, status = ~rows["success"], rows["verdict_status"]
    causes = [Status(int(s)) for s in np.unique(status[failed])]
    tuned = np.array([tuned_on(str(name)) for name in rows.object_id])
    found: dict[str, Any] = {
        "run": run.fingerprint,
        "protocol": protocol,
        "test": test,
        "n": len(rows),
        "failed": int(failed.sum()),
        "auc": {},
    }
    for name, words in CRITERIA.items():
        figure = closed[name] if name in closed else rows[name].astype(np.float64)
        figure = figure * (-1 if name in FEWER_FAIL else 1)
        of = _halves(figure, failed, tuned)
        for cause in causes:
            among = ~failed | (status == cause)
            of[cause.label] = auc(figure[among], failed[among])
        found["auc"][words] = of
    hands = rows["qp_residual_hand"].astype(np.float64).max(axis=1)
    doubt = doubts(rows["qp_residual_shifted"].astype(np.float64), rest)
    found["exponents"] = {
        name: _exponents(rows["qp_residual_shifted"].astype(np.float64), rest, failed, among)
        for name, among in {"all": tuned | ~tuned, "tune": tuned, "held_out": ~tuned}.items()
    }
    found["auc"]["doubt, the order of the selection"] = _halves(doubt, failed, tuned)
    found["auc"]["residual of the worse hand alone"] = _halves(hands, failed, tuned)
    return found


def _closed_anew(run: Run, rows: GraspBatch, model: SettlingConfig) -> Settled:
    """What another model says of the rows of one object."""
    obj, hands = run.library.load(str(rows.object_id[0])), (run.hands()[0], run.hands()[1])
    where = (rows["object_pos"], rows["object_quat_wxyz"])
    position, quat = poses_in_object_frame(*where, rows["hand_pos"], rows["hand_quat_wxyz"])
    stages = [
        Pose(
            *(position[:, :, stage].astype(np.float64), quat[:, :, stage].astype(np.float64)),
            (
                rows["joints"][:, 0, stage, : len(hands[0].joint_names)].astype(np.float64),
                rows["joints"][:, 1, stage, : len(hands[1].joint_names)].astype(np.float64),
            ),
        )
        for stage in range(3)
    ]
    of = (device_field(obj.sdf, "cpu"), hands, (stages[0], stages[1], stages[2]))
    return settled(*of, rows["size"].astype(np.float64), model)


def _halves(
    figure: NDArray[np.float64], failed: NDArray[np.bool_], tuned: NDArray[np.bool_]
) -> dict[str, float]:
    halves = {"tune": tuned, "held_out": ~tuned}
    return {"all": auc(figure, failed)} | {k: auc(figure[m], failed[m]) for k, m in halves.items()}


def _exponents(
    shifted: NDArray[np.float64],
    rest: Settled,
    failed: NDArray[np.bool_],
    among: NDArray[np.bool_],
) -> dict[str, float]:
    """What a logistic fit makes of the parts of the doubt: odds = shifted^a pressed^b e^(c n) turned^d."""
    from scipy.optimize import minimize

    parts = {
        "shifted": np.log(np.maximum(shifted, LEAST_RESIDUAL)),
        "pressed": np.log(rest.pressed),
        "touching": rest.touching,
        "turned": np.log(np.maximum(rest.turned, LEAST_TURN)),
    }
    x = np.stack(list(parts.values()), axis=1)[among]
    x, y = np.column_stack([x - x.mean(axis=0), np.ones(len(x))]), failed[among]

    def loss(w: NDArray[np.float64]) -> float:
        return float(np.mean(np.logaddexp(0, x @ w) - y * (x @ w)))

    return dict(zip(parts, minimize(loss, np.zeros(x.shape[1])).x.round(3).tolist(), strict=False))


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
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    asked = parser.parse_args(arguments)
    of = (asked.run, asked.protocol, asked.test)
    model = with_overrides(SettlingConfig(), asked.set) if asked.set else None
    print(json.dumps({**measure(*of, model), "overlaps": measure_overlaps(*of)}, indent=2))


if __name__ == "__main__":
    main()
