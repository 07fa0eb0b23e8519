"""Grasps of a box on the table that arms on both sides reach, and motions to them without a planner."""

from __future__ import annotations

import dataclasses

import numpy as np
from grasps import HALF, batch_of

from bidexdata.arms import IkConfig
from bidexdata.arms.clearance import clearances
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.inverse_kinematics import follow, solve_ik
from bidexdata.arms.solutions import arm_headers, no_solutions
from bidexdata.arms.waypoints import Poses, lifted, line, stand_off
from bidexdata.frames import invert, pos_quat
from bidexdata.record import GraspBatch, Status
from bidexdata.validation.stages import Grasp
from bidexdata.validation.validate import grasp_of

CONFIG = ArmConfig()
GAPS = (0.02, 0.01, 0.0)
"""Palms from the faces at pre-grasp, grasp and squeeze [m]."""


def beside_box(hands, gaps=GAPS, height=HALF, fingers=(1.0, 0.0, -0.3), shift=(0.0, 0.0)):
    """Palms at the faces +y (left) and -y of the cube on the table, as one row."""
    x = np.array(fingers) / np.linalg.norm(fingers)
    poses = []
    for hand, side in zip(hands, (1.0, -1.0), strict=True):
        z = np.array([0.0, -side, 0.0])
        T = np.eye(4)
        T[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        row = []
        for gap in gaps:
            T[:3, 3] = (shift[0], shift[1] + side * (HALF + gap), height)
            row.append(pos_quat(T @ invert(hand.T_hand_palm)))
        poses.append(row)
    width = max(len(h.joint_names) for h in hands)
    joints = np.full((2, 3, width), np.nan)
    for i, hand in enumerate(hands):
        joints[i, :, : len(hand.joint_names)] = 0.0
    grasp = tuple(np.array([[pose[k] for pose in row] for row in poses]) for k in (0, 1))
    return batch_of(hands, [(*grasp, joints)], object_pos=[(*shift, height)])


def with_arms(robot, batch, config=CONFIG) -> GraspBatch:
    """Rows with the columns of arms: of the postures that can follow that clearest of the table."""
    found = no_solutions(robot, config, len(batch))
    for row in range(len(batch)):
        _solve(robot, grasp_of(batch, row), found, row, config)
    header = dataclasses.replace(batch.header, arms=arm_headers(robot, config))
    return GraspBatch(header, {**batch.columns, **found.to_columns()})


def solve_arms(robot, field, scenes, targets, config, device="cpu"):
    """In place of the solver of the package: the same postures as in `with_arms`."""
    found = no_solutions(robot, config, len(targets.hand_pos))
    for row in range(len(targets.hand_pos)):
        grasp = Grasp(
            *(targets.object_pos, targets.object_quat_wxyz, targets.hand_pos[row]),
            *(targets.hand_quat_wxyz[row], targets.joints[row]),
        )
        _solve(robot, grasp, found, row, config)
    return found


def solve_scenes(robot, field, scenes, targets, config, device="cpu"):
    """`solve_arms` of each scene."""
    return [solve_arms(robot, field, scenes, one, config, device) for one in targets]


def _solve(robot, grasp, found, row, config) -> None:
    knots, path = config.path.knots, config.path
    for h, arm in enumerate(robot.arms):
        pre, at, end = (Poses(grasp.hand_pos[h, s], grasp.hand_quat[h, s]) for s in range(3))
        away = -path.standoff * pre.rot @ robot.hands[h].T_hand_palm[:3, 2]
        off = stand_off(pre, away, np.zeros(()), path.lowest)
        back = _joined(line(at, pre, knots[2]), line(pre, off, knots[1]))
        on = _joined(line(at, end, knots[3]), line(end, lifted(end, path.lift), knots[4]))
        solved = solve_ik(arm.chain, at.pos[None], at.rot[None], IkConfig(starts=32))
        q = solved.q[:, solved.ok[0]]
        ways = [follow(arm.chain, q, w.pos[None], w.rot[None], config.ik) for w in (back, on)]
        good = np.ones(q.shape[1], bool)
        for way in ways:
            good &= (way.reached[0] == way.q.shape[2]) & (
                way.step[0].max(axis=1) < path.largest_step
            )
        if not good.any():
            found.arm_status[row] = Status.IK_GRASP
            return
        paths = []
        for k in np.flatnonzero(good):
            ahead = ways[0].q[0, k][::-1]
            approach = np.repeat(ahead[:1], knots[0], axis=0)  # home is the stand-off
            paths.append(np.concatenate([approach, ahead, q[0, k][None], ways[1].q[0, k]]))
        clear = clearances(arm, np.array(paths), None)
        best = np.argmax(np.minimum(clear.table, clear.itself).min(axis=1))
        found.arm_path[row, h, :, : arm.chain.joints] = paths[best]
    found.arm_status[row] = Status.OK
    steps = [s / n for s, n in zip(path.seconds, knots, strict=True) for _ in range(n)]
    found.arm_time[row] = np.concatenate([[0.0], np.cumsum(steps)])


def _joined(first: Poses, second: Poses) -> Poses:
    return Poses(
        np.concatenate([first.pos, second.pos]),
        np.concatenate([first.quat_wxyz, second.quat_wxyz]),
    )
