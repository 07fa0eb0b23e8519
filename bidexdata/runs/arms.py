"""The arms stage: two arms are led to the stored grasps of a run; their motions go to shards."""

from __future__ import annotations

import dataclasses
import logging
import os
import time
from collections import Counter, defaultdict
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bidexdata.config import from_plain, to_plain
from bidexdata.devices import check_device
from bidexdata.errors import NotUsable
from bidexdata.extras import require
from bidexdata.record import GraspBatch, Status
from bidexdata.record.fields import columns_written_by
from bidexdata.record.scene import scene_parts
from bidexdata.runs.arm_folder import (
    ArmsRecord,
    folder_name,
    portable_spec,
    read_record,
    store_record,
    store_spheres,
)
from bidexdata.runs.logs import log_to
from bidexdata.runs.made_with import package_versions
from bidexdata.runs.plan import Task
from bidexdata.runs.rigged import arm_config_of, load_arm_kernels, object_scenes, rig_meant
from bidexdata.runs.run import Run, open_unchanged
from bidexdata.runs.run_source import source_folder
from bidexdata.runs.shards import done_tasks, shard_path, sweep, write_shard
from bidexdata.runs.stage import StageReport, TaskExecution, TaskSummary, run_stage

if TYPE_CHECKING:
    from bidexdata.arms.arm_scene import SizedArmScenes
    from bidexdata.arms.config import ArmConfig
    from bidexdata.arms.robot import Robot
    from bidexdata.arms.solutions import Targets
    from bidexdata.objects.prepared import SignedDistanceGrid, Solid


def arms_run(
    run: Run,
    rig: str | Path | None = None,
    config: ArmConfig | None = None,
    *,
    execution: TaskExecution | None = None,
    device: str = "cpu",
) -> StageReport:
    """Solve the arms for every finished task of a run that is not solved yet.

    Args:
        run: Rows of two hands on a table; unfinished tasks are left out.
        rig: A name, or the path of a rig's spec; that which the grasps were made for when omitted,
            or else the default one.
        config: How motions are searched and checked; when omitted as for the grasps, if these were
            made for the rig, or else the defaults.
        execution: Where and how.
        device: Warp device of the workers.

    Returns:
        What this call did; `good` counts rows whose status is OK.

    Raises:
        NotUsable: Rows that float or have one hand, nothing to solve, no such rig or device, or
            arms that cannot carry the hands and half of the heaviest object.
        ConfigConflict: The run has solutions of this rig that were made with other settings, models
            or hands, or its library has changed.
        MissingExtra: A package that the arms need is not installed.
    """
    require("mujoco", "scipy", "warp", "osqp")
    execution = execution or TaskExecution()
    if execution.executor != "ray":  # whose workers have devices of their own
        check_device(device)
    _check_rows(run)
    record, robot = _record(run, rig, config)
    have = run.done()
    if not have:
        raise NotUsable(f"{run.path} has no finished task yet; run `bidexdata synth` first")
    run.check_source()
    store_record(run.path, record)
    store_spheres(run.path, record.name, robot)
    run = dataclasses.replace(run, asked_rig=record.name)
    tasks = [t for t in execution.part_of(run.tasks) if t.task_id in have]
    folder = run.arms_folder()
    sweep([folder])
    done = done_tasks(folder)
    if execution.executor != "ray" and any(t.task_id not in done for t in tasks):
        load_arm_kernels(device)
    return run_stage(
        tasks,
        done,
        partial(_arms_task, str(run.path), run.fingerprint, record.name, device),
        unit="task",
        logs=run.path / "logs",
        execution=execution,
    )


