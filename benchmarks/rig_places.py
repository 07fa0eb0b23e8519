"""Where two arms should stand: the reach report of a rig over a grid of places.

    python -m benchmarks.rig_places xarm7_leap --hand leap --x 0,-0.1,-0.2 --y 0.5,0.6,0.7 --z 0.1,0.2,0.3

Arms keep their orientations; fixtures move along with them. The best places come first. Shares are
of 300 generic pairs (bidexdata/arms/generic_pairs.py), by spheres.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace

import numpy as np

from bidexdata.arms.inverse_kinematics import IkConfig
from bidexdata.arms.reach_report import REASONS, reach_report, report_pairs
from bidexdata.arms.registry import load_rig
from bidexdata.arms.robot import Arm, Robot, mount_robot
from bidexdata.hands import load_hands


def moved(robot: Robot, x: float, y: float, z: float) -> Robot:
    """The robot with its bases at (x, +-y, z) [m]."""
    left, right = robot.arms
    arms = (_moved(left, np.array([x, y, z])), _moved(right, np.array([x, -y, z])))
    return replace(robot, arms=arms)


def _moved(arm: Arm, pos: np.ndarray) -> Arm:
    shift = pos - np.array(arm.place.pos)
    before = arm.chain.before_pos.copy()
    before[0] += shift
    still = arm.spheres.joint[:, None] < 0
    spheres = arm.spheres._replace(pos=arm.spheres.pos + np.where(still, shift, 0.0))
    # Without fixtures: those of another place would be in the way.
    return replace(arm, chain=replace(arm.chain, before_pos=before), spheres=spheres, fixtures=())


def main() -> None:
    """Print the grid, best first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rig")
    parser.add_argument("--hand", default="shadow")
    for axis in "xyz":
        parser.add_argument(f"--{axis}", required=True)
    parser.add_argument("--starts", type=int, default=32)
    given = parser.parse_args()
    robot = mount_robot(load_rig(given.rig), load_hands(given.hand))
    grid = [[float(v) for v in getattr(given, axis).split(",")] for axis in "xyz"]
    pairs, config = report_pairs(), IkConfig(starts=given.starts)
    found = []
    for x, y, z in itertools.product(*grid):
        report = reach_report(moved(robot, x, y, z), pairs, config)
        found.append(((x, y, z), report))
    for place, report in sorted(found, key=lambda f: -f[1].share()):
        shares = "  ".join(f"{name} {report.share(name):.3f}" for name in REASONS)
        sizes = " ".join(f"{share:.2f}" for share in report.by_size().values())
        print("(" + ", ".join(f"{v:g}" for v in place) + f")  {shares}  by size {sizes}")


if __name__ == "__main__":
    main()
