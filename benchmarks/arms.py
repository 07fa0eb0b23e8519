"""How many poses a second inverse kinematics solves on one core, how many of them, and how well.

Targets are reachable: the poses of random postures within the limits. Times are CPU seconds of one
process, median of five; compilation and the first launch are apart. Real rigs need their models
(MENAGERIE_ROOT, or the network once).
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bidexdata.arms.chain import Chain, chain_forward
from bidexdata.arms.clearance import clearance_between, clearances
from bidexdata.arms.generic_pairs import shape_grid
from bidexdata.arms.inverse_kinematics import IkConfig, follow, solve_first, solve_ik
from bidexdata.arms.reach_report import REASONS, reach_report
from bidexdata.arms.registry import load_rig
from bidexdata.arms.robot import Robot, mount_robot
from bidexdata.arms.surroundings import Placed
from bidexdata.config import fingerprint
from bidexdata.frames import quat_angle, quat_from_matrix
from bidexdata.hands import load_hands

RIGS = {"ur10e_post": "shadow", "iiwa14_facing": "shadow", "xarm7_leap": "leap"}
"""Rigs and the hands on them: the first two with the hand's two wrist joints in the chain."""
TARGETS = 4000
REPEATS = 5


def measure() -> dict[str, Any]:
    """Solves a second, share solved, errors; waypoints and clearances a second; reach."""
    config = IkConfig()
    figures: dict[str, Any] = {"config": fingerprint(config), "targets": TARGETS}
    for name, hand in RIGS.items():
        start = time.process_time()
        robot = mount_robot(load_rig(name), load_hands(hand))
        figures[f"{name}_seconds_to_mount"] = time.process_time() - start
        for arm in robot.arms:
            found = _inverse(arm.chain, config)
            figures |= {f"{name}_{arm.side}_{key}": value for key, value in found.items()}
        figures |= {f"{name}_{key}": value for key, value in _others(robot, config).items()}
    return figures


def cpu_seconds(work: Callable[[], Any], repeats: int = REPEATS) -> float:
    """Median CPU seconds of `work` after one uncounted call."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return statistics.median(times)


def _inverse(chain: Chain, config: IkConfig) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    q = rng.uniform(chain.lower, chain.upper, (TARGETS, chain.joints))
    pos, rot = chain_forward(chain, q)
    compiled = time.process_time()
    solve_first(chain, pos[:1], rot[:1], config)
    compiled = time.process_time() - compiled
    seconds = cpu_seconds(lambda: solve_first(chain, pos, rot, config))
    found = solve_first(chain, pos, rot, config)
    at, turned = chain_forward(chain, found.q)
    off = np.linalg.norm(at - pos, axis=1)
    angle = quat_angle(quat_from_matrix(turned), quat_from_matrix(rot))
    good = (off <= 1.001e-3) & (angle <= math.radians(0.501))
    inside = (found.q >= chain.lower) & (found.q <= chain.upper)
    return {
        "joints": chain.joints,
        "compile_or_load_s": compiled,
        "solves_per_s": TARGETS / seconds,
        "solved_share": float(np.mean(good & inside.all(axis=1))),
        "solved_share_first_start": float(np.mean(good & (found.tried == 1))),
        "solved_share_8_starts": float(np.mean(good & (found.tried <= 8))),
        "iterations_mean": float(found.iterations.mean()),
        "error_mm_mean": float(1e3 * off[good].mean()),
        "error_deg_mean": float(np.degrees(angle[good].mean())),
    }


def _others(robot: Robot, config: IkConfig) -> dict[str, Any]:
    arm, rng = robot.arms[0], np.random.default_rng(1)
    chain, count = arm.chain, 200
    q = rng.uniform(chain.lower, chain.upper, (count, chain.joints))
    pos, rot = chain_forward(chain, q)
    every = cpu_seconds(lambda: solve_ik(chain, pos, rot, config))
    starts = solve_ik(chain, pos, rot, config).q
    line = pos[:, None] + np.linspace(0.02, 0.1, 5)[:, None] * [0, 0, 1.0]
    turns = np.repeat(rot[:, None], 5, axis=1)
    waypoints = cpu_seconds(lambda: follow(chain, starts, line, turns, config))
    placed = Placed(shape_grid(0), np.full(count, 0.5), np.tile([0, 0, 0.3], (count, 1)), rot)
    alone = cpu_seconds(lambda: clearances(arm, starts, placed))
    other = robot.arms[1].chain
    their = rng.uniform(other.lower, other.upper, (count, other.joints))
    pairs = np.tile(np.arange(count, dtype=np.int32)[:, None], (1, 2))
    apart = cpu_seconds(lambda: clearance_between(robot.arms, q, their, pairs))
    report = reach_report(robot, config=IkConfig(starts=32))
    many = count * config.starts
    return {
        "start_us": 1e6 * every / many,
        "waypoint_us": 1e6 * waypoints / (5 * many),
        "clearance_us": 1e6 * alone / many,
        "spheres": len(arm.spheres.radius),
        "self_pairs": len(arm.spheres.against_self),
        "clearance_between_us": 1e6 * apart / count,
        **{f"generic_pairs_{reason}": report.share(reason) for reason in REASONS},
    }
