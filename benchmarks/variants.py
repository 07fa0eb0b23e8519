"""How far each choice that the paper leaves open moves the rates: `python -m benchmarks.variants RUN`.

Every variant judges the same audit rows with synth_status OK; the tables go into docs/protocols.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.rows import over_tasks, pool, task_rows
from bidexdata import Run
from bidexdata.config import with_overrides
from bidexdata.validation import Execution, Protocol, load_protocol, validate_grasps

SHARED: dict[str, tuple[str, ...]] = {
    "paper-1": (),
    "finger gain 1 N m/rad": ("scene.actuator_kp=1.0",),
    "finger gain 20 N m/rad": ("scene.actuator_kp=20.0",),
    "finger gains of the hand's model": ("scene.actuator_kp=null",),
    "finger torque 1 N m": ("scene.actuator_force=1.0",),
    "stages of 0.2 s": ("segment_changes=5",),
    "stages of 1.0 s": ("segment_changes=25",),
    "weld of 0.01 s (four times as stiff)": ("scene.weld_solref=[0.01, 1.0]",),
    "weld of 0.04 s (a quarter as stiff)": ("scene.weld_solref=[0.04, 1.0]",),
    "weld 34 mm below the palm, where DexGraspBench has it": (
        "scene.weld_anchor=[0.0, 0.0, -0.034]",
    ),
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
        "paper-1, every load to its end": (),
        "loads 0.2 s after closing": ("load_after=0.2",),
        "loads 1 s after closing": ("load_after=1.0",),
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


TO_THE_END = {"paper-1, every load to its end", "hold of 1 s", "hold of 6 s"}
"""Variants whose loads do not end early, since they are about how long a load lasts."""


def variants(test: str) -> dict[str, Protocol]:
    """Protocols by what they change."""
    base = load_protocol("paper-1")
    made = {**SHARED, **ONLY[test]}
    return {what: with_overrides(base, [*keys]) for what, keys in made.items()}


def measure(
    run: Run, test: str, rows: int, workers: int = 2, only: str = ""
) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Give every variant with its successes on `rows` audit rows a task, `paper-1` first.

    Args:
        run: The run.
        test: `f` or `l`.
        rows: Audit rows a task.
        workers: Processes.
        only: Besides `paper-1` those alone whose name has this in it.
    """
    with pool(workers) as executor:
        for what, rules in variants(test).items():
            if what != "paper-1" and only not in what:
                continue
            plain = what in TO_THE_END
            parts = over_tasks(executor, run, _judge, test, rows, rules, plain)
            yield what, np.array([v for part in parts for v in part])


def _judge(
    path: str, number: int, test: str, rows: int, rules: Protocol, plain: bool
) -> list[bool]:
    batch, solid, hands = task_rows(path, number)
    batch = batch.select(batch.audit)
    keep = np.linspace(0, len(batch) - 1, min(rows, len(batch))).round().astype(int)
    chosen = np.zeros(len(batch), bool)
    chosen[keep] = True
    how = Execution(plain=plain)
    found = validate_grasps(batch.select(chosen), solid, hands, rules, test, execution=how)
    return found["success"].tolist()


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table as Markdown, line by line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run")
    parser.add_argument("--test", default="f")
    parser.add_argument("--rows", type=int, default=8, help="audit rows a task")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", default="", help="words in the names of variants")
    asked = parser.parse_args(arguments)
    run, base = Run.open(asked.run), np.zeros(0, bool)
    print(f"run {run.fingerprint}, test {asked.test}, {asked.rows} audit rows a task")
    print("| variant of paper-1 | success [%] | same verdict [%] | N |\n|---|---|---|---|")
    for what, success in measure(run, asked.test, asked.rows, asked.workers, asked.only):
        base = base if len(base) else success
        shares = f"{100 * success.mean():.1f} | {100 * np.mean(success == base):.1f}"
        print(f"| {what} | {shares} | {len(success)} |", flush=True)


if __name__ == "__main__":
    main()
