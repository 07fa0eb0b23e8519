"""The synth stage: a library and a configuration become a run with one shard per task."""

from __future__ import annotations

import dataclasses
import logging
import os
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.config import fingerprint, from_plain, to_plain
from bidexdata.devices import check_device
from bidexdata.errors import BadConfig, BadValue, NotUsable
from bidexdata.extras import require
from bidexdata.kinds import kind_of
from bidexdata.record import GraspBatch, Status
from bidexdata.record.scene import Setting, scene_parts, setting_of
from bidexdata.runs.arm_folder import store_spheres
from bidexdata.runs.logs import log_to
from bidexdata.runs.made_with import package_versions
from bidexdata.runs.plan import (
    Round,
    Task,
    plan_tasks,
    read_plan,
    scene_ids_of,
    scene_of,
    write_plan,
)
from bidexdata.runs.rigged import load_arm_kernels, reach_of_object, rig_of_run, robot_of_run
from bidexdata.runs.run import Run, open_unchanged
from bidexdata.runs.run_folder import PLAN_FILE, refuse_foreign
from bidexdata.runs.shards import done_tasks, shard_path, sweep, write_shard
from bidexdata.runs.spec import (
    RunSpec,
    grown,
    portable_hand,
    read_spec,
    relative_to_run,
    write_spec,
)
from bidexdata.runs.stage import StageReport, TaskExecution, TaskSummary, run_stage
from bidexdata.synthesis.method_names import DEFAULT_METHOD

if TYPE_CHECKING:
    from bidexdata.objects.library import Library
    from bidexdata.synthesis.methods import MethodConfig

PAPER_SIZES_MM = tuple(range(300, 801, 50))
"""The paper's eleven sizes, 0.30 to 0.80 m (section 6)."""
DEFAULT_GRASPS = 10
DEFAULT_REST_POSES = 1
"""Rest poses of each object-size: objects have up to 16, and sizes multiply them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SynthRequest:
    """What `bidexdata synth` was asked for."""

    config: MethodConfig
    """Its class is that of the method."""
    method: str = DEFAULT_METHOD
    preset: str = "default"
    hand: str = "shadow"
    sizes_mm: tuple[int, ...] = PAPER_SIZES_MM
    setting: Setting = "floating"
    rest_poses: int | None = None
    """Rest poses used of each object, the most probable first; None: 1 on a table."""
    grasps: int | None = None
    """Grasps kept per scene; None: what the run has, or 10."""
    candidates: int | None = None
    """Attempts per scene; None: the configuration's multiple of the grasps."""
    seed: int = 0
    rig: str | Path = ""
    """Arms that must be able to take the grasps: a name, or the path of a spec; empty: none."""

    def __post_init__(self) -> None:
        from bidexdata.synthesis.methods import load_method

        setting_of(self.setting)
        method = load_method(self.method)
        if self.preset != "default" and self.method != DEFAULT_METHOD:
            raise BadConfig(
                f"--preset {self.preset} belongs to the method {DEFAULT_METHOD}; {self.method} has "
                "none"
            )
        if self.setting == "tabletop" and not method.tabletop:
            raise BadConfig(f"--method {self.method} knows no table; use --setting floating")
        if not self.sizes_mm or any(not 10 <= mm <= 5000 for mm in self.sizes_mm):
            raise BadValue("--sizes: give sizes in metres between 0.01 and 5, such as 0.3,0.5")
        twice = [mm for mm, n in Counter(self.sizes_mm).items() if n > 1]
        if twice:
            raise BadValue(f"--sizes: {twice[0] / 1000:g} is there more than once; give it once")
        if self.grasps is not None and not 1 <= self.grasps <= 10_000:
            raise BadValue(f"--grasps {self.grasps}: give a number from 1 to 10000")
        if self.candidates is not None and self.candidates < (self.grasps or 1):
            raise BadValue(f"--candidates {self.candidates}: give at least one per grasp kept")
        if self.rest_poses is not None and self.setting == "floating":
            raise BadConfig(
                "--rest-poses belongs to --setting tabletop: a floating object has none"
            )
        if self.rig and self.setting == "floating":
            raise BadConfig(
                "--rig belongs to --setting tabletop: arms need a table to stand at, and a floating "
                "object has none"
            )
        if self.rest_poses is not None and self.rest_poses < 1:
            raise BadValue(f"--rest-poses {self.rest_poses}: give at least 1")