def arm_columns(
    batch: GraspBatch,
    field: SignedDistanceGrid,
    scenes: SizedArmScenes | None,
    robot: Robot,
    config: ArmConfig,
    *,
    device: str = "cpu",
) -> tuple[GraspBatch, int]:
    """Solve the arms for rows of one object; any sizes and scenes, in any order.

    No row's solution depends on the other rows.

    Args:
        batch: The rows.
        field: Signed distances of the object, at unit diagonal.
        scenes: MuJoCo's scenes of it; None where it refuses to build one.
        robot: The arms with the hands of the rows.
        config: How motions are searched and checked.
        device: A Warp device.

    Returns:
        `grasp_id` and the columns written by "arms", row by row with the arms in the header, and how
        many rows have a grasp. Rows without one get status NO_GRASP.
    """
    from bidexdata.arms.solutions import arm_headers, no_solutions
    from bidexdata.arms.solve import solve_scenes
    from bidexdata.validation.validate import statuses_before

    columns = no_solutions(robot, config, len(batch)).to_columns()
    rows = np.flatnonzero(statuses_before(batch, robot.hands) == Status.OK)
    parts = _of_one_scene(batch, rows)
    targets = [targets_of(batch, some) for some in parts]
    found = solve_scenes(robot, field, scenes, targets, config, device=device)
    for some, motions in zip(parts, found, strict=True):
        for name, values in motions.to_columns().items():
            columns[name][some] = values
    header = dataclasses.replace(batch.header, counts={}, arms=arm_headers(robot, config))
    ordered = {name: columns[name] for name in columns_written_by("arms")}
    return GraspBatch(header, {"grasp_id": batch["grasp_id"], **ordered}), len(rows)


def targets_of(batch: GraspBatch, rows: np.ndarray) -> Targets:
    """Read rows of one scene in float64, quaternions made exactly unit."""
    from bidexdata.arms.solutions import stored_targets

    first = int(rows[0])
    return stored_targets(
        *(batch.object_pos[first], batch.object_quat_wxyz[first], batch["size"][first]),
        *(batch.hand_pos[rows], batch.hand_quat_wxyz[rows], batch.joints[rows]),
    )


def _of_one_scene(batch: GraspBatch, rows: np.ndarray) -> list[np.ndarray]:
    """Part rows by what stands on the table, in the order of their first rows."""
    found: dict[bytes, list[int]] = {}
    for row in rows:
        pose = [batch["size"][row], *batch.object_pos[row], *batch.object_quat_wxyz[row]]
        found.setdefault(np.array(pose, np.float32).tobytes(), []).append(int(row))
    return [np.array(some) for some in found.values()]


def heaviest_object(run: Run) -> float:
    """Mass of the heaviest object of a run's plan [kg], at the weight that its hands squeeze for.

    Where the run does not say, at the density of `paper-1`.
    """
    from bidexdata.runs.weights import weight_of_run
    from bidexdata.simulation.settings import SceneSettings

    kind, value = weight_of_run(run.spec) or ("density", SceneSettings().density)
    if kind == "mass":
        return value
    largest: dict[str, int] = {}
    for task in run.tasks:
        sizes = [scene_parts(scene).size_mm for scene in task.scene_ids]
        largest[task.object_id] = max([largest.get(task.object_id, 0), *sizes])
    volumes = _volumes(run)
    return max(value * volumes[i] * (mm / 1000) ** 3 for i, mm in largest.items())


def _volumes(run: Run) -> dict[str, float]:
    """Volumes at unit diagonal of the objects of a run's library or release; 0 where unknown."""
    if not run.spec.of_release:
        return {t.object_id: run.library.row(t.object_id)["volume"] or 0.0 for t in run.tasks}
    from bidexdata.formats.release import Release

    table = Release.open(source_folder(run.path, run.spec)).objects
    columns = (table.column(name).to_pylist() for name in ("object_id", "volume"))
    return {object_id: volume or 0.0 for object_id, volume in zip(*columns, strict=True)}


def _check_rows(run: Run) -> None:
    if run.spec.setting != "tabletop":
        raise NotUsable(
            f"arms need a table to stand at: {run.path} has {run.spec.setting} rows; make them with "
            "`bidexdata synth --setting tabletop`"
        )
    sides = [hand.side for hand in run.spec.hands]
    if sides != ["left", "right"]:
        raise NotUsable(
            f"a rig carries a left and a right hand: the rows of {run.path} have "
            f"{' and '.join(sides) or 'none'} only"
        )


