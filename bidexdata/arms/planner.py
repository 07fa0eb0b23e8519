"""A small planner in joint space: the shortest way over some postures that a checker accepts.

Postures are spread round the straight line from start to goal without a random generator. Ways are
checked only when they are the shortest that is left, all of their steps in one call.

Source: lazy probabilistic road maps (Bohlin and Kavraki, "Path planning using lazy PRM", 2000).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from bidexdata.arms.config import SearchConfig
from bidexdata.arms.inverse_kinematics import even_spread

Checker = Callable[[np.ndarray], np.ndarray]
"""Tells of postures (M, A) [rad] which are free, (M,) bool."""


Plan = Generator[np.ndarray, Any, "np.ndarray | None"]
"""A plan in the making: it asks about postures (M, A), is sent which are free, (M,) bool, and returns
the corners of its way, (P, A); None where none was found."""


def plan_way(
    start: Float[np.ndarray, " A"],
    goal: Float[np.ndarray, " A"],
    lower: Float[np.ndarray, " A"],
    upper: Float[np.ndarray, " A"],
    free: Checker,
    config: SearchConfig,
) -> Float[np.ndarray, "P A"] | None:
    """Find a way of straight lines in joint space.

    Args:
        start: Where it begins [rad].
        goal: Where it ends [rad].
        lower: Joint limits [rad].
        upper: [rad].
        free: Says which postures may be passed.
        config: How many postures, how far beside the line, how many ways.

    Returns:
        The corners, ends included; None where no way was found.
    """
    plan = planning(start, goal, lower, upper, config, straight=True)
    return together([plan], lambda postures, _of: free(postures))[0]


def together(
    plans: Sequence[Plan], free: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> list[np.ndarray | None]:
    """Work on plans at the same time: what they ask about goes to one call of the checker.

    Args:
        plans: The plans; used up.
        free: Given postures (M, A) and the number of the plan that each is of, says which are free.

    Returns:
        What each plan found.
    """
    found: list[np.ndarray | None] = [None] * len(plans)
    asked = {}
    answers: dict[int, np.ndarray | None] = dict.fromkeys(range(len(plans)))
    while answers:
        for number, answer in answers.items():
            try:
                asked[number] = plans[number].send(answer)
            except StopIteration as end:
                found[number] = end.value
        of = np.repeat(list(asked), [len(postures) for postures in asked.values()])
        good = free(np.concatenate(list(asked.values())), of) if asked else of
        answers = {number: good[of == number] for number in asked}
        asked = {}
    return found


def planning(
    start: Float[np.ndarray, " A"],
    goal: Float[np.ndarray, " A"],
    lower: Float[np.ndarray, " A"],
    upper: Float[np.ndarray, " A"],
    config: SearchConfig,
    *,
    straight: bool = False,
) -> Plan:
    """The plan of one way; arguments as of `plan_way`.

    Args:
        start: [rad].
        goal: [rad].
        lower: [rad].
        upper: [rad].
        config: How.
        straight: Try the straight line, which comes first, however far apart its ends are; whoever
            plans because it is blocked has no use for it.
    """
    nodes = _nodes(start, goal, lower, upper, config)
    kept = yield nodes
    if not kept[:2].all():
        return None
    nodes = nodes[kept]
    length = _apart(nodes)
    open_ = _neighbours(length, config.neighbours)
    open_[0, 1] |= straight
    open_[1, 0] |= straight
    known = np.eye(len(nodes), dtype=bool)
    for _ in range(config.replans):
        way = _shortest(np.where(open_, length, np.inf))
        if way is None:
            return None
        asked = [(a, b) for a, b in pairwise(way) if not known[a, b]]
        points, owner = _along(nodes, asked, config)
        good = np.ones(len(asked), bool)
        if len(points):
            np.logical_and.at(good, owner, (yield points))
        for (a, b), passes in zip(asked, good, strict=True):
            known[a, b] = known[b, a] = passes
            open_[a, b] = open_[b, a] = passes
        if good.all():
            return nodes[way]
    return None


def resampled(corners: Float[np.ndarray, "P A"], count: int) -> Float[np.ndarray, "W A"]:
    """Postures along a way, `count` equal steps of the joint that turns most, both ends included."""
    step = np.abs(np.diff(corners, axis=0)).max(axis=1)
    at = np.concatenate([[0.0], np.cumsum(step)])
    wanted = np.linspace(0.0, at[-1], count + 1)
    made = np.stack([np.interp(wanted, at, column) for column in corners.T], axis=1)
    made[0], made[-1] = corners[0], corners[-1]
    return made


def way_length(corners: Float[np.ndarray, "P A"]) -> float:
    """Sum over the steps of the largest turn of a joint [rad]."""
    return float(np.abs(np.diff(corners, axis=0)).max(axis=1, initial=0.0).sum())


def _nodes(
    start: np.ndarray,
    goal: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    config: SearchConfig,
) -> np.ndarray:
    """Start, goal, and postures round the line between them, (2 + nodes, A)."""
    count, joints = config.nodes, len(start)
    share = even_spread(count, joints + 1)
    along = start + share[:, :1] * (goal - start)
    beside = config.spread * (2.0 * share[:, 1:] - 1.0)
    return np.concatenate([[start, goal], np.clip(along + beside, lower, upper)])


def _neighbours(length: np.ndarray, count: int) -> Bool[np.ndarray, "P P"]:
    near = np.zeros(length.shape, bool)
    order = np.argsort(length, axis=1, kind="stable")[:, 1 : count + 1]
    np.put_along_axis(near, order, True, axis=1)
    return near | near.T


def _along(
    nodes: np.ndarray, edges: list[tuple[int, int]], config: SearchConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Postures along edges without their ends, (M, A), and the number of the edge of each."""
    points, owner = [np.zeros((0, nodes.shape[1]))], []
    for number, (a, b) in enumerate(edges):
        steps = int(np.ceil(np.abs(nodes[b] - nodes[a]).max() / config.step))
        share = np.arange(1, max(steps, 1))[:, None] / max(steps, 1)
        points.append(nodes[a] + share * (nodes[b] - nodes[a]))
        owner += [number] * len(share)
    return np.concatenate(points), np.array(owner, np.intp)


def _apart(nodes: np.ndarray) -> np.ndarray:
    """Largest turn of a joint between each two postures, (P, P) [rad]."""
    length = np.zeros((len(nodes), len(nodes)))
    for angle in nodes.T:  # joint by joint, which is sooner than all at once
        np.maximum(length, np.abs(angle[:, None] - angle), out=length)
    return length


def _shortest(length: np.ndarray) -> list[int] | None:
    """The shortest way from node 0 to node 1 (Bellman and Ford); ties go to the lower number."""
    total = np.full(len(length), np.inf)
    total[0] = 0.0
    while True:
        shorter = np.minimum(total, (total[:, None] + length).min(axis=0))
        if (shorter == total).all():
            break
        total = shorter
    if not np.isfinite(total[1]):
        return None
    way = [1]
    while way[-1] != 0:
        way.append(int((total + length[:, way[-1]]).argmin()))
    return way[::-1]
