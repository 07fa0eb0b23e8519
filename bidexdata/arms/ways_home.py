"""Ways of an arm from home to the stand-offs of its candidates, clear of all around by spheres.

The straight line in joint space as a rule; where it is blocked one over a pose farther back or higher
up, then what a small planner finds. Hands count, in the posture that they have before they close.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bidexdata.arms.chain import chain_forward
from bidexdata.arms.clearance import FAR, clear_at
from bidexdata.arms.config import ArmConfig, just_above
from bidexdata.arms.inverse_kinematics import follow
from bidexdata.arms.planner import planning, resampled, together, way_length
from bidexdata.arms.robot import Robot
from bidexdata.arms.surroundings import Surroundings
from bidexdata.record.status import Status

_KINDS = np.array([Status.COLLISION_TABLE, Status.COLLISION_OBJECT, Status.COLLISION_SELF])
_VIA_STEPS = 4
_FEW = 5
"""Every so manieth knot is looked at before the others [-]."""
STRAIGHT, OTHERS, OVER, PLANNED = range(4)
"""Efforts, one after the other: the best candidate straight, the others, over a pose beside, planned."""


class _Tried(NamedTuple):
    """Ways that were looked at: row, candidate, corners (P, A), knots (1 + W, A)."""

    row: int
    candidate: int
    corners: Float[np.ndarray, "P A"]
    path: Float[np.ndarray, "K A"]


class WaysHome:
    """The ways of one arm that are known for C candidates of each of N grasps."""

    def __init__(
        self,
        robot: Robot,
        side: int,
        goals: Float[np.ndarray, "N C A"],
        usable: Bool[np.ndarray, "N C"],
        around: Surroundings,
        config: ArmConfig,
    ) -> None:
        """Know none as yet.

        Args:
            robot: The robot.
            side: Which arm.
            goals: Postures at the stand-offs [rad].
            usable: Which of them are to be reached.
            around: Objects and open hands of the grasps.
            config: How.
        """
        self._robot, self._side, self._goals = robot, side, goals
        self._usable, self._around, self._config = usable, around, config
        self._arm = robot.arms[side]
        knots = config.path.knots[0] + 1
        self.ok: Bool[np.ndarray, "N C"] = np.zeros(usable.shape, bool)
        """Which candidates have a way."""
        self.path: Float[np.ndarray, "N C K A"] = np.full(
            (*usable.shape, knots, goals.shape[2]), np.nan
        )
        """Their knots, home first [rad]."""
        self.corners: dict[tuple[int, int], np.ndarray] = {}
        """Their corners, by row and candidate [rad]."""
        self.status: Int[np.ndarray, " N"] = np.full(len(goals), int(Status.OK))
        """What the first way that was tried for each grasp meets."""

    def find(self, effort: int, rows: Int[np.ndarray, " R"]) -> None:
        """Look for ways of some grasps with one of the efforts."""
        if not len(rows):
            return
        if effort == STRAIGHT:
            self._straight(rows[:, None], np.zeros((len(rows), 1), np.int64))
        elif effort == OTHERS:
            others = np.arange(1, self._usable.shape[1])
            self._straight(rows[:, None], np.broadcast_to(others, (len(rows), len(others))))
        elif effort == OVER:
            self._over(rows)
        elif self._config.search.nodes:
            self._plan(rows)

    def _straight(self, rows: np.ndarray, candidates: np.ndarray) -> None:
        n, c = (x.ravel() for x in np.broadcast_arrays(rows, candidates))
        usable = self._usable[n, c]
        n, c = n[usable], c[usable]
        rest, goals = self._arm.chain.rest, self._goals[n, c]
        share = np.linspace(0.0, 1.0, self._config.path.knots[0] + 1)[:, None]
        paths = (1.0 - share) * rest + share * goals[:, None]
        corners = np.stack([np.broadcast_to(rest, goals.shape), goals], axis=1)
        self._look(
            [_Tried(*one) for one in zip(n.tolist(), c.tolist(), corners, paths, strict=True)]
        )

    def _over(self, rows: np.ndarray) -> None:
        """Over postures farther back, higher up, and both, on lines from the goals."""
        chain, T = self._arm.chain, self._robot.hands[self._side].T_hand_palm
        most = self._config.search.detours
        n, c = np.nonzero(self._usable[rows, :most] & ~self.ok[rows, :most])
        if not len(n):
            return
        n, goal = rows[n], self._goals[rows[n], c]
        pos, rot = chain_forward(chain, goal)
        back, up = -(rot @ T[:3, 2]), np.array([0.0, 0.0, 1.0])
        share = np.arange(1, _VIA_STEPS + 1)[:, None] / _VIA_STEPS
        turns = np.repeat(rot[:, None], _VIA_STEPS, axis=1)
        tried = []
        for direction in (back, np.broadcast_to(up, back.shape), back + up):
            line = pos[:, None] + self._config.search.back_off * share * direction[:, None]
            way = follow(
                chain, goal[:, None], line, turns, self._config.ik, device=self._around.device
            )
            steps = np.nan_to_num(way.step[:, 0], nan=9.0).max(axis=1)
            for k in np.flatnonzero(steps <= self._config.path.largest_step):
                corners = np.stack([chain.rest, *way.q[k, 0, ::-1], goal[k]])
                tried.append(self._tried(int(n[k]), int(c[k]), corners))
        self._look(tried)

    def _plan(self, rows: np.ndarray) -> None:
        chain, search = self._arm.chain, self._config.search
        usable = [np.flatnonzero(self._usable[n] & ~self.ok[n])[: search.plans] for n in rows]
        at = [(int(n), int(c)) for n, some in zip(rows, usable, strict=True) for c in some]
        row = np.array([n for n, _ in at], np.intp)
        plans = [
            planning(chain.rest, self._goals[n, c], chain.lower, chain.upper, search) for n, c in at
        ]

        margin = self._config.clearance.margin

        def free(q: np.ndarray, of: np.ndarray) -> np.ndarray:
            return self._gap(q, row[of], enough=margin)[0] >= margin

        ways = zip(at, together(plans, free), strict=True)
        self._look([self._tried(n, c, way) for (n, c), way in ways if way is not None])

    def _tried(self, row: int, candidate: int, corners: np.ndarray) -> _Tried:
        return _Tried(row, candidate, corners, resampled(corners, self._config.path.knots[0]))

    def _look(self, tried: list[_Tried]) -> None:
        """Check ways, and keep the first good one of each candidate."""
        if not tried:
            return
        longest = longest_way(self._config)
        fits = np.array([way_length(one.corners) <= longest for one in tried])
        gap, kind = np.full(len(tried), -np.inf), np.full(len(tried), int(Status.JUMP))
        paths = np.stack([one.path for one in tried])
        rows = np.array([one.row for one in tried])
        few = np.zeros(paths.shape[1], bool)
        few[::_FEW], few[-1] = True, True
        # Most ways that are blocked are so at one knot of a few.
        for knots in (few, ~few):
            open_ = np.flatnonzero(fits & ((gap >= self._config.clearance.margin) | (knots is few)))
            worst, what = self._worst(paths[np.ix_(open_, knots)], rows[open_])
            gap[open_] = worst if knots is few else np.minimum(gap[open_], worst)
            kind[open_] = what
        for k, one in enumerate(tried):
            if self.status[one.row] == Status.OK and not self.ok[one.row].any():
                self.status[one.row] = kind[k]
            if self.ok[one.row, one.candidate]:
                continue
            if gap[k] >= self._config.clearance.margin:
                self.ok[one.row, one.candidate] = True
                self.path[one.row, one.candidate] = one.path
                self.corners[one.row, one.candidate] = one.corners

    def _worst(
        self, paths: Float[np.ndarray, "R K A"], rows: Int[np.ndarray, " R"]
    ) -> tuple[Float[np.ndarray, " R"], Int[np.ndarray, " R"]]:
        """Least clearance at knots of ways, and the status of what is there."""
        count, knots, joints = paths.shape
        gap, kind = self._gap(paths.reshape(-1, joints), np.repeat(rows, knots))
        at = np.arange(count), gap.reshape(count, knots).argmin(axis=1)
        return gap.reshape(count, knots)[at], kind.reshape(count, knots)[at]

    def _gap(
        self, q: np.ndarray, rows: np.ndarray, enough: float = -FAR
    ) -> tuple[np.ndarray, np.ndarray]:
        most = just_above(self._config.clearance.margin)
        found = clear_at(self._arm, q, rows, self._around, self._side, most=most, enough=enough)
        return found.min(axis=0), _KINDS[found.argmin(axis=0)]


def longest_way(config: ArmConfig, share: float = 1.0) -> float:
    """Longest way that a share of the knots of the approach can hold [rad]."""
    return 0.98 * share * config.path.knots[0] * config.path.largest_step


def waiting(
    ways: tuple[Float[np.ndarray, "P A"], Float[np.ndarray, "Q B"]], first: int, config: ArmConfig
) -> tuple[Float[np.ndarray, "K A"], Float[np.ndarray, "K B"]] | None:
    """Two ways one after the other, each in half the knots; None where they do not fit."""
    count = config.path.knots[0]
    half = count // 2
    if max(way_length(way) for way in ways) > longest_way(config, half / count):
        return None
    made = []
    for h, way in enumerate(ways):
        moving = resampled(way, half if h == first else count - half)
        still = np.repeat(
            moving[-1:] if h == first else moving[:1], count + 1 - len(moving), axis=0
        )
        made.append(np.concatenate([moving, still] if h == first else [still, moving]))
    return made[0], made[1]
