"""Ways of two arms from home to the stand-offs of a grasp, clear of all around by spheres.

The straight line in joint space as a rule; where it is blocked one over a pose farther back or higher
up, then what a small planner finds. Both arms move together; where they meet, one waits for the
other. Hands count, in the posture that they have before they close.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.arms.chain import chain_forward
from bidexdata.arms.clearance import HeldHands, Placed, clearance_between, clearances
from bidexdata.arms.config import ArmConfig
from bidexdata.arms.inverse_kinematics import follow
from bidexdata.arms.planner import plan_way, resampled, way_length
from bidexdata.arms.robot import Arm, Robot
from bidexdata.record.status import Status

_KINDS = np.array([Status.COLLISION_TABLE, Status.COLLISION_OBJECT, Status.COLLISION_SELF])
_VIA_STEPS = 4


class Around(NamedTuple):
    """What R pairs of arms have to mind: one object and two hands in a posture each."""

    placed: Placed | None
    hands: tuple[HeldHands, HeldHands]

    def row(self, n: int) -> Around:
        """What one of the pairs minds."""
        one = slice(n, n + 1)
        placed = self.placed
        if placed is not None:
            placed = Placed(placed.field, placed.size[one], placed.pos[one], placed.rot[one])
        left, right = (HeldHands(hand.pos[one], hand.radius) for hand in self.hands)
        return Around(placed, (left, right))


class Approaches(NamedTuple):
    """Ways of R pairs of arms; W knots after home."""

    paths: tuple[Float[np.ndarray, "R K A"], Float[np.ndarray, "R K B"]]
    """Left and right, K = 1 + W, home first [rad]."""
    status: Int[np.ndarray, " R"]
    """OK, or what the best way meets."""
    side: Int[np.ndarray, " R"]
    """The arm that meets something; -1 for both and for none."""


def approaches(
    robot: Robot,
    goals: tuple[Float[np.ndarray, "R A"], Float[np.ndarray, "R B"]],
    around: Around,
    config: ArmConfig,
    *,
    device: str = "cpu",
) -> Approaches:
    """Find ways for R pairs of arms.

    Args:
        robot: The robot.
        goals: Postures at the stand-offs, left and right [rad].
        around: What is in the way.
        config: How.
        device: A Warp device.
    """
    count = config.path.knots[0]
    corners = [[np.stack([arm.chain.rest, goal]) for goal in goals[h]]
               for h, arm in enumerate(robot.arms)]  # fmt: skip
    paths = [_sampled(ways, count, arm) for ways, arm in zip(corners, robot.arms, strict=True)]
    status = np.full(len(goals[0]), int(Status.OK))
    side = np.full(len(status), -1)
    for h in (1, 0):
        kind = _one_side(robot, h, corners[h], paths[h], around, config, device)
        blocked = kind != Status.OK
        side[blocked] = np.where(status[blocked] != Status.OK, -1, h)
        status[blocked] = kind[blocked]
    free = np.flatnonzero(status == Status.OK)
    together = _together(robot, corners, paths, free, around, config, device)
    status[free[~together]] = Status.COLLISION_ARMS
    return Approaches((paths[0], paths[1]), status, side)


def least_apart(
    robot: Robot,
    paths: tuple[Float[np.ndarray, "R K A"], Float[np.ndarray, "R K B"]],
    hands: tuple[HeldHands, HeldHands] | None,
    *,
    device: str = "cpu",
) -> Float[np.ndarray, "R K"]:
    """Clearance between the arms at the knots that they pass together [m]."""
    shape = paths[0].shape[:2]
    pairs = np.repeat(np.arange(shape[0] * shape[1], dtype=np.int32)[:, None], 2, axis=1)
    gaps = clearance_between(robot.arms, paths[0], paths[1], pairs, hands, device=device)
    return gaps.reshape(shape)


def least_alone(
    arm: Arm,
    path: Float[np.ndarray, "R K A"],
    placed: Placed | None,
    hands: HeldHands | None,
    *,
    device: str = "cpu",
) -> tuple[Float[np.ndarray, "R K"], Int[np.ndarray, "R K"]]:
    """Least clearance of one arm at each knot [m], and the status of what is nearest."""
    found = np.stack(clearances(arm, path, placed, hands, device=device))
    return found.min(axis=0), _KINDS[found.argmin(axis=0)]


def _sampled(ways: list[np.ndarray], count: int, arm: Arm) -> np.ndarray:
    made = [resampled(corners, count) for corners in ways]
    return np.stack(made) if made else np.zeros((0, count + 1, arm.chain.joints))


def _one_side(
    robot: Robot,
    h: int,
    corners: list[np.ndarray],
    paths: np.ndarray,
    around: Around,
    config: ArmConfig,
    device: str,
) -> np.ndarray:
    """Status of one arm's ways; `corners` and `paths` of blocked ones are replaced where possible."""
    arm, hand = robot.arms[h], around.hands[h]
    margin, longest = config.clearance.margin, _longest(config, 1.0)
    gap, kind = least_alone(arm, paths, around.placed, hand, device=device)
    worst = gap.argmin(axis=1)
    status = kind[np.arange(len(gap)), worst]
    status[gap.min(axis=1, initial=np.inf) >= margin] = Status.OK
    too_long = np.array([way_length(way) > longest for way in corners], bool)
    status[too_long] = Status.JUMP
    blocked = [int(n) for n in np.flatnonzero(status != Status.OK)]
    if not blocked:
        return status
    vias = _vias(robot, h, np.array([corners[n][-1] for n in blocked]), config, device)
    for via, reached in vias:
        for k, n in enumerate(blocked):
            if status[n] == Status.OK or not reached[k]:
                continue
            way = np.stack([arm.chain.rest, *via[k][::-1], corners[n][-1]])
            _take(way, n, arm, corners, paths, status, around.row(n), h, config, device)
    for n in blocked:
        if status[n] != Status.OK and config.search.nodes:
            way = plan_way(
                *(arm.chain.rest, corners[n][-1], arm.chain.lower, arm.chain.upper),
                _checker(arm, around.row(n), h, config, device),
                config.search,
            )
            if way is not None:
                _take(way, n, arm, corners, paths, status, around.row(n), h, config, device)
    return status