def _record(run: Run, rig: str | Path | None, config: ArmConfig | None) -> tuple[ArmsRecord, Robot]:
    """Load the rig with the run's hands and say what solutions will be made with.

    Raises:
        NotUsable: The rig cannot be used, or cannot carry hands and object.
    """
    from bidexdata.arms.payload import require_payload
    from bidexdata.arms.registry import load_rig
    from bidexdata.arms.robot import mount_robot

    given = str(rig or rig_meant(run))
    robot = mount_robot(load_rig(given), run.hands())
    require_payload(robot, heaviest_object(run))
    record = ArmsRecord(
        name=folder_name(robot.rig.spec.name),
        rig=portable_spec(given, run.path),
        digest=robot.digest,
        spec=to_plain(robot.rig.spec),
        config=to_plain(config or arm_config_of(run, rig)),
        joint_names={arm.side: arm.chain.joint_names for arm in robot.arms},
        run=run.fingerprint,
        versions=package_versions(),
    )
    return record, robot


def _arms_task(
    run_path: str, run_fingerprint: str, rig: str, device: str, task: Task
) -> TaskSummary:
    run = open_unchanged(run_path, run_fingerprint, rig)
    log_to(run.path / "logs")
    start, cpu = time.monotonic(), time.process_time()
    made = (run_path, run_fingerprint, rig, run.arms_mark())
    robot, config = _robot_and_config(*made)
    batch = run.task_batch(task)
    field, scenes = _object(*made, task.object_id)
    solved, asked = arm_columns(batch, field, scenes, robot, config, device=device)
    write_shard(
        shard_path(run.arms_folder(), task.task_id),
        solved.to_arrow(),
        run.arms_mark(),
        device=device,
        notes={"grasps": asked},
    )
    labels = [Status(int(s)).label for s in solved["arm_status"]]
    by_size: dict[int, Counter[str]] = defaultdict(Counter)
    for mm, label in zip(batch["size_mm"].tolist(), labels, strict=True):
        by_size[mm][label] += 1
    logging.getLogger(__name__).info(
        "task %s arms of %s: %d rows in %.1f s",
        *(task.task_id, rig, len(batch), time.monotonic() - start),
    )
    return TaskSummary(
        len(batch),
        labels.count(Status.OK.label),
        dict(Counter(labels)),
        by_size={mm: dict(counts) for mm, counts in by_size.items()},
        cpu_seconds=time.process_time() - cpu,
        process=os.getpid(),
    )


@lru_cache(maxsize=1)
def _robot_and_config(
    run_path: str, run_fingerprint: str, rig: str, mark: str
) -> tuple[Robot, ArmConfig]:
    """What a worker's tasks of one command have in common; `mark` says that it is the same."""
    from bidexdata.arms.config import ArmConfig

    run = open_unchanged(run_path, run_fingerprint, rig)
    return run.robot(), from_plain(ArmConfig, read_record(run.path, rig).config)


@lru_cache(maxsize=1)
def _object(
    run_path: str, run_fingerprint: str, rig: str, mark: str, object_id: str
) -> tuple[SignedDistanceGrid, SizedArmScenes | None]:
    """Distances and scenes of one object, kept while tasks are of the same."""
    from bidexdata.objects.sdf import grid_of_pieces

    run = open_unchanged(run_path, run_fingerprint, rig)
    robot, _ = _robot_and_config(run_path, run_fingerprint, rig, mark)
    solid: Solid
    if run.spec.of_release:
        solid = run.load_solid(object_id)
        field = grid_of_pieces(solid.pieces)
    else:
        solid = obj = run.library.load(object_id)
        field = obj.sdf
    return field, object_scenes(robot, solid)
