"""How far each choice that the paper leaves open moves the rates: `python -m benchmarks.variants RUN`.

Every variant judges the same audit rows with synth_status OK; the tables go into docs/protocols.md.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.rows import over_tasks, pool, task_rows
from bidexdata import Run
from bidexdata.config import with_overrides
from bidexdata.validation import Protocol, load_protocol, validate_grasps

SHARED: dict[str, tuple[str, ...]] = {
    "paper-1": (),
    "finger gain 1 N m/rad": ("scene.actuator_kp=1.0",),
    "finger gain 20 N m/rad": ("scene.actuator_kp=20.0",),
    "finger gains of the hand's model": ("scene.actuator_kp=null",),
    "finger torque 1 N m": ("scene.actuator_force=1.0",),
    "stages of 0.2 s": ("segment_changes=5",),
    "stages of 1.0 s": ("segment_changes=25",),
    "weld twice as stiff (0.01 s)": ("scene.weld_solref=[0.01, 1.0]",),
    "weld half as stiff (0.04 s)": ("scene.weld_solref=[0.04, 1.0]",),
    "friction 0.8": ("scene.friction_slide=0.8",),
    "friction 0.4": ("scene.friction_slide=0.4",),
    "hands feel no gravity": ("scene.hand_gravity_compensation=1.0",),
    "no noslip passes": ("scene.noslip_iterations=0",),
    "timestep 2 ms": ("scene.timestep=0.002", "segment_steps=20", "lift.steps=10"),
    "density 25 kg/m^3": ("scene.density=25.0",),
    "density 250 kg/m^3": ("scene.density=250.0",),
    "0.5 kg": ("scene.mass=0.5",),
}
ONLY: Mapping[str, dict[str, tuple[str, ...]]] = {
    "f": {
        "hold of 1 s": ("hold=1.0",),
        "hold of 6 s": ("hold=6.0",),
        "load as a force on the object alone": ("load=force",),
    },
    "l": {
        "lift of 0.05 m": ("lift.height=0.05", "lift.changes=25"),
        "lift of 0.20 m": ("lift.height=0.2", "lift.changes=100"),
        "lift in 0.4 s": ("lift.steps=2",),
        "judged once, right after the lift": ("lift.hold=0.0",),
    },
}


def variants(test: str) -> dict[str, Protocol]:
    """Protocols by what they change."""
    base = load_protocol("paper-1")
    made = {**SHARED, **ONLY[test]}
    return {what: with_overrides(base, [*keys]) for what, keys in made.items()}


def measure(path: str, test: str, rows: int, workers: int = 2) -> dict[str, Any]:
    """Success and agreement with paper-1 of every variant on the first `rows` audit rows a task."""
    run = Run.open(path)
    found: dict[str, list[bool]] = {}
    with pool(workers) as executor:
        for what, rules in variants(test).items():
            parts = over_tasks(executor, run, _judge, test, rows, rules)
            found[what] = [v for part in parts for v in part]
    base = np.array(found["paper-1"])
    return {
        "run": run.fingerprint,
        "test": test,
        "n": len(base),
        "success": {what: float(np.mean(v)) for what, v in found.items()},
        "agreement": {what: float(np.mean(np.array(v) == base)) for what, v in found.items()},
    }


def _judge(path: str, number: int, test: str, rows: int, rules: Protocol) -> list[bool]:
    batch, solid, hands = task_rows(path, number)
    batch = batch.select(batch.audit)
    keep = np.linspace(0, len(batch) - 1, min(rows, len(batch))).round().astype(int)
    chosen = np.zeros(len(batch), bool)
    chosen[keep] = True
    return validate_grasps(batch.select(chosen), solid, hands, rules, test)["success"].tolist()


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table as Markdown and JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run")
    parser.add_argument("--test", default="f")
    parser.add_argument("--rows", type=int, default=8, help="audit rows a task")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args(arguments)
    figures = measure(asked.run, asked.test, asked.rows, asked.workers)
    print(
        f"| variant of paper-1, test {asked.test}, N = {figures['n']} | success [%] | same verdict [%] |"
    )
    print("|---|---|---|")
    for what, rate in figures["success"].items():
        print(f"| {what} | {100 * rate:.1f} | {100 * figures['agreement'][what]:.1f} |")
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