def _take(
    way: np.ndarray,
    n: int,
    arm: Arm,
    corners: list[np.ndarray],
    paths: np.ndarray,
    status: np.ndarray,
    around: Around,
    h: int,
    config: ArmConfig,
    device: str,
) -> None:
    """Give row n another way, if it is free and short enough."""
    if way_length(way) > _longest(config, 1.0):
        return
    path = resampled(way, config.path.knots[0])
    gap, _kind = least_alone(arm, path[None], around.placed, around.hands[h], device=device)
    if gap.min() >= config.clearance.margin:
        corners[n], paths[n], status[n] = way, path, Status.OK


def _longest(config: ArmConfig, share: float) -> float:
    """Longest way that a share of the knots can hold [rad]."""
    return 0.98 * share * config.path.knots[0] * config.path.largest_step


def _checker(
    arm: Arm, around: Around, h: int, config: ArmConfig, device: str
) -> Callable[[np.ndarray], np.ndarray]:
    def free(q: np.ndarray) -> np.ndarray:
        gap, _kind = least_alone(arm, q[None], around.placed, around.hands[h], device=device)
        return gap[0] >= config.clearance.margin

    return free


def _vias(
    robot: Robot, h: int, goal: np.ndarray, config: ArmConfig, device: str
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Postures farther back, higher up, and both, on lines from the goal; which were reached."""
    chain, T = robot.arms[h].chain, robot.hands[h].T_hand_palm
    pos, rot = chain_forward(chain, goal)
    back, up = -(rot @ T[:3, 2]), np.array([0.0, 0.0, 1.0])
    share = np.arange(1, _VIA_STEPS + 1)[:, None] / _VIA_STEPS
    found = []
    for direction in (back, np.broadcast_to(up, back.shape), back + up):
        line = pos[:, None] + config.search.back_off * share * direction[:, None]
        turns = np.repeat(rot[:, None], _VIA_STEPS, axis=1)
        way = follow(chain, goal[:, None], line, turns, config.ik, device=device)
        smooth = np.nan_to_num(way.step[:, 0], nan=9.0).max(axis=1) <= config.ik.jump
        found.append((way.q[:, 0], (way.reached[:, 0] == _VIA_STEPS) & smooth))
    return found


def _together(
    robot: Robot,
    corners: list[list[np.ndarray]],
    paths: list[np.ndarray],
    rows: np.ndarray,
    around: Around,
    config: ArmConfig,
    device: str,
) -> np.ndarray:
    """Which pairs of ways the arms can go; where they meet on the way, one of them waits."""
    if not len(rows):
        return np.zeros(0, bool)
    hands = tuple(HeldHands(hand.pos[rows], hand.radius) for hand in around.hands)
    pair = (paths[0][rows], paths[1][rows])
    margin = config.clearance.margin
    good = least_apart(robot, pair, (hands[0], hands[1]), device=device).min(axis=1) >= margin
    count = config.path.knots[0]
    for k in np.flatnonzero(~good):
        n = rows[k]
        one = around.row(int(n))
        for first in range(2):
            split = _waiting([corners[h][n] for h in range(2)], first, count, config)
            if split is None:
                continue
            gaps = least_apart(robot, (split[0][None], split[1][None]), one.hands, device=device)
            if gaps.min() >= margin:
                paths[0][n], paths[1][n] = split
                good[k] = True
                break
    return good


def _waiting(
    ways: list[np.ndarray], first: int, count: int, config: ArmConfig
) -> tuple[np.ndarray, np.ndarray] | None:
    """Both ways in half the knots, one after the other; None where they do not fit."""
    half = count // 2
    if max(way_length(way) for way in ways) > _longest(config, half / count):
        return None
    made = []
    for h, way in enumerate(ways):
        moving = resampled(way, half if h == first else count - half)
        still = np.repeat(
            moving[-1:] if h == first else moving[:1], count + 1 - len(moving), axis=0
        )
        made.append(np.concatenate([moving, still] if h == first else [still, moving]))
    return made[0], made[1]
