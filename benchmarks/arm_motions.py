"""What motions of arms cost, and which grasps get one: `python -m benchmarks.arm_motions RUN`.

Rows are the selected ones of a run on a table that pass test l of `paper-1`; those of one object are
solved together, as the stage `arms` does. Times are CPU seconds of one process. Loading the robot,
compiling kernels and, once per object, compiling MuJoCo's scene are apart from the solving. The time
of a step is its own, without that of steps within it.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from bidexdata import GraspBatch, Run
from bidexdata.arms import ArmConfig, candidates, pairing, solve, ways_home
from bidexdata.arms.arm_scene import SizedArmScenes
from bidexdata.arms.registry import load_rig
from bidexdata.arms.robot import Robot, mount_robot
from bidexdata.config import fingerprint, from_plain, to_plain
from bidexdata.objects.prepared import PreparedObject
from bidexdata.record.status import Status
from bidexdata.runs.arms import arm_columns
from bidexdata.runs.rigged import load_arm_kernels

STEPS = {
    "inverse kinematics": [(candidates, "solve_ik"), (candidates, "solve_first")],
    "waypoints": [(candidates, "follow"), (ways_home, "follow")],
    "stand-offs": [(solve, "ways")],
    "surroundings": [(solve, "surroundings"), (solve, "object_along")],
    "clearance of candidates": [(candidates, "clear_at")],
    "candidates": [(solve, "find_candidates")],
    "clearance of ways home": [(ways_home, "clear_at")],
    "planner": [(ways_home, "together")],
    "ways home": [(ways_home.WaysHome, "find"), (ways_home.WaysHome, "__init__")],
    "clearance of pairs": [
        (pairing, "apart_at"),
        (pairing, "look"),
    ],
    "smoothing": [(pairing.Smoother, "smooth")],
    "MuJoCo": [(pairing, "final_words")],
    "pairs": [(pairing.Pairing, "solve"), (pairing.Pairing, "__init__")],
    "errors": [(solve, "_measure")],
    "scenes": [(SizedArmScenes, "at")],
}
"""Functions whose own time is a step's."""
OTHER = "the rest"


