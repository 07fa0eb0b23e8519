"""Where motions of two arms are looked at: at their knots, and between those where a step is long.

Spheres are looked at everywhere here; MuJoCo's word is asked where they leave it open whether something
touches, there or half way to the next place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bidexdata.arms.clearance import PairClearances, clear_together
from bidexdata.arms.config import ArmConfig, just_above
from bidexdata.arms.robot import Robot
from bidexdata.arms.surroundings import Surroundings


class Looks(NamedTuple):
    """M places along the motions of some grasps, motion by motion, in the order of time."""

    of: Int[np.ndarray, " M"]
    """The motion that each is of."""
    at: Float[np.ndarray, " M"]
    """Its place among the knots, from 0 on."""
    apart: Float[np.ndarray, " M"]
    """Clearance between the arms by spheres [m]."""
    alone: Float[np.ndarray, " M"]
    """Of one arm from all else [m]."""
    way: Float[np.ndarray, "M 2"]
    """How far some sphere of each arm goes to the next place [m]; behind the last of a motion none."""

    def least(self, count: int, until: int) -> Float[np.ndarray, " R"]:
        """Least clearance of each of `count` motions up to a knot [m]."""
        least, some = np.full(count, np.inf), self.at <= until
        np.minimum.at(least, self.of[some], np.minimum(self.apart, self.alone)[some])
        return least

    def least_apart(self, count: int) -> Float[np.ndarray, " R"]:
        """Least clearance between the arms of each of `count` motions [m]."""
        least = np.full(count, np.inf)
        np.minimum.at(least, self.of, self.apart)
        return least

    def of_motions(self, numbers: Int[np.ndarray, " R"]) -> Looks:
        """Those of some motions, given in rising order and numbered anew."""
        place = np.searchsorted(numbers, self.of)
        some = np.isin(self.of, numbers)
        return self._replace(of=place).select(some)

    def select(self, some: Bool[np.ndarray, " M"]) -> Looks:
        """Some of the places."""
        return Looks(*(column[some] for column in self))

    def joined(self, other: Looks) -> Looks:
        """These places and others."""
        every = Looks(*(np.concatenate(columns) for columns in zip(self, other, strict=True)))
        order = np.lexsort((every.at, every.of))
        return Looks(*(column[order] for column in every))

    def open(self, most: float) -> Bool[np.ndarray, " M"]:
        """Where something may be nearer than `most` [m], there or half way to the place before or behind."""
        half = 0.5 * self.way
        half[1:] = np.maximum(half[1:], 0.5 * self.way[:-1])
        return np.asarray(
            (self.apart < most + half.sum(axis=1)) | (self.alone < most + half.max(axis=1))
        )


def look(
    robot: Robot,
    rows: Int[np.ndarray, " R"],
    paths: list[np.ndarray],
    around: Surroundings,
    config: ArmConfig,
    *,
    with_hands: bool = True,
) -> Looks:
    """Look at motions by spheres, at their knots and between them.

    Args:
        robot: The robot.
        rows: The grasp that each motion is of.
        paths: Both arms' knots, (R, K, A) [rad].
        around: What is there.
        config: How close.
        with_hands: The hands count.
    """
    count, knots = paths[0].shape[:2]
    flat = [path.reshape(-1, path.shape[2]) for path in paths]
    seen = _seen(robot, flat, np.repeat(rows, knots), around, config, with_hands=with_hands)
    # From the last knot of a motion to the first of the next there is no way.
    way = np.zeros((count * knots, 2))
    way[:-1] = seen.way.T
    way = way.reshape(count, knots, 2)
    way[:, -1] = 0.0
    pieces = np.maximum(np.ceil(way.max(axis=2) / config.clearance.spacing), 1.0).astype(np.int64)
    way /= pieces[:, :, None]
    of, at = np.repeat(np.arange(count), knots), np.tile(np.arange(float(knots)), count)
    every = Looks(of, at, seen.apart, seen.alone, way.reshape(-1, 2))
    if (pieces > 1).any():
        segment = np.repeat(np.arange(count * knots), pieces.ravel() - 1)
        first = np.searchsorted(segment, segment)
        share = (np.arange(len(segment)) - first + 1) / pieces.ravel()[segment]
        n, k = np.divmod(segment, knots)
        q = [(1 - share)[:, None] * p[n, k] + share[:, None] * p[n, k + 1] for p in paths]
        seen = _seen(robot, q, rows[n], around, config, with_hands=with_hands)
        every = every.joined(Looks(n, k + share, seen.apart, seen.alone, way[n, k]))
    return every


def _seen(
    robot: Robot,
    q: list[np.ndarray],
    rows: np.ndarray,
    around: Surroundings,
    config: ArmConfig,
    *,
    with_hands: bool,
) -> PairClearances:
    rule = config.clearance
    asked = just_above(max(rule.asked, rule.margin))
    most = (asked + rule.spacing, asked + 0.5 * rule.spacing)
    return clear_together(*(robot.arms, q[0], q[1], rows, around), with_hands=with_hands, most=most)