def synth_library(
    library: str | Path,
    out: str | Path,
    request: SynthRequest,
    *,
    execution: TaskExecution | None = None,
    device: str = "cpu",
    on_task: Callable[[Task, TaskSummary], None] | None = None,
) -> StageReport:
    """Synthesise grasps for every object of a library, or go on where a run stopped.

    Args:
        library: Its folder.
        out: Folder of the run.
        request: What to make.
        execution: Where and how.
        device: Warp device of the workers.
        on_task: Hears of every task that this call has done.

    Raises:
        PathNotFound: There is no library.
        UnknownName: There is no such hand or rig.
        NotUsable: There is no such device, or the rig cannot be used.
        ConfigConflict: `out` is a run of another configuration.
        MissingExtra: A package that synthesises is not installed.
    """
    from bidexdata.objects.library import Library

    require("mujoco", "scipy", "warp", *(("osqp",) if request.rig else ()))
    execution = execution or TaskExecution()
    if execution.executor != "ray":  # whose workers have devices of their own
        check_device(device)
    run = start_run(Library.open(library), Path(out), request)
    tasks = execution.part_of(run.tasks)
    sweep([run.stage_folder("rows")])
    done = done_tasks(run.stage_folder("rows"))
    if run.spec.rig is not None and any(t.task_id not in done for t in tasks):
        store_spheres(run.path, run.spec.rig.name, robot_of_run(run))
        if execution.executor != "ray":
            load_arm_kernels(device)
    return run_stage(
        tasks,
        done,
        partial(_synth_task, str(run.path), run.fingerprint, device),
        unit="task",
        logs=run.path / "logs",
        execution=execution,
        on_task=on_task,
    )


def start_run(library: Library, out: Path, request: SynthRequest) -> Run:
    """Create the run folder, or open it and let `--grasps` grow; write run.json and the plan."""
    old = read_spec(out) if kind_of(out) == "run" else None
    if old is None:
        refuse_foreign(out)
        sweep([out])
    wanted = _wanted(library, out, request, old)
    # The library or the rig may have moved: where they lie now is no other configuration.
    moved = {"source": wanted.source, "rig": wanted.rig}
    spec = wanted if old is None else replace(grown(out, old, wanted), **moved)
    out.mkdir(parents=True, exist_ok=True)
    if spec != old:
        write_spec(out, spec)
        open_unchanged.cache_clear()  # inline tasks of this process must see a new round
    _write_missing_rounds(library, out, spec, fresh=old is None)
    return Run(out, spec)


def _wanted(library: Library, out: Path, request: SynthRequest, old: RunSpec | None) -> RunSpec:
    from bidexdata.hands import load_hands

    if not library.object_ids:
        raise NotUsable(f"{library.path} holds no prepared object; `bidexdata info` says why")
    hands = load_hands(request.hand)
    had = old.grasps if old else None
    grasps = request.grasps or had or DEFAULT_GRASPS
    per_grasp = request.config.selection.candidates_per_grasp
    if request.candidates is not None:
        candidates = request.candidates
    elif old is not None and had is not None and old.candidates is not None:
        candidates = old.candidates + max(grasps - had, 0) * per_grasp
    else:
        candidates = grasps * per_grasp
    spec = RunSpec(
        method=request.method,
        preset=request.preset,
        config=to_plain(request.config),
        hand=portable_hand(request.hand, out),
        hands=tuple(h.header() for h in hands),
        sizes_mm=tuple(sorted(request.sizes_mm)),
        setting=request.setting,
        rest_poses=_rest_poses(request),
        without_scene=_without_scene(library, request),
        source=relative_to_run(library.path, out),
        source_fingerprint=library.fingerprint,
        seed=request.seed,
        rounds=(Round(grasps, candidates),),
        versions=package_versions(),
    )
    if not request.rig:
        return spec
    known = old.rig.config if old is not None and old.rig is not None else None
    return replace(spec, rig=rig_of_run(request.rig, hands, out, library, spec, known))


