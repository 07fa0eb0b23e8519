"""Pairing: candidates of both arms are tried together until each grasp has a motion.

Pairs of candidates that nothing stopped are tried, best first: apart from each other, with ways from
home, steps that are not too large, and clear by MuJoCo. A grasp has the status of the try that came
farthest. World frame.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from bidexdata.arms.arm_scene import ArmScene
from bidexdata.arms.candidates import FREE, Candidates
from bidexdata.arms.clearance import apart_at, clear_at, clear_together
from bidexdata.arms.config import ArmConfig, just_above
from bidexdata.arms.final_word import final_word
from bidexdata.arms.robot import Robot
from bidexdata.arms.smoothing import Smoother
from bidexdata.arms.solutions import ArmSolutions, Grasps
from bidexdata.arms.surroundings import Surroundings
from bidexdata.arms.timing import knot_times
from bidexdata.arms.ways_home import OTHERS, OVER, PLANNED, STRAIGHT, WaysHome, waiting
from bidexdata.record.status import Status

APART, STEADY, SPOKEN = FREE + 1, FREE + 2, FREE + 3
"""Gates at which a pair of candidates that have ways from home ends: the arms meet, a step is too large,
MuJoCo has spoken."""


class Pairing:
    """Pairs of candidates of both arms, tried until each grasp has a motion or no more."""

    def __init__(
        self,
        robot: Robot,
        scene_at: Callable[[float], ArmScene] | None,
        grasps: Grasps,
        sides: tuple[Candidates, Candidates],
        around: Surroundings,
        config: ArmConfig,
    ) -> None:
        self._robot, self._scene_at, self._grasps = robot, scene_at, grasps
        self._sides, self._around, self._config = sides, around, config
        both = np.asarray(sides[0].free.any(axis=1) & sides[1].free.any(axis=1))
        self._home = tuple(
            WaysHome(robot, h, side.q[:, :, 0], side.free & both[:, None], around, config)
            for h, side in enumerate(sides)
        )
        self._open = sides[0].free[:, :, None] & sides[1].free[:, None]
        self._cost = sides[0].cost[:, :, None] + sides[1].cost[:, None]
        self._gate = np.full(len(both), FREE)
        self._tries = np.zeros(len(both), np.int64)
        self._todo = both

    def solve(self, made: ArmSolutions) -> None:
        """Try harder and harder; writes to `made`."""
        for effort in (STRAIGHT, OTHERS, OVER, PLANNED):
            rows = np.flatnonzero(self._todo)
            if not len(rows):
                return
            lacking = [~np.any(home.ok[rows], axis=1) for home in self._home]
            stuck = ~(lacking[0] | lacking[1])
            for home, lacks in zip(self._home, lacking, strict=True):
                home.find(effort, rows[lacks | stuck])
            while len(rows := self._next_rows()):
                self._try(made, rows)
        for h in (1, 0):
            without = self._todo & ~self._home[h].ok.any(axis=1)
            made.arm_status[without] = self._home[h].status[without]
            made.arm_failed_side[without] = h
        none = self._todo & ~(self._home[0].ok.any(axis=1) | self._home[1].ok.any(axis=1))
        made.arm_failed_side[none] = -1
        rows = np.flatnonzero(self._todo & (self._gate == FREE))
        keep_key_frames(made, self._sides, rows, np.zeros((len(rows), 2), np.int64), self._config)

    def _next_rows(self) -> np.ndarray:
        """Grasps that still have a pair with two ways from home."""
        ready = self._open & self._home[0].ok[:, :, None] & self._home[1].ok[:, None]
        return np.flatnonzero(
            self._todo & np.any(ready, axis=(1, 2)) & (self._tries < self._config.search.pairs)
        )

    def _best(self, rows: np.ndarray) -> np.ndarray:
        """The best open pair of each of some grasps, (R, 2); it is open no more."""
        ready = self._open[rows] & self._home[0].ok[rows][:, :, None]
        ready &= self._home[1].ok[rows][:, None]
        cost = np.where(ready, self._cost[rows], np.inf).reshape(len(rows), -1)
        picks = np.stack(np.divmod(cost.argmin(axis=1), self._open.shape[2]), axis=1)
        self._open[rows, picks[:, 0], picks[:, 1]] = False
        self._tries[rows] += 1
        return picks

    def _try(self, made: ArmSolutions, rows: np.ndarray) -> None:
        """Try the next pair of each of some grasps."""
        picks, config = self._best(rows), self._config
        way = [home.path[rows, picks[:, h]] for h, home in enumerate(self._home)]
        on = [side.q[rows, picks[:, h], 1:] for h, side in enumerate(self._sides)]
        apart = self._apart(rows, way)
        self._wait(rows, picks, way, apart)
        # Behind the approach hands are where the grasp has them.
        on_gap = np.full(on[0].shape[:2], -np.inf)
        on_gap[apart] = self._gaps_apart(
            rows[apart], [path[apart] for path in on], self._most, with_hands=False
        )
        apart &= on_gap.min(axis=1) >= config.clearance.margin
        self._stop(made, rows, picks, ~apart, APART, Status.COLLISION_ARMS)
        rows, picks = rows[apart], picks[apart]
        if not len(rows):
            return
        paths = [np.concatenate([way[h][apart], on[h][apart]], axis=1) for h in range(2)]
        gap = self._smooth(rows, paths, on_gap[apart])
        turns = np.max([_largest_step(path) for path in paths], axis=0)
        steady = turns <= config.path.largest_step
        self._stop(made, rows, picks, ~steady, STEADY, Status.JUMP)
        scene, size = None, np.nan
        for k in np.flatnonzero(steady):
            n, both = int(rows[k]), _padded(self._robot, [path[k] for path in paths])
            status, least = Status.OK, np.full(4, np.nan)
            if self._scene_at is not None:
                if scene is None or self._grasps.size[n] != size:
                    size = self._grasps.size[n]
                    scene = self._scene_at(float(size))
                asked = gap[k] < config.clearance.asked
                asked[_key_knots(config)] = True
                status, least = final_word(scene, self._grasps, n, both, asked, config)
                if status != Status.OK:
                    self._tries[n] += config.search.pairs // config.search.words
            one = np.arange(len(rows)) == k
            self._stop(made, rows, picks, one, SPOKEN, status)
            if status == Status.OK:
                _keep_path(made, self._robot, n, [path[k] for path in paths], least, config)
                self._todo[n] = False

    def _stop(
        self,
        made: ArmSolutions,
        rows: np.ndarray,
        picks: np.ndarray,
        some: np.ndarray,
        gate: int,
        status: Status,
    ) -> None:
        """Let some tries end; those that came farther than any before are kept in `made`."""
        farther = some & ((gate > self._gate[rows]) | (status == Status.OK))
        self._gate[rows[farther]] = gate
        made.arm_status[rows[farther]] = status
        keep_key_frames(made, self._sides, rows[farther], picks[farther], self._config)

    @property
    def _most(self) -> float:
        """Clearance beyond which no more need be known of a motion [m]."""
        return just_above(max(self._config.clearance.asked, self._config.clearance.margin))

    def _apart(self, rows: np.ndarray, paths: list[np.ndarray]) -> np.ndarray:
        """Whether the arms with their hands stay apart on ways that they go together, (R,) bool."""
        margin = self._config.clearance.margin
        gaps = self._gaps_apart(rows, paths, just_above(margin), with_hands=True)
        return np.asarray(gaps.min(axis=1) >= margin)

    def _gaps_apart(
        self, rows: np.ndarray, paths: list[np.ndarray], most: float, *, with_hands: bool
    ) -> Float[np.ndarray, "R K"]:
        """Clearance between the arms at every knot [m]."""
        left, right, of = _flat(rows, paths)
        gaps = apart_at(
            *(self._robot.arms, left, right, (of, of), self._around),
            with_hands=with_hands,
            most=most,
        )
        return gaps.reshape(paths[0].shape[:2])

    def _wait(
        self, rows: np.ndarray, picks: np.ndarray, way: list[np.ndarray], apart: np.ndarray
    ) -> None:
        """Let one arm wait for the other where they meet on the way; writes to `way` and `apart`."""
        for first in range(2):
            some, split = [], []
            for k in np.flatnonzero(~apart).tolist():
                left, right = (
                    home.corners[int(rows[k]), int(c)]
                    for home, c in zip(self._home, picks[k], strict=True)
                )
                parts = waiting((left, right), first, self._config)
                if parts is not None:
                    some.append(k)
                    split.append(parts)
            if not some:
                continue
            paths = [np.stack(side) for side in zip(*split, strict=True)]
            good = self._apart(rows[some], paths)
            better = np.array(some)[good]
            apart[better] = True
            for h, path in enumerate(paths):
                way[h][better] = path[good]

    def _smooth(
        self, rows: np.ndarray, paths: list[np.ndarray], on_gap: Float[np.ndarray, "R L"]
    ) -> Float[np.ndarray, "R K"]:
        """Smooth the ways from home where that leaves them clear; writes to `paths`.

        Args:
            rows: The grasp that each motion is of.
            paths: Both arms' motions.
            on_gap: Clearance between the arms behind the approach, without hands [m].

        Returns:
            Clearance by spheres at all knots [m]; behind the approach without hands.
        """
        count = self._config.path.knots[0] + 1
        pinned = np.ones(paths[0].shape[1], bool)
        pinned[1 : count - 1] = False
        smooth = []
        for arm, path in zip(self._robot.arms, paths, strict=True):
            smoother = _smoother(len(pinned), arm.chain.joints)
            most = 0.999 * self._config.path.largest_step
            smooth.append(
                smoother.smooth(path, pinned, arm.chain.lower, arm.chain.upper, most).path
            )
        gap = self._gaps(rows, [path[:, :count] for path in smooth])
        rough = gap.min(axis=1) < self._config.clearance.margin
        for path, better in zip(paths, smooth, strict=True):
            path[~rough] = better[~rough]
        if rough.any():
            gap[rough] = self._gaps(rows[rough], [path[rough, :count] for path in paths])
        *flat, of = _flat(rows, [path[:, count:] for path in paths])
        for arm, q in zip(self._robot.arms, flat, strict=True):
            alone = clear_at(arm, q, of, self._around, with_hand=False, most=self._most)
            on_gap = np.minimum(on_gap, alone.min(axis=0).reshape(on_gap.shape))
        return np.concatenate([gap, on_gap], axis=1)

    def _gaps(self, rows: np.ndarray, paths: list[np.ndarray]) -> Float[np.ndarray, "R K"]:
        """Clearance of both arms with their hands at every knot, by spheres, as far as it matters [m]."""
        left, right, of = _flat(rows, paths)
        gap = clear_together(self._robot.arms, left, right, of, self._around, most=self._most)
        return gap.reshape(paths[0].shape[:2])


def _flat(
    rows: Int[np.ndarray, " R"], paths: list[np.ndarray]
) -> tuple[Float[np.ndarray, "M A"], Float[np.ndarray, "M B"], Int[np.ndarray, " M"]]:
    """Knots of both arms one after the other, and the grasp that each is of."""
    left, right = (path.reshape(-1, path.shape[2]) for path in paths)
    return left, right, np.repeat(rows, paths[0].shape[1])


def keep_key_frames(
    made: ArmSolutions,
    sides: tuple[Candidates, Candidates],
    rows: Int[np.ndarray, " R"],
    picks: Int[np.ndarray, "R 2"],
    config: ArmConfig,
) -> None:
    """Store the postures of candidates at the key frames; writes to `made`."""
    frames = np.cumsum([0, *config.path.knots[1:]])
    for h, side in enumerate(sides):
        q = side.q[rows, picks[:, h]][:, frames]
        made.arm_joints[rows[:, None], h, np.arange(1, 6), : q.shape[2]] = q
        made.manipulability[rows, h] = side.manipulability[rows, picks[:, h]]


def _key_knots(config: ArmConfig) -> np.ndarray:
    """Knots about which MuJoCo is always asked: key frames, and the last before the pre-grasp."""
    ends = np.cumsum(config.path.knots)
    return np.append(ends, ends[1] - 1)


@lru_cache(maxsize=8)
def _smoother(knots: int, joints: int) -> Smoother:
    return Smoother(knots, joints)


def _largest_step(path: Float[np.ndarray, "R W A"]) -> Float[np.ndarray, " R"]:
    """Largest turn of a joint from knot to knot, as the record stores them [rad]."""
    stored = path.astype(np.float32).astype(np.float64)
    return np.abs(np.diff(stored, axis=1)).max(axis=(1, 2))


def _padded(robot: Robot, paths: list[np.ndarray]) -> Float[np.ndarray, "2 W A"]:
    both = np.full((2, len(paths[0]), robot.joints), np.nan)
    for h, path in enumerate(paths):
        both[h, :, : path.shape[1]] = path.astype(np.float32)
    return both


def _keep_path(
    made: ArmSolutions,
    robot: Robot,
    row: int,
    paths: list[np.ndarray],
    least: np.ndarray,
    config: ArmConfig,
) -> None:
    """Store a motion, its times and clearances; writes to `made`."""
    both, rule = _padded(robot, paths), config.path
    made.arm_path[row] = both
    made.arm_joints[row, :, 0] = both[:, 0]
    made.arm_step[row] = max(float(_largest_step(path[None])[0]) for path in paths)
    made.arm_time[row] = knot_times(
        *(paths, [arm.chain.velocity for arm in robot.arms]),
        *(rule.knots, rule.seconds, rule.speed),
    )
    for column, value in zip(
        (made.clear_table, made.clear_object, made.clear_arms, made.clear_self), least, strict=True
    ):
        column[row] = value
