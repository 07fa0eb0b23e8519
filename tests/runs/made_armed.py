"""A small tabletop run of capsule hands beside a box, its rows made by hand, and a made-up rig."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from bidexdata.frames import invert, matrix_from_quat, pos_quat, quat_canonical
from bidexdata.objects.library import Library
from bidexdata.record import GraspBatch, Header, Status
from bidexdata.record.batch import empty_columns
from bidexdata.record.fields import columns_written_by
from bidexdata.runs.plan import scene_of
from bidexdata.runs.run import Run
from bidexdata.runs.shards import shard_path, write_shard
from bidexdata.runs.synth import SynthRequest, start_run
from bidexdata.synthesis.config import SynthConfig

sys.path.insert(0, str(Path(__file__).parents[1] / "arms"))

from made_rig import write_rig

__all__ = ["made_run", "write_rig"]

GAPS = (0.05, 0.02, 0.0)
"""Palm to the side of the box per stage [m]."""
PER_SCENE = 3


def made_run(
    library: Path,
    out: Path,
    *,
    sizes=(300, 400),
    grasps=1,
    setting="tabletop",
    hand="capsule",
) -> Run:
    """Start a run, and fill the shards of all its tasks."""
    request = SynthRequest(
        config=SynthConfig(), hand=hand, sizes_mm=sizes, setting=setting, grasps=grasps
    )
    run = start_run(Library.open(library), out, request)
    for task in run.tasks:
        path = shard_path(run.stage_folder("rows"), task.task_id)
        if not path.is_file():
            write_shard(path, rows_of_task(run, task).to_arrow(), run.fingerprint)
    return Run.open(out)


def rows_of_task(run: Run, task) -> GraspBatch:
    """Per scene two grasps, from the sides y > 0 and y < 0, and an attempt without one."""
    hands, obj = run.hands(), run.library.load(task.object_id)
    header = Header(
        tuple(hand.header() for hand in hands),
        counts={scene: {"ok": 2, "no_placement": 1} for scene in task.scene_ids},
    )
    n = PER_SCENE * len(task.scene_ids)
    c = empty_columns(header, columns_written_by("synth"), n)
    c["grasp_id"] = np.array([f"{task.task_id[:12]}{k:04x}" for k in range(n)])
    c["scene_id"] = np.repeat(task.scene_ids, PER_SCENE)
    c["object_id"] = np.full(n, task.object_id)
    c["setting"] = np.full(n, run.spec.setting)
    c["sides"][:] = (0, 1)
    c["seed"][:], c["steps"][:] = 1, 0
    c["synth_status"][:] = Status.NO_PLACEMENT
    c["audit"][:] = True
    for number, scene_id in enumerate(task.scene_ids):
        scene = scene_of(scene_id, obj)
        for k in range(PER_SCENE):
            row = PER_SCENE * number + k
            c["attempt"][row], c["size_mm"][row] = k, scene.size_mm
            c["size"][row] = scene.size_mm / 1000
            c["object_pos"][row], c["object_quat_wxyz"][row] = (
                scene.object_pos,
                scene.object_quat_wxyz,
            )
            if k == PER_SCENE - 1:
                continue
            c["synth_status"][row], c["selected"][row] = Status.OK, k == 0
            _place(c, row, hands, obj, scene, height=0.02 * k)
    return GraspBatch(header, c)


def _place(c, row: int, hands, obj, scene, height: float) -> None:
    R = matrix_from_quat(np.array(scene.object_quat_wxyz))
    corners = obj.hull.vertices * scene.size @ R.T + scene.object_pos
    side = corners[:, 1].max()
    for h, hand in enumerate(hands):
        inward = np.array([0.0, -1.0 if h == 0 else 1.0, 0.0])
        fingers = np.array([1.0, 0.0, -1.0]) / np.sqrt(2)
        for s, gap in enumerate(GAPS):
            T = np.eye(4)
            T[:3, :3] = np.stack([fingers, np.cross(inward, fingers), inward], axis=1)
            T[:3, 3] = (0.0, -inward[1] * (side + gap), corners[:, 2].max() / 2 + 0.05 + height)
            pos, quat = pos_quat(T @ invert(hand.T_hand_palm))
            c["hand_pos"][row, h, s], c["hand_quat_wxyz"][row, h, s] = pos, quat_canonical(quat)
            c["joints"][row, h, s, : len(hand.joint_names)] = hand.posture_open
