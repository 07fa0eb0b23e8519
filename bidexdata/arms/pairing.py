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
from bidexdata.arms.clearance import apart_at
from bidexdata.arms.config import ArmConfig, just_above
from bidexdata.arms.final_word import FinalWords, final_words
from bidexdata.arms.looks import Looks, look
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
_FEW = 4
"""Pairs of a grasp that are looked at together, after its first; what is found is what one after the
other would find [-]."""


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
        self.blocked: Int[np.ndarray, " N"] = np.full(len(both), -1)
        """Side of the open hand that MuJoCo found no room for between stand-off and pre-grasp."""

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

    def _next_pairs(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The best open pairs of some grasps: one at first, then a few, row by row and best first."""
        ready = self._open[rows] & self._home[0].ok[rows][:, :, None]
        ready &= self._home[1].ok[rows][:, None]
        cost = np.where(ready, self._cost[rows], np.inf).reshape(len(rows), -1)
        order = cost.argsort(axis=1, kind="stable")[:, :_FEW]
        few = np.minimum(self._config.search.pairs - self._tries[rows], _FEW)
        few[self._tries[rows] == 0] = 1
        taken = np.arange(order.shape[1]) < few[:, None]
        taken &= np.isfinite(np.take_along_axis(cost, order, axis=1))
        picks = np.stack(np.divmod(order[taken], self._open.shape[2]), axis=1)
        return np.repeat(rows, taken.sum(axis=1)), picks

    def _try(self, made: ArmSolutions, rows: np.ndarray) -> None:
        """Try the next pairs of each of some grasps, up to one whose arms stay apart."""
        config = self._config
        rows, picks = self._next_pairs(rows)
        way = [home.path[rows, picks[:, h]] for h, home in enumerate(self._home)]
        on = [side.q[rows, picks[:, h], 1:] for h, side in enumerate(self._sides)]
        # Behind the approach hands are where the grasp has them.
        behind = look(self._robot, rows, on, self._around, config, with_hands=False)
        apart = behind.least_apart(len(rows)) >= config.clearance.margin
        self._come(rows, picks, way, apart)
        first = np.searchsorted(rows, rows)
        found = np.cumsum(apart) - apart
        tried = found == found[first]
        self._open[rows[tried], picks[tried, 0], picks[tried, 1]] = False
        np.add.at(self._tries, rows[tried], 1)
        # All that meet end at the same gate: the first of a grasp stands for them.
        met = ~apart & (first == np.arange(len(rows)))
        self._stop(made, rows, picks, met, APART, Status.COLLISION_ARMS)
        kept = np.flatnonzero(apart & tried)
        rows, picks = rows[kept], picks[kept]
        if not len(rows):
            return
        paths = [np.concatenate([way[h][kept], on[h][kept]], axis=1) for h in range(2)]
        before = self._smooth(rows, paths)
        turns = np.max([_largest_step(path) for path in paths], axis=0)
        steady = turns <= config.path.largest_step
        self._stop(made, rows, picks, ~steady, STEADY, Status.JUMP)
        some = np.flatnonzero(steady)
        if len(some):
            looks = _joined(before.of_motions(some), behind.of_motions(kept[some]), config)
            self._speak(made, rows[some], picks[some], [path[some] for path in paths], looks)

    def _come(
        self, rows: np.ndarray, picks: np.ndarray, way: list[np.ndarray], apart: np.ndarray
    ) -> None:
        """Look at ways from home that both arms go, at once or one after the other.

        Writes to `way`, and to `apart` where arms meet.
        """
        some = np.flatnonzero(apart)
        if not len(some):
            return
        ways = [path[some] for path in way]
        clear = self._apart(rows[some], ways)
        self._wait(rows[some], picks[some], ways, clear)
        apart[some] = clear
        for path, better in zip(way, ways, strict=True):
            path[some] = better

    def _speak(
        self,
        made: ArmSolutions,
        rows: np.ndarray,
        picks: np.ndarray,
        paths: list[np.ndarray],
        looks: Looks,
    ) -> None:
        """Let MuJoCo have the last word on some tries; writes to `made`."""
        both, search = _padded(self._robot, paths), self._config.search
        words = FinalWords.none(len(rows))
        if self._scene_at is not None:
            some = self._grasps.select(rows)
            words = final_words(self._scene_at, some, both, looks, self._config)
        self._stop(made, rows, picks, words.status >= 0, SPOKEN, words.status, words.side)
        good = words.status == Status.OK
        _keep_paths(*(made, self._robot, rows[good], both[good], words.least[good], self._config))
        stuck = words.hand  # as with any other postures of the arms
        self.blocked[rows[stuck]] = words.side[stuck]
        self._todo[rows[good | stuck]] = False
        self._tries[rows] += search.pairs // search.words

    def _stop(
        self,
        made: ArmSolutions,
        rows: np.ndarray,
        picks: np.ndarray,
        some: np.ndarray,
        gate: int,
        status: Status | np.ndarray,
        side: int | np.ndarray = -1,
    ) -> None:
        """Let some tries end; those that came farther than any before are kept in `made`."""
        farther = some & ((gate > self._gate[rows]) | (status == Status.OK))
        self._gate[rows[farther]] = gate
        made.arm_status[rows[farther]] = np.broadcast_to(status, rows.shape)[farther]
        made.arm_failed_side[rows[farther]] = np.broadcast_to(side, rows.shape)[farther]
        keep_key_frames(made, self._sides, rows[farther], picks[farther], self._config)

    def _apart(self, rows: np.ndarray, paths: list[np.ndarray]) -> np.ndarray:
        """Whether the arms with their hands stay apart on ways that they go together, (R,) bool."""
        margin = self._config.clearance.margin
        left, right, of = _flat(rows, paths)
        gaps = apart_at(
            *(self._robot.arms, left, right, (of, of), self._around),
            most=just_above(margin),
            enough=margin,
        )
        return np.asarray(gaps.reshape(paths[0].shape[:2]).min(axis=1) >= margin)

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

    def _smooth(self, rows: np.ndarray, paths: list[np.ndarray]) -> Looks:
        """Smooth the ways from home where that leaves them clear; writes to `paths`.

        Args:
            rows: The grasp that each motion is of.
            paths: Both arms' motions.

        Returns:
            What spheres see up to the pre-grasp.
        """
        margin, (approach, reach, *_rest) = self._config.clearance.margin, self._config.path.knots
        pinned = np.ones(paths[0].shape[1], bool)
        pinned[1:approach] = False
        smooth = []
        for arm, path in zip(self._robot.arms, paths, strict=True):
            smoother = _smoother(len(pinned), arm.chain.joints)
            most = 0.999 * self._config.path.largest_step
            smooth.append(
                smoother.smooth(path, pinned, arm.chain.lower, arm.chain.upper, most).path
            )
        ahead = slice(approach + reach + 1)
        seen = self._look(rows, [path[:, ahead] for path in smooth])
        rough = seen.least(len(rows), approach) < margin
        for path, better in zip(paths, smooth, strict=True):
            path[~rough] = better[~rough]
        if not rough.any():
            return seen
        again = self._look(rows[rough], [path[rough, ahead] for path in paths])
        again = again._replace(of=np.flatnonzero(rough)[again.of])
        return seen.select(~rough[seen.of]).joined(again)

    def _look(self, rows: np.ndarray, paths: list[np.ndarray]) -> Looks:
        return look(self._robot, rows, paths, self._around, self._config)


def _joined(before: Looks, behind: Looks, config: ArmConfig) -> Looks:
    """What spheres see of motions: with hands up to the pre-grasp, behind it without."""
    approach, reach, *_rest = config.path.knots
    behind = behind._replace(at=behind.at + approach + 1)
    pregrasp, way = approach + reach, before.way.copy()
    way[before.at == pregrasp] = behind.way[behind.at == pregrasp]
    return before._replace(way=way).joined(behind.select(behind.at > pregrasp))


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


@lru_cache(maxsize=8)
def _smoother(knots: int, joints: int) -> Smoother:
    return Smoother(knots, joints)


def _largest_step(path: Float[np.ndarray, "R W A"]) -> Float[np.ndarray, " R"]:
    """Largest turn of a joint from knot to knot, as the record stores them [rad]."""
    stored = path.astype(np.float32).astype(np.float64)
    return np.abs(np.diff(stored, axis=1)).max(axis=(1, 2))


def _padded(robot: Robot, paths: list[np.ndarray]) -> Float[np.ndarray, "R 2 W A"]:
    both = np.full((len(paths[0]), 2, paths[0].shape[1], robot.joints), np.nan)
    for h, path in enumerate(paths):
        both[:, h, :, : path.shape[2]] = path.astype(np.float32)
    return both


def _keep_paths(
    made: ArmSolutions,
    robot: Robot,
    rows: Int[np.ndarray, " R"],
    both: Float[np.ndarray, "R 2 W A"],
    least: Float[np.ndarray, "R 4"],
    config: ArmConfig,
) -> None:
    """Store motions, their times and clearances; writes to `made`."""
    rule = config.path
    made.arm_path[rows] = both
    made.arm_joints[rows, :, 0] = both[:, :, 0]
    paths = [both[:, h, :, : arm.chain.joints] for h, arm in enumerate(robot.arms)]
    made.arm_step[rows] = np.max([_largest_step(path) for path in paths], axis=0)
    made.arm_time[rows] = knot_times(
        *(paths, [arm.chain.velocity for arm in robot.arms]),
        *(rule.knots, rule.seconds, rule.speed),
    )
    columns = (made.clear_table, made.clear_object, made.clear_arms, made.clear_self)
    for column, values in zip(columns, least.T, strict=True):
        column[rows] = values