def _rest_poses(request: SynthRequest) -> int:
    return 0 if request.setting == "floating" else request.rest_poses or DEFAULT_REST_POSES


def _without_scene(library: Library, request: SynthRequest) -> tuple[str, ...]:
    if request.setting == "floating":
        return ()
    poses = _poses_of(library)
    return tuple(i for i in library.object_ids if not poses[i])


def _poses_of(library: Library) -> dict[str, int]:
    """Number of rest poses of each object."""
    return {i: library.row(i)["rest_poses"] or 0 for i in library.object_ids}


def _write_missing_rounds(library: Library, out: Path, spec: RunSpec, *, fresh: bool) -> None:
    path = out / PLAN_FILE
    # A plan that was there before run.json may be another command's.
    planned = read_plan(path) if path.exists() and not fresh else []
    known = {t.round for t in planned}
    if known == set(range(len(spec.rounds))):
        return
    poses = _poses_of(library)
    scenes = {
        i: scene_ids_of(i, spec.sizes_mm, spec.setting, min(poses[i], spec.rest_poses))
        for i in library.object_ids
    }
    new = [t for t in plan_tasks(scenes, spec.rounds) if t.round not in known]
    write_plan(path, [*planned, *new])


def _synth_task(run_path: str, run_fingerprint: str, device: str, task: Task) -> TaskSummary:
    from bidexdata.synthesis.methods import load_method
    from bidexdata.synthesis.pipeline import synthesize

    run = open_unchanged(run_path, run_fingerprint)
    log_to(run.path / "logs")
    start, cpu = time.monotonic(), time.process_time()
    obj = run.library.load(task.object_id)
    left, right = run.hands()
    one = run.spec.rounds[task.round]
    batch = synthesize(
        obj,
        (left, right),
        [scene_of(s, obj) for s in task.scene_ids],
        from_plain(load_method(run.spec.method or DEFAULT_METHOD).config, run.spec.config),
        round_seed(run.spec.seed, task.round),
        run_fingerprint=run.fingerprint,
        grasps=one.grasps,
        candidates=one.candidates,
        first_attempt=one.first_attempt,
        device=device,
        reach=reach_of_object(run, task.object_id, device=device),
    )
    batch = with_run_header(batch, run)
    path = shard_path(run.stage_folder("rows"), task.task_id)
    write_shard(path, batch.to_arrow(), run.fingerprint, device=device)
    counts: Counter[str] = Counter()
    by_size: dict[int, Counter[str]] = defaultdict(Counter)
    for scene_id, found in batch.header.counts.items():
        counts.update(found)
        by_size[scene_parts(scene_id).size_mm].update(found)
    seconds = time.monotonic() - start
    logging.getLogger(__name__).info(
        "task %s: %d rows in %.1f s", task.task_id, len(batch), seconds
    )
    good = int((batch["selected"] & (batch["synth_status"] == Status.OK)).sum())
    kept = set(batch["scene_id"][batch["selected"]].tolist())
    without = tuple(s for s in task.scene_ids if s not in kept)
    sized = {size: dict(found) for size, found in by_size.items()}
    cpu = time.process_time() - cpu
    return TaskSummary(len(batch), good, dict(counts), without, sized, cpu, os.getpid())


def round_seed(seed: int, number: int) -> int:
    """Seed of a run's round; the first round's is the run's own."""
    return seed if number == 0 else int(fingerprint([seed, number], 12), 16)


def with_run_header(batch: GraspBatch, run: Run) -> GraspBatch:
    """Say in a batch's header which run its rows come from."""
    prints = {
        "run": run.fingerprint,
        "library": run.spec.source_fingerprint,
        "synth": fingerprint(run.spec.config),
    }
    version = package_versions()["bidexdata"]
    header = dataclasses.replace(batch.header, fingerprints=prints, version=version)
    return dataclasses.replace(batch, header=header)
