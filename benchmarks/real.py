"""Verdicts a second on real meshes with two Shadow hands: `python -m benchmarks.real [FOLDER]`.

FOLDER holds `INDEX.csv`, whose column `file` names meshes in its folder `train`. Rows 1, 8, 15, ...,
three sizes, the first five audit rows that have a grasp; model building included. Beside the rates:
where the time goes, and what the naive loop of DexGraspBench needs for the same verdicts (a scene
per grasp, closing again for every load, every load to its end or its first failing check).
"""

from __future__ import annotations

import argparse
import csv
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.report import report
from benchmarks.rows import TaskRows, over_tasks, pool, task_rows
from bidexdata import Run
from bidexdata.record import GraspBatch
from bidexdata.simulation.noslip import NoslipSteps
from bidexdata.simulation.scene import SimScene
from bidexdata.simulation.state import set_pose
from bidexdata.validation import Execution, Protocol, load_protocol, validate_grasps
from bidexdata.validation.loads import set_load
from bidexdata.validation.stages import Grasp, close_hands
from bidexdata.validation.validate import TESTS, grasp_of, scene_of_rows

MESHES = Path("../shared/objects")
"""Where the meshes are looked for, unless another folder is named."""
EVERY = 7
SIZES = "0.3,0.5,0.8"
PER_SCENE = 5
WORKERS = 2
SAMPLE = 6
"""One grasp of every so many scenes is taken apart, and judged by the naive loop."""
STEPS = 50
"""Steps under the load whose parts are timed."""
PARTS = {
    "collision": "mj_collision",
    "constraint_rows": "mj_makeConstraint",
    "solver": "mj_fwdConstraint",
}
"""The engine's functions by what they do; then come our noslip pass and, of the step, `other`."""
BEFORE = {
    "mj_collision": ("mj_kinematics", "mj_comPos", "mj_tendon", "mj_makeM", "mj_factorM"),
    "mj_makeConstraint": (),
    "mj_fwdConstraint": (
        *("mj_projectConstraint", "mj_transmission"),
        *("mj_fwdVelocity", "mj_fwdActuation", "mj_fwdAcceleration"),
    ),
}
"""What a step calls in between, in its order."""


class Judged(NamedTuple):
    """Verdicts of one task."""

    verdicts: int
    passed: int


class Apart(NamedTuple):
    """One grasp taken apart [s]."""

    compile: float
    verdict: float
    naive: float
    step: float
    """One step under the load."""
    parts: tuple[float, ...]
    """Of it, in the order of `PARTS`, then of the noslip pass."""


def missing(meshes: Path = MESHES) -> str:
    """Why this cannot run; empty where it can."""
    lacking = [name for name in ("INDEX.csv", "train") if not (meshes / name).exists()]
    if not lacking:
        return ""
    return (
        f"no {' and no '.join(lacking)} in {meshes.resolve()}, where real meshes are looked for; "
        "`python -m benchmarks.real FOLDER` looks elsewhere"
    )


def measure(meshes: Path = MESHES) -> dict[str, Any]:
    """Prepare and synthesise, then time the validator for both tests."""
    with tempfile.TemporaryDirectory() as folder:
        at = Path(folder)
        chosen = _chosen_meshes(meshes, at / "meshes.csv")
        _bidexdata("prepare", at / "meshes.csv", "--out", at / "LIB")
        found: dict[str, Any] = {
            "meshes": chosen,
            "grasps_per_scene": PER_SCENE,
            "workers": WORKERS,
        }
        for test, setting in (("f", "floating"), ("l", "tabletop")):
            run = at / setting
            how = ("--hand", "shadow", "--sizes", SIZES, "--grasps", "10", "--setting", setting)
            _bidexdata("synth", at / "LIB", "--out", run, *how)
            found |= {f"{key}_{test}": v for key, v in measure_run(run, test).items()}
    return found


def measure_run(path: Path, test: str, protocol: str = "paper-1") -> dict[str, Any]:
    """Rate, success and breakdown of one test on the first audit rows of every scene of a run."""
    run = Run.open(path)
    with pool(WORKERS) as executor:
        over_tasks(executor, run, _warm_up)
        start = time.perf_counter()
        judged = over_tasks(executor, run, _judge, test, protocol)
        seconds = time.perf_counter() - start
    verdicts = sum(j.verdicts for j in judged)
    apart = [a for i in range(len(run.tasks)) for a in _take_apart(str(path), i, test, protocol)]
    step = sum(a.step for a in apart)
    names = [*PARTS, "noslip"]
    shares = {name: sum(a.parts[k] for a in apart) / step for k, name in enumerate(names)}
    return {
        "objects": len(run.object_ids),
        "verdicts": verdicts,
        "verdicts_per_second": verdicts / seconds,
        "success": sum(j.passed for j in judged) / verdicts,
        "compile_ms": 1e3 * statistics.median(a.compile for a in apart),
        "verdict_ms_one_process": 1e3 * statistics.mean(a.verdict for a in apart),
        "step_us": 1e6 * step / len(apart),
        **{f"share_{name}": share for name, share in shares.items()},
        "share_other": 1.0 - sum(shares.values()),
        "naive_over_ours": sum(a.naive for a in apart) / sum(a.verdict for a in apart),
        "taken_apart": len(apart),
    }


