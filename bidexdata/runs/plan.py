"""The plan: which tasks a run consists of. A task is a chunk of scenes of one object.

The plan is a pure function of the objects, the scenes and the rounds, so every machine that works
on a run computes the same one. A *round* is a number of grasps and attempts per scene; a run
starts with one, and every growth of `--grasps` adds one, so that earlier shards stay valid.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from bidexdata.config import fingerprint
from bidexdata.errors import Contradiction, NotUsable
from bidexdata.objects.prepared import Solid
from bidexdata.record import Scene
from bidexdata.record.scene import Setting, scene_parts
from bidexdata.runs.shards import write_atomically

T = TypeVar("T")
TASK_SECONDS = 60.0
"""What a task should take on one core [s]. Little is lost when a worker dies."""
ATTEMPT_SECONDS = 0.2
"""Assumed time of one attempt, synthesis and start-up shared out [s]; only sizes the tasks."""
MOST_TASKS = 10_000
"""Tasks of a run, about. More make the start and every listing slow."""


@dataclass(frozen=True, slots=True)
class Round:
    """One number of attempts per scene."""

    grasps: int
    """Grasps kept per scene."""
    candidates: int
    """Attempts per scene."""
    first_attempt: int = 0
    """Number of the first attempt: the attempts of all earlier rounds."""


@dataclass(frozen=True, slots=True)
class Task:
    """One row of the plan: all that a worker must know besides the run."""

    task_id: str
    object_id: str
    scene_ids: tuple[str, ...]
    round: int


def plan_tasks(scenes: Mapping[str, Sequence[str]], rounds: Sequence[Round]) -> list[Task]:
    """Cut every object's scenes into tasks, round by round.

    Args:
        scenes: Scene ids per object id.
        rounds: The run's rounds.

    Returns:
        Tasks in the order of rounds, objects and scenes.
    """
    total = sum(len(s) for s in scenes.values())
    tasks = []
    for number, one in enumerate(rounds):
        by_time = TASK_SECONDS / (ATTEMPT_SECONDS * one.candidates)
        length = max(int(by_time), math.ceil(total / MOST_TASKS), 1)
        for object_id in sorted(scenes):
            ids = scenes[object_id]
            # Equal parts: 11 scenes in chunks of at most 4 are 4 + 4 + 3.
            parts = math.ceil(len(ids) / length)
            cuts = [round(k * len(ids) / parts) for k in range(parts + 1)] if parts else []
            for start, end in itertools.pairwise(cuts):
                chunk = tuple(ids[start:end])
                task_id = fingerprint([object_id, chunk, number])
                tasks.append(Task(task_id, object_id, chunk, number))
    return tasks


def take_shard(tasks: Sequence[T], shard: tuple[int, int] | None) -> list[T]:
    """Give machine i of n its part of the plan, i from 0 to n - 1."""
    if shard is None:
        return list(tasks)
    i, n = shard
    return list(tasks[i::n])


def scene_ids_of(
    object_id: str, sizes_mm: Sequence[int], setting: Setting, rest_poses: int = 0
) -> list[str]:
    """Ids of an object's scenes: every size; on a table every size in its first rest poses.

    Args:
        object_id: The object.
        sizes_mm: Bounding-box diagonals [mm].
        setting: Floating scenes have no rest pose.
        rest_poses: How many rest poses to use; an object stores the most probable ones first.
    """
    if setting == "floating":
        return [Scene(object_id, mm).scene_id for mm in sizes_mm]
    return [
        Scene(object_id, mm, "tabletop", pose).scene_id
        for mm in sizes_mm
        for pose in range(rest_poses)
    ]


def scene_of(scene_id: str, solid: Solid) -> Scene:
    """Build the scene that an id names; on a table the object stands in its rest pose."""
    object_id, size_mm, pose = scene_parts(scene_id)
    if object_id != solid.object_id:
        raise NotUsable(f"scene {scene_id} is not one of {solid.object_id}")
    if pose < 0:
        return Scene(object_id, size_mm)
    if pose >= len(solid.rest_heights):
        raise NotUsable(f"{object_id} has {len(solid.rest_heights)} rest poses, none is {pose}")
    height = float(solid.rest_heights[pose]) * size_mm / 1000
    w, x, y, z = (float(q) for q in solid.rest_quats_wxyz[pose])
    return Scene(object_id, size_mm, "tabletop", pose, (0.0, 0.0, height), (w, x, y, z))


def write_plan(path: Path, tasks: Sequence[Task]) -> None:
    """Write `tasks.parquet`, atomically; the same tasks give the same bytes."""
    import pyarrow as pa
    from pyarrow import parquet

    table = pa.table(
        {
            "task_id": pa.array([t.task_id for t in tasks], pa.string()),
            "object_id": pa.array([t.object_id for t in tasks], pa.string()),
            "scene_ids": pa.array([list(t.scene_ids) for t in tasks], pa.list_(pa.string())),
            "round": pa.array([t.round for t in tasks], pa.int16()),
        }
    )
    write_atomically(path, lambda temporary: parquet.write_table(table, temporary))


def read_plan(path: Path) -> list[Task]:
    """Read `tasks.parquet`.

    Raises:
        Contradiction: The file is damaged.
    """
    import pyarrow as pa
    from pyarrow import parquet

    try:
        rows = parquet.read_table(path).to_pylist()
        return [Task(r["task_id"], r["object_id"], tuple(r["scene_ids"]), r["round"]) for r in rows]
    except (pa.ArrowException, OSError, KeyError, TypeError) as err:
        raise Contradiction(
            f"{path}: damaged plan ({type(err).__name__}); delete it and run the command that "
            "started the run again: it writes the same plan, and finished tasks stay"
        ) from err
