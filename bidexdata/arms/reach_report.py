"""Which generic pairs of palm poses a robot can take, and what stands against the others.

A pair counts as reached when both palms are, when both can be lifted along a line, as high as motions
are, without a jump, and when no link touches the table, the object, the arm itself or the other arm on
the way, by spheres. Postures from many starts are tried; a pair that fails has the reason that stopped the
last of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.arms.clearance import clearance_between, clearances
from bidexdata.arms.config import ClearanceConfig, PathConfig
from bidexdata.arms.generic_pairs import GenericPairs, draw_pairs, join_pairs, shape_grid
from bidexdata.arms.inverse_kinematics import IkConfig, follow, solve_ik
from bidexdata.arms.ranking import posture_cost
from bidexdata.arms.robot import Robot
from bidexdata.arms.surroundings import Placed
from bidexdata.frames import invert

REASONS = ("ok", "reach", "lift", "self", "table", "object", "arms")
"""What a pair can come to, in the order of the checks."""
SIZES = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Bounding-box diagonals of the report [m]."""
PAIRS = 50
"""Pairs per size."""
LIFT, WAYPOINTS = PathConfig().lift, PathConfig().knots[-1]
"""Height [m] and waypoints of the lift: those of motions."""
_KEPT = 4
"""Postures of each arm that are tried with those of the other."""
_ENOUGH = ClearanceConfig().enough


class ReachReport(NamedTuple):
    """What each pair came to."""

    pairs: GenericPairs
    reason: Int[np.ndarray, " N"]
    """Number in `REASONS`."""
    q: Float[np.ndarray, "N 2 A"]
    """Postures at the grasp of reached pairs, NaN of the others and behind shorter chains [rad]."""

    def share(self, reason: str = "ok") -> float:
        """Share of all pairs that came to one end [-]."""
        return float(np.mean(self.reason == REASONS.index(reason)))

    def by_size(self) -> dict[float, float]:
        """Share of reached pairs per size [-]."""
        sizes = np.unique(self.pairs.size)
        return {float(s): float(np.mean(self.reason[self.pairs.size == s] == 0)) for s in sizes}


class _Side(NamedTuple):
    """Postures of one arm: at the grasp and along the lift."""

    q: np.ndarray
    """(N, S, 1 + T, A) [rad]."""
    gate: np.ndarray
    """Number in `REASONS` of what stopped each posture; 0 where nothing did, (N, S)."""
    rank: np.ndarray
    """Smaller is better, (N, S)."""


def reach_report(
    robot: Robot,
    pairs: GenericPairs | None = None,
    config: IkConfig | None = None,
    *,
    device: str = "cpu",
) -> ReachReport:
    """Try a robot on generic pairs.

    Args:
        robot: The robot.
        pairs: The pairs; the same 300 for every robot when omitted.
        config: Of the inverse kinematics.
        device: A Warp device.
    """
    config = config or IkConfig()
    pairs = report_pairs() if pairs is None else pairs
    sides = [_try_side(robot, h, pairs, config, device) for h in range(2)]
    count = len(pairs.size)
    reason = np.zeros(count, np.int32)
    q = np.full((count, 2, robot.joints), np.nan)
    for h in (1, 0):
        stopped = np.where(sides[h].gate == 0, len(REASONS), sides[h].gate).max(axis=1)
        reason = np.where(stopped < len(REASONS), stopped, reason).astype(np.int32)
    both = np.flatnonzero(reason == 0)
    chosen = _choose(robot, sides, both, device)
    for n, picks in zip(both, chosen, strict=True):
        if picks is None:
            reason[n] = REASONS.index("arms")
            continue
        for h, pick in enumerate(picks):
            q[n, h, : robot.arms[h].chain.joints] = sides[h].q[n, pick, 0]
    return ReachReport(pairs, reason, q)


def report_pairs(count: int = PAIRS) -> GenericPairs:
    """The pairs of a report: the same every time."""
    rng = np.random.default_rng(13)
    return join_pairs([draw_pairs(size, count, rng) for size in SIZES])