class Stopwatch:
    """CPU seconds of some functions, each without those of the others that it calls."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self._open: list[float] = []

    @contextmanager
    def running(self, steps: dict[str, list[tuple[Any, str]]]) -> Iterator[None]:
        """Measure the functions of `steps` as long as the context lasts."""
        kept = [(owner, name, getattr(owner, name)) for f in steps.values() for owner, name in f]
        for step, found in steps.items():
            for owner, name in found:
                setattr(owner, name, self._timed(step, getattr(owner, name)))
        try:
            yield
        finally:
            for owner, name, function in kept:
                setattr(owner, name, function)

    def _timed(self, step: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            start = time.process_time()
            self._open.append(0.0)
            try:
                return function(*args, **kwargs)
            finally:
                whole = time.process_time() - start
                self.seconds[step] += whole - self._open.pop()
                if self._open:
                    self._open[-1] += whole

        return timed


def measure(
    path: str, rig: str, *, half: str = "all", objects: int = 0, changes: Sequence[str] = ()
) -> dict[str, Any]:
    """Solve the arms for a run's grasps and say what it cost and what came of it.

    Args:
        path: The run.
        rig: The rig.
        half: See `chosen_rows`.
        objects: At most so many objects; 0: all.
        changes: Settings that differ, as `key=value`.
    """
    run = Run.open(path)
    start = time.process_time()
    hands = run.hands()
    loaded = time.process_time()
    robot = mount_robot(load_rig(rig), hands)
    mounted = time.process_time()
    config = changed(ArmConfig(), changes)
    watch, solving, compiling = Stopwatch(), [], []
    counts: dict[int, Counter[str]] = defaultdict(Counter)
    rows = list(chosen_rows(run, half, objects))
    warm = _Warm(robot, config)
    for object_id, batch in rows:
        obj = run.library.load(object_id)
        at = time.process_time()
        scenes = SizedArmScenes(robot, obj)
        compiling.append(time.process_time() - at)
        warm(batch, obj, scenes)
        at = time.process_time()
        with watch.running(STEPS):
            found, asked = arm_columns(batch, obj.sdf, scenes, robot, config)
        solving.append((time.process_time() - at) / max(asked, 1))
        for mm, status in zip(batch["size_mm"].tolist(), found["arm_status"].tolist(), strict=True):
            counts[mm][Status(status).label] += 1
    return _figures(run, robot, rows, counts, solving, compiling, watch) | {
        "half": half,
        "config": fingerprint(config),
        "changes": list(changes),
        "seconds_to_load_hands": loaded - start,
        "seconds_to_mount": mounted - loaded,
        "seconds_to_compile_kernels_or_load_them": warm.seconds,
    }


class _Warm:
    """Loads kernels and solvers, and solves two grasps once."""

    def __init__(self, robot: Robot, config: ArmConfig) -> None:
        self.seconds = 0.0
        self._robot, self._config = robot, config

    def __call__(self, batch: GraspBatch, obj: PreparedObject, scenes: SizedArmScenes) -> None:
        if self.seconds:
            return
        start = time.process_time()
        load_arm_kernels("cpu")
        some = batch.select(np.arange(min(2, len(batch))))
        arm_columns(some, obj.sdf, scenes, self._robot, self._config)
        self.seconds = time.process_time() - start


def chosen_rows(run: Run, half: str, objects: int) -> Iterator[tuple[str, GraspBatch]]:
    """Selected rows that pass test l, object by object; objects without one are left out.

    Args:
        run: A run that was validated.
        half: "early" for objects whose source file's sha256 begins with 0-7, "late" for the others,
            "all".
        objects: At most so many of them; 0: all.
    """
    digits = {"early": "01234567", "late": "89abcdef", "all": "0123456789abcdef"}[half]
    wanted = [one for one in run.object_ids if one[-8] in digits]
    for object_id in wanted[: objects or None]:
        found = []
        for task in run.tasks_of(object_id):
            batch = run.task_batch(task)
            verdicts = run.task_verdicts(task, batch, "paper-1", "l")
            found.append(batch.select(batch["selected"] & verdicts["success"]))
        batch = GraspBatch.concat(found)
        if len(batch):
            yield object_id, batch


def changed(config: ArmConfig, changes: Sequence[str]) -> ArmConfig:
    """The configuration with other values, `search.nodes=32`."""
    plain = to_plain(config)
    for change in changes:
        key, _, value = change.partition("=")
        *folders, name = key.split(".")
        place = plain
        for folder in folders:
            place = place[folder]
        place[name] = json.loads(value)
    return from_plain(ArmConfig, plain)


def _figures(
    run: Run,
    robot: Robot,
    rows: list[tuple[str, GraspBatch]],
    counts: dict[int, Counter[str]],
    solving: list[float],
    compiling: list[float],
    watch: Stopwatch,
) -> dict[str, Any]:
    lengths = np.array([len(batch) for _, batch in rows])
    n, total = int(lengths.sum()), float(np.dot(solving, lengths))
    steps = {name: 1e3 * watch.seconds[name] / n for name in STEPS}
    steps[OTHER] = 1e3 * total / n - sum(steps.values())
    every = sum(counts.values(), Counter())
    return {
        "run": run.fingerprint,
        "rig": robot.rig.spec.name,
        "objects": len(rows),
        "n": n,
        "ms_per_grasp": 1e3 * total / n,
        "ms_per_grasp_median_of_objects": 1e3 * statistics.median(solving),
        "ms_by_step": steps,
        "ms_to_compile_a_scene": 1e3 * statistics.median(compiling),
        "ok": every["ok"] / n,
        "ok_by_size": {mm: c["ok"] / sum(c.values()) for mm, c in sorted(counts.items())},
        "by_status": {label: count / n for label, count in every.most_common()},
    }


def main() -> None:
    """Measure a run on one rig or more."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("run")
    parser.add_argument("--rig", action="append", help="default: ur10e_post and iiwa14_facing")
    parser.add_argument("--half", choices=("early", "late", "all"), default="all")
    parser.add_argument("--objects", type=int, default=0, help="at most so many of the half")
    parser.add_argument("--set", action="append", default=[], help="another setting, KEY=VALUE")
    args = parser.parse_args()
    for rig in args.rig or ("ur10e_post", "iiwa14_facing"):
        figures = measure(args.run, rig, half=args.half, objects=args.objects, changes=args.set)
        print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
