"""How closely the motions of a run keep to their bounds: `python -m benchmarks.arm_bounds RUN [RUN ...]`.

Over all rows with a motion, for the arms of `--rig` or of the run: how far the stored angles put the
palms from the stored grasps at pre-grasp, grasp and squeeze, the largest turn of a joint between two
knots, and the least clearances.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from bidexdata import GraspBatch, Run
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.robot import Robot
from bidexdata.frames import matrix_from_quat, quat_angle, quat_from_matrix
from bidexdata.record import Status
from bidexdata.record.fields import KEY_FRAMES

STAGES = ("pregrasp", "grasp", "squeeze")
CLEARANCES = ("clear_table", "clear_object", "clear_arms", "clear_self")


def palm_errors(
    robot: Robot, batch: GraspBatch | Mapping[str, np.ndarray], side: int
) -> tuple[np.ndarray, np.ndarray]:
    """How far the stored angles of one arm put its palm from the stored grasps.

    Args:
        robot: The robot.
        batch: Rows with motions.
        side: Which arm.

    Returns:
        Distances [m] and angles [rad], (N, 3), at pre-grasp, grasp and squeeze.
    """
    arm, T = robot.arms[side], robot.hands[side].T_hand_palm
    frames = [KEY_FRAMES.index(stage) for stage in STAGES]
    q = batch["arm_joints"][:, side, frames, : arm.chain.joints].astype(np.float64)
    pos, rot = chain_forward(arm.chain, q)
    quat = batch["hand_quat_wxyz"][:, side].astype(np.float64)
    wanted = batch["hand_pos"][:, side] + matrix_from_quat(quat) @ T[:3, 3]
    off = np.linalg.norm(pos + rot @ T[:3, 3] - wanted, axis=-1)
    return off, quat_angle(quat_from_matrix(rot), quat)


def motions(run: Run) -> Iterator[GraspBatch]:
    """Rows with a motion, task by task."""
    armed = run.armed()
    for task in run.tasks:
        if task.task_id in armed:
            batch = run.task_arms(task, run.task_batch(task))
            yield batch.select(batch["arm_status"] == Status.OK)


def bounds(run: Run) -> dict[str, Any]:
    """The largest errors and steps and the least clearances of a run, in millimetres and degrees."""
    robot = run.robot()
    off, turn, step, least = [], [], [], []
    for batch in motions(run):
        for side in range(2):
            pos, rot = palm_errors(robot, batch, side)
            off.append(pos.ravel())
            turn.append(rot.ravel())
        step.append(batch["arm_step"])
        least.append(np.stack([batch[name] for name in CLEARANCES], axis=1))
    clear = 1e3 * np.concatenate(least)
    return {
        "run": run.path.name,
        "rig": run.rig,
        "motions": len(clear),
        "palm_error_mm": 1e3 * float(np.concatenate(off).max()),
        "palm_error_degrees": float(np.degrees(np.concatenate(turn).max())),
        "joint_step_rad": float(np.concatenate(step).max()),
        "clear_mm": dict(zip(CLEARANCES, clear.min(axis=0).tolist(), strict=True)),
        "deeper_than_1_mm": dict(zip(CLEARANCES, (clear < -1.0).sum(axis=0).tolist(), strict=True)),
    }


def main() -> None:
    """Print the figures of some runs as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("runs", nargs="+", metavar="RUN")
    parser.add_argument("--rig", help="the run's when omitted")
    asked = parser.parse_args()
    found = [bounds(Run.open(path, rig=asked.rig)) for path in asked.runs]
    print(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