def _try_side(robot: Robot, h: int, pairs: GenericPairs, config: IkConfig, device: str) -> _Side:
    arm, hand = robot.arms[h], robot.hands[h]
    T_palm_hand = invert(hand.T_hand_palm)
    rot = pairs.palm_rot[:, h] @ T_palm_hand[:3, :3]
    pos = pairs.palm_pos[:, h] + pairs.palm_rot[:, h] @ T_palm_hand[:3, 3]
    found = solve_ik(arm.chain, pos, rot, config, device=device)
    rise = np.linspace(0, LIFT, WAYPOINTS + 1)[1:, None] * [0.0, 0.0, 1.0]
    line = pos[:, None] + rise
    turns = np.repeat(rot[:, None], WAYPOINTS, axis=1)
    path = follow(arm.chain, found.q, line, turns, config, device=device)
    smooth = (path.reached == WAYPOINTS) & (np.nan_to_num(path.step, nan=9).max(-1) < config.jump)
    q = np.concatenate([found.q[:, :, None], path.q], axis=2)
    # What a posture that is not reached would touch does not matter.
    known = np.where(np.isfinite(q), q, arm.chain.rest)
    table, obj, itself = _least(robot, h, known, pairs, device)
    gate = np.zeros(found.ok.shape, np.int32)
    for name, good in (("object", obj >= 0), ("table", table >= 0), ("self", itself >= 0),
                       ("lift", smooth), ("reach", found.ok)):  # fmt: skip
        gate[~good] = REASONS.index(name)
    room = np.minimum(np.minimum(table, obj), np.minimum(itself, _ENOUGH))
    rank = posture_cost(found.q, arm.chain.rest, room)
    return _Side(q, gate, np.where(gate == 0, rank, np.inf))


def _least(
    robot: Robot, h: int, q: np.ndarray, pairs: GenericPairs, device: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least clearances over grasp and lift, the object rising with the hands, (N, S) each."""
    count, starts, moments = q.shape[:3]
    rise = np.linspace(0, LIFT, moments)
    out = [np.zeros((count, starts)) for _ in range(3)]
    for number in np.unique(pairs.shape):
        rows = np.flatnonzero(pairs.shape == number)
        pos = pairs.object_pos[rows][:, None] + rise[:, None] * [0.0, 0.0, 1.0]
        placed = Placed(
            shape_grid(int(number)),
            np.repeat(pairs.size[rows], moments),
            pos.reshape(-1, 3),
            np.repeat(pairs.object_rot[rows], moments, axis=0),
        )
        turned = q[rows].swapaxes(1, 2).reshape(len(rows) * moments, starts, -1)
        found = clearances(robot.arms[h], turned, placed, device=device)
        for least, values in zip(out, found, strict=True):
            least[rows] = values.reshape(len(rows), moments, starts).min(axis=1)
    return out[0], out[1], out[2]


def _choose(
    robot: Robot, sides: list[_Side], rows: np.ndarray, device: str
) -> list[tuple[int, int] | None]:
    """The best two postures of each row that leave each other alone, at the grasp and lifted."""
    best = [np.argsort(side.rank[rows], axis=1, kind="stable")[:, :_KEPT] for side in sides]
    combos = [(a, b) for a in range(_KEPT) for b in range(_KEPT)]
    combos.sort(key=lambda ab: (sum(ab), ab))
    configurations, valid = [], []
    for h, side in enumerate(sides):
        picked = side.q[rows[:, None], best[h]][:, :, [0, -1]]
        good = np.isfinite(side.rank[rows[:, None], best[h]])
        rest = robot.arms[h].chain.rest
        configurations.append(np.where(good[:, :, None, None], picked, rest).reshape(-1, len(rest)))
        valid.append(good)
    number = np.arange(len(rows))
    pairs = np.array(
        [
            [2 * (n * _KEPT + a) + t, 2 * (n * _KEPT + b) + t]
            for n in number
            for a, b in combos
            for t in range(2)
        ],
        np.int32,
    ).reshape(-1, 2)
    left, right = configurations
    gaps = clearance_between(robot.arms, left, right, pairs, device=device)
    apart = gaps.reshape(len(rows), len(combos), 2).min(axis=2) > 0
    found: list[tuple[int, int] | None] = []
    for n in number:
        fits = [
            k for k, (a, b) in enumerate(combos)
            if apart[n, k] and valid[0][n, a] and valid[1][n, b]
        ]  # fmt: skip
        pick = combos[fits[0]] if fits else None
        found.append(None if pick is None else (int(best[0][n, pick[0]]), int(best[1][n, pick[1]])))
    return found