def _chosen_meshes(meshes: Path, target: Path) -> int:
    with (meshes / "INDEX.csv").open() as file:
        names = [row["file"] for row in csv.DictReader(file)][::EVERY]
    rows = [[str((meshes / "train" / name).resolve())] for name in names]
    with target.open("w", newline="") as file:
        csv.writer(file).writerows([["file"], *rows])
    return len(names)


def _bidexdata(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "bidexdata", *map(str, words), "--quiet"], check=True)


def _scenes(rows: TaskRows) -> list[GraspBatch]:
    """The first audit rows of every size and rest pose."""
    audit = rows.batch.select(rows.batch.audit)
    found = [audit.select(audit.scene_id == scene) for scene in np.unique(audit.scene_id)]
    return [batch.select(np.arange(len(batch)) < PER_SCENE) for batch in found]


def _warm_up(path: str, number: int) -> None:
    task_rows(path, number)


def _judge(path: str, number: int, test: str, protocol: str) -> Judged:
    rows, rules = task_rows(path, number), load_protocol(protocol)
    batch = GraspBatch.concat(_scenes(rows))
    success = validate_grasps(batch, rows.solid, rows.hands, rules, test)["success"]
    return Judged(len(success), int(success.sum()))


def _take_apart(path: str, number: int, test: str, protocol: str) -> list[Apart]:
    rows, rules = task_rows(path, number), load_protocol(protocol)
    batches = _scenes(rows)
    found = []
    for k in range(-(number * len(batches)) % SAMPLE, len(batches), SAMPLE):
        batch = batches[k].select(np.arange(len(batches[k])) == 0)
        grasp = grasp_of(batch, 0)
        start = time.perf_counter()
        scene = scene_of_rows(batch, rows.solid, rows.hands, rules, test)
        compiled = time.perf_counter()
        TESTS[test](scene, rules, grasp, Execution())
        judged = time.perf_counter()
        _judge_naively(batch, rows, rules, test)
        naive = time.perf_counter() - judged
        step, parts = _time_steps(scene, rules, grasp)
        found.append(Apart(compiled - start, judged - start, naive, step, parts))
    return found


def _judge_naively(batch: GraspBatch, rows: TaskRows, rules: Protocol, test: str) -> None:
    """A scene per grasp; for each load the whole way from the pre-grasp, until one fails."""
    scene = scene_of_rows(batch, rows.solid, rows.hands, rules, test)
    loads = [(d,) for d in rules.directions] if test == "f" else [rules.directions]
    for directions in loads:
        one = replace(rules, directions=directions)
        verdict = TESTS[test](scene, one, grasp_of(batch, 0), Execution(plain=True))
        if verdict.direction >= 0:
            return


def _time_steps(scene: SimScene, rules: Protocol, grasp: Grasp) -> tuple[float, tuple[float, ...]]:
    """Mean seconds of a step under the load, and of its parts, which are timed on a copy."""
    import mujoco

    model, data, copy = scene.model, scene.data, mujoco.MjData(scene.model)
    noslip, sweeps = NoslipSteps(model, copy), model.opt.noslip_iterations
    at = (grasp.hand_pos[:, 0], grasp.hand_quat[:, 0], grasp.joints[:, 0])
    set_pose(scene, grasp.object_pos, grasp.object_quat, *at)
    close_hands(scene, rules, grasp, Execution())
    set_load(scene, rules, np.array([0.0, 0.0, -1.0]), 1.0)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    steps, parts = [], np.zeros(len(PARTS) + 1)
    for _ in range(STEPS):
        mujoco.mj_getState(model, data, state, kind)
        mujoco.mj_setState(model, copy, state, kind)
        model.opt.noslip_iterations = 0
        for k, name in enumerate(PARTS.values()):
            for before in BEFORE[name]:
                getattr(mujoco, before)(model, copy)
            start = time.perf_counter()
            getattr(mujoco, name)(model, copy)
            parts[k] += time.perf_counter() - start
        start = time.perf_counter()
        noslip.correct(sweeps)
        parts[-1] += time.perf_counter() - start
        model.opt.noslip_iterations = sweeps
        start = time.perf_counter()
        scene.step(1)
        steps.append(time.perf_counter() - start)
    return statistics.fmean(steps), tuple(parts / STEPS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure on the meshes of a folder, print and save results/real.json."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=MESHES, help="default: %(default)s")
    meshes = parser.parse_args(arguments).folder
    reason = missing(meshes)
    if reason:
        parser.exit(3, f"error: {reason}\n")
    report("real", measure(meshes))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
