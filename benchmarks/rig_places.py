"""Where two arms should stand: the reach report of a rig over a grid of places.

    python -m benchmarks.rig_places xarm7_leap --hand leap --x 0,-0.1,-0.2 --y 0.5,0.6,0.7 --z 0.1,0.2,0.3

    python -m benchmarks.rig_places iiwa14_facing --run RUN --x -0.3,0 --y 0.6,0.8 --z 0.3,0.5

Arms keep their orientations, or turn about the vertical (--yaw); fixtures are left out. The best places
come first. Shares are of 300 generic pairs (bidexdata/arms/generic_pairs.py), by spheres; or of grasps
of a run that pass test l, solved whole but for MuJoCo's word.
"""

from __future__ import annotations

import argparse
import itertools
from collections import Counter
from dataclasses import replace

import numpy as np

from benchmarks.arm_motions import chosen_rows
from bidexdata import Run
from bidexdata.arms import ArmConfig
from bidexdata.arms.inverse_kinematics import IkConfig
from bidexdata.arms.reach_report import REASONS, reach_report, report_pairs
from bidexdata.arms.registry import load_rig
from bidexdata.arms.robot import Arm, Robot, mount_robot
from bidexdata.hands import load_hands
from bidexdata.record.status import Status
from bidexdata.runs.arms import arm_columns

Place = tuple[float, float, float, float]
"""x, y, z [m], yaw [deg]."""


def moved(robot: Robot, x: float, y: float, z: float, yaw: float = 0.0) -> Robot:
    """The robot with its bases at (x, +-y, z) [m], turned by +-yaw about the vertical [rad]."""
    left, right = robot.arms
    arms = (_moved(left, np.array([x, y, z]), yaw), _moved(right, np.array([x, -y, z]), -yaw))
    return replace(robot, arms=arms)


def _moved(arm: Arm, pos: np.ndarray, yaw: float) -> Arm:
    place = np.array(arm.place.pos)
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    before, rot = arm.chain.before_pos.copy(), arm.chain.before_rot.copy()
    before[0], rot[0] = turn @ (before[0] - place) + pos, turn @ rot[0]
    still = arm.spheres.joint[:, None] < 0
    there = (arm.spheres.pos - place) @ turn.T + pos
    spheres = arm.spheres._replace(pos=np.where(still, there, arm.spheres.pos))
    # Without fixtures: those of another place would be in the way.
    chain = replace(arm.chain, before_pos=before, before_rot=rot)
    return replace(arm, chain=chain, spheres=spheres, fixtures=())


class _OfRun:
    """Some grasps of a run, for places to be tried with."""

    def __init__(self, path: str, half: str, objects: int, every: int) -> None:
        run = Run.open(path)
        self.hands = run.hands()
        self._rows = [
            (run.library.load(object_id).sdf, batch.select(np.arange(0, len(batch), every)))
            for object_id, batch in chosen_rows(run, half, objects)
        ]

    def statuses(self, robot: Robot) -> Counter[str]:
        """How many have which status at a place."""
        found: Counter[str] = Counter()
        for field, batch in self._rows:
            solved, _ = arm_columns(batch, field, None, robot, ArmConfig())
            found.update(Status(s).label for s in solved["arm_status"].tolist())
        return found


def main() -> None:
    """Print the grid, best first."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("rig")
    parser.add_argument("--hand", default="shadow")
    for axis in "xyz":
        parser.add_argument(f"--{axis}", required=True)
    parser.add_argument(
        "--yaw", default="0", help="degrees; the left base's, the right one's minus"
    )
    parser.add_argument("--starts", type=int, default=32)
    parser.add_argument("--run", help="a run on a table with verdicts of test l")
    parser.add_argument("--half", choices=("early", "late", "all"), default="early")
    parser.add_argument("--objects", type=int, default=20, help="of the run")
    parser.add_argument("--every", type=int, default=3, help="take every so manieth grasp of them")
    given = parser.parse_args()
    grid = [[float(v) for v in getattr(given, axis).split(",")] for axis in ("x", "y", "z", "yaw")]
    places = list(itertools.product(*grid))
    lines = (_of_run if given.run else _of_pairs)(given, places)
    for place, (_share, line) in sorted(zip(places, lines, strict=True), key=lambda f: -f[1][0]):
        print("(" + ", ".join(f"{v:g}" for v in place) + f")  {line}")


def _of_pairs(given: argparse.Namespace, places: list[Place]) -> list[tuple[float, str]]:
    robot = mount_robot(load_rig(given.rig), load_hands(given.hand))
    pairs, config, lines = report_pairs(), IkConfig(starts=given.starts), []
    for x, y, z, yaw in places:
        report = reach_report(moved(robot, x, y, z, np.radians(yaw)), pairs, config)
        shares = "  ".join(f"{name} {report.share(name):.3f}" for name in REASONS)
        sizes = " ".join(f"{share:.2f}" for share in report.by_size().values())
        lines.append((report.share(), f"{shares}  by size {sizes}"))
    return lines


def _of_run(given: argparse.Namespace, places: list[Place]) -> list[tuple[float, str]]:
    grasps = _OfRun(given.run, given.half, given.objects, given.every)
    robot, lines = mount_robot(load_rig(given.rig), grasps.hands), []
    for x, y, z, yaw in places:
        found = grasps.statuses(moved(robot, x, y, z, np.radians(yaw)))
        n = sum(found.values())
        shares = "  ".join(f"{name} {count / n:.3f}" for name, count in found.most_common())
        lines.append((found["ok"] / n, f"{shares}  of {n}"))
    return lines


if __name__ == "__main__":
    main()
