"""Reach: which starts and which grasps of one object the two arms of a robot can take.

Synthesis asks twice: about places of the palms before it optimises, quickly, and about the finished
grasps, with the search that the stage `arms` runs. Frames: world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int8

from bidexdata.arms.arm_scene import SizedArmScenes
from bidexdata.arms.candidates import postures_near_rest
from bidexdata.arms.clearance import FAR, apart_at, clear_at
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.inverse_kinematics import solve_ik
from bidexdata.arms.robot import Robot
from bidexdata.arms.solutions import Targets
from bidexdata.arms.solve import solve_scenes
from bidexdata.arms.surroundings import Placed, Surroundings
from bidexdata.frames import matrix_from_quat
from bidexdata.objects.prepared import SignedDistanceGrid
from bidexdata.record.scene import Scene

_TOGETHER = 6
"""Postures of each arm that are tried beside those of the other [-]."""
_ROOM_COUNTS = 30.0
"""What a metre of clearance is worth in turns away from rest, as for the grasps [rad/m]."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Reach:
    """What the arms of a robot can take of one object, at any size."""

    robot: Robot
    field: SignedDistanceGrid | None
    """Signed distances of the object; none where it does not count."""
    scenes: SizedArmScenes | None
    """The object at any size, for MuJoCo's word on motions; none for spheres alone."""
    config: ArmConfig
    device: str = "cpu"
    """Of Warp."""

    def placements(
        self,
        scene: Scene,
        hand_pos: Float[np.ndarray, "N 2 3"],
        hand_quat_wxyz: Float[np.ndarray, "N 2 4"],
    ) -> Bool[np.ndarray, " N"]:
        """Tell which pairs of palms the arms can bring there, each for itself.

        By inverse kinematics from the starts that grasps get too, and by spheres: arms clear of the
        table, the object, themselves and each other, hands not counted. No way there is looked for.

        Args:
            scene: Where the object stands.
            hand_pos: Origins of the hand frames [m].
            hand_quat_wxyz: Their orientations.
        """
        able = np.ones(len(hand_pos), bool)
        kept = []
        for h in range(2):
            rows = np.flatnonzero(able)
            q, cost = self._postures(h, scene, hand_pos[rows, h], hand_quat_wxyz[rows, h])
            able[rows] = np.isfinite(cost[:, 0])
            best, costs = (
                np.zeros((len(able), *q.shape[1:])),
                np.full((len(able), cost.shape[1]), np.inf),
            )
            best[rows], costs[rows] = q, cost
            kept.append((best, costs))
        rows = np.flatnonzero(able)
        able[rows] = self._apart(*((q[rows], cost[rows]) for q, cost in kept))
        return able

    def grasps(self, scenes: Sequence[Targets]) -> list[Int8[np.ndarray, " N"]]:
        """Say of the grasps of each scene whether there is a motion: the stage `arms`' statuses.

        Args:
            scenes: Grasps as the record stores them, see `stored_targets`.
        """
        found = solve_scenes(
            *(self.robot, self.field, self.scenes, scenes, self.config), device=self.device
        )
        return [motions.arm_status.astype(np.int8) for motions in found]

    def _postures(
        self, side: int, scene: Scene, pos: np.ndarray, quat: np.ndarray
    ) -> tuple[Float[np.ndarray, "N T A"], Float[np.ndarray, "N T"]]:
        """Postures of one arm that are clear of all but the other, best first, and their costs.

        The cost is infinite where there is none.
        """
        arm, search, count = self.robot.arms[side], self.config.search, len(pos)
        rot = matrix_from_quat(quat)
        near = postures_near_rest(arm, search.near_rest, search.rest_spread)
        short = solve_ik(arm.chain, pos, rot, self.config.ik, starts=near, device=self.device)
        wide = solve_ik(arm.chain, pos, rot, self.config.ik, device=self.device)
        q = np.concatenate([short.q, wide.q], axis=1)
        good = np.concatenate([short.ok, wide.ok], axis=1)
        room = np.full(good.shape, -FAR)
        around = self._around(scene, count)
        row = np.broadcast_to(np.arange(count)[:, None], good.shape)
        room[good] = clear_at(arm, q[good], row[good], around, with_hand=False).min(axis=0)
        clearance = self.config.clearance
        away = np.abs(q - arm.chain.rest).max(axis=-1)
        cost = away - _ROOM_COUNTS * np.minimum(room, clearance.enough)
        cost[room < clearance.margin] = np.inf
        best = np.argsort(cost, axis=1, kind="stable")[:, :_TOGETHER]
        return (
            np.take_along_axis(q, best[:, :, None], axis=1),
            np.take_along_axis(cost, best, axis=1),
        )

    def _around(self, scene: Scene, count: int) -> Surroundings:
        placed = None
        if self.field is not None:
            turn = matrix_from_quat(np.array(scene.object_quat_wxyz))
            placed = Placed(
                self.field,
                np.full(count, scene.size),
                np.tile(np.array(scene.object_pos), (count, 1)),
                np.tile(turn, (count, 1, 1)),
            )
        return Surroundings(placed, rows=count, device=self.device)

    def _apart(
        self, left: tuple[np.ndarray, np.ndarray], right: tuple[np.ndarray, np.ndarray]
    ) -> Bool[np.ndarray, " N"]:
        """Tell where some posture of one arm leaves some of the other alone."""
        count = len(left[0])
        able = np.zeros(count, bool)
        order = sorted(((a, b) for a in range(_TOGETHER) for b in range(_TOGETHER)), key=sum)
        around = Surroundings(None, rows=count, device=self.device)
        for a, b in order:
            both = np.isfinite(left[1][:, a]) & np.isfinite(right[1][:, b]) & ~able
            rows = np.flatnonzero(both)
            if not len(rows):
                continue
            gaps = apart_at(
                self.robot.arms,
                left[0][rows, a],
                right[0][rows, b],
                (rows, rows),
                around,
                with_hands=False,
            )
            able[rows] = gaps >= self.config.clearance.margin
        return able
