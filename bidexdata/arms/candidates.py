"""Postures of one arm that take a grasp, and its motion from stand-off to lift in each of them.

A candidate is a posture at the grasp; from it the arm follows the hand's way back to the stand-off
and on to the lift, waypoint by waypoint. What stops a candidate is its gate, and what stops it there
its status; a grasp has the status of the candidate that came farthest. By spheres; the world frame.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bidexdata.arms.chain import chain_forward
from bidexdata.arms.clearance import FAR, clear_at
from bidexdata.arms.config import ArmConfig, just_above
from bidexdata.arms.inverse_kinematics import (
    LEAST_ERROR,
    IkSolutions,
    even_spread,
    follow,
    solve_first,
    solve_ik,
)
from bidexdata.arms.ranking import ROOM_COUNTS
from bidexdata.arms.robot import Arm, Robot
from bidexdata.arms.solutions import Grasps
from bidexdata.arms.stand_offs import stand_offs
from bidexdata.arms.surroundings import Placed, Surroundings
from bidexdata.arms.waypoints import Poses, lifted, line
from bidexdata.frames import matrix_from_quat
from bidexdata.objects.prepared import SignedDistanceGrid
from bidexdata.record.status import Status

REACHED, CLEAR, FOLLOWED, FREE = 1, 2, 3, 4
"""Gates that a candidate passes one after the other: a posture, clear at the grasp, all waypoints,
clear at all of them."""
_LOOK_EVERY = 3
"""Clearance is looked at so often along the waypoints [-]: hands go by two centimetres at most."""
_ALIKE = 0.05
"""Postures that differ by less in every joint are one [rad]."""
_KINDS = (Status.COLLISION_TABLE, Status.COLLISION_OBJECT, Status.COLLISION_SELF)


class Ways(NamedTuple):
    """Where one hand goes, T waypoints from stand-off to lift."""

    poses: Poses
    """(N, T)."""
    grasp: int
    """Number of the waypoint that is the grasp."""


class Candidates(NamedTuple):
    """C candidates of one arm for each of N grasps, best first."""

    q: Float[np.ndarray, "N C T A"]
    """Postures at the waypoints; NaN where there is none [rad]."""
    gate: Int[np.ndarray, "N C"]
    """The last gate that each passed; 0: no posture."""
    status: Int[np.ndarray, "N C"]
    """What stopped it; OK where nothing did."""
    room: Float[np.ndarray, "N C"]
    """Least clearance over the waypoints that are known, capped [m]."""
    cost: Float[np.ndarray, "N C"]
    """What is best is least; infinite for those that are stopped."""
    manipulability: Float[np.ndarray, "N C"]
    """At the grasp."""

    @property
    def free(self) -> Bool[np.ndarray, "N C"]:
        """Which nothing stopped."""
        return np.asarray(self.gate == FREE)

    def outcome(self) -> tuple[Int[np.ndarray, " N"], Int[np.ndarray, " N"], Int[np.ndarray, " N"]]:
        """Of the candidate of each grasp that came farthest: its number, gate and status."""
        order = np.lexsort((-self.room, -self.gate), axis=1)
        best = order[:, 0]
        rows = np.arange(len(best))
        return best, self.gate[rows, best], self.status[rows, best]


def ways(
    robot: Robot,
    side: int,
    around: Surroundings,
    grasps: Grasps,
    config: ArmConfig,
    refused: Int[np.ndarray, " N"] | None = None,
) -> Ways:
    """Give one hand's waypoints of each grasp: stand-off, pre-grasp, grasp, squeeze, lift.

    Args:
        robot: The robot.
        side: Which hand.
        around: The object, and the hands as they are before they close.
        grasps: The grasps.
        config: How.
        refused: How many stand-offs of each are passed over, the best first; none when omitted.
    """
    path = config.path
    if refused is None:
        refused = np.zeros(len(grasps.size), np.int64)
    pregrasp, grasp, squeeze = (
        Poses(grasps.hand_pos[:, side, s], grasps.hand_quat_wxyz[:, side, s]) for s in range(3)
    )
    if path.squeeze_palm == "fixed":
        squeeze = grasp
    back = stand_offs(robot.hands[side], side, pregrasp, around, config, refused)
    frames = [back, pregrasp, grasp, squeeze, lifted(squeeze, path.lift)]
    _approach, *counts = path.knots
    parts = [Poses(back.pos[:, None], back.quat_wxyz[:, None])]
    parts += [line(a, b, n) for a, b, n in zip(frames, frames[1:], counts, strict=False)]
    joined = Poses(*(np.concatenate(columns, axis=1) for columns in zip(*parts, strict=True)))
    return Ways(joined, counts[0] + counts[1])


def object_along(
    field: SignedDistanceGrid | None,
    grasps: Grasps,
    config: ArmConfig,
    *,
    device: str = "cpu",
) -> Surroundings:
    """The object of the grasps at every waypoint, rows (N T): it rises with the hands."""
    count = len(grasps.hand_pos)
    waypoints = 1 + sum(config.path.knots[1:])
    if field is None:
        return Surroundings(None, rows=count * waypoints, device=device)
    _approach, reach, close, squeeze, lift = config.path.knots
    rise = np.concatenate(
        [np.zeros(1 + reach + close + squeeze), np.arange(1, lift + 1) / lift * config.path.lift]
    )
    pos = grasps.object_pos[:, None] + rise[:, None] * np.array([0.0, 0.0, 1.0])
    rot = matrix_from_quat(grasps.object_quat_wxyz)
    placed = Placed(
        field,
        np.repeat(grasps.size, waypoints),
        pos.reshape(-1, 3),
        np.repeat(rot, waypoints, axis=0),
    )
    return Surroundings(placed, rows=count * waypoints, device=device)


def find_candidates(
    arm: Arm, way: Ways, around: Surroundings, config: ArmConfig, *, device: str = "cpu"
) -> Candidates:
    """Find the postures of one arm for N grasps of one scene, the best `search.kept` of each.

    Args:
        arm: The arm.
        way: Of its hand.
        around: The object at the waypoints, as `object_along` gives it.
        config: How.
        device: A Warp device.
    """
    config = _stricter(config)
    g, waypoints = way.grasp, way.poses.pos.shape[1]
    found = _postures(arm, way.poses.pos[:, g], way.poses.rot[:, g], config, device)
    new = found.ok & _distinct(found.q, found.ok)
    at_grasp = np.broadcast_to(np.arange(len(new))[:, None] * waypoints + g, new.shape)
    gap, kind = _least(arm, found.q, at_grasp, new, around, config)
    clear = new & (gap >= config.clearance.margin)
    away = np.abs(found.q - arm.chain.rest).max(axis=-1)
    order, gate = _best_first(new, clear, gap, away, config)
    q, gap, kind, away, ease = (
        np.take_along_axis(x, order.reshape(*order.shape, *[1] * (x.ndim - 2)), axis=1)
        for x in (found.q, gap, kind, away, found.manipulability)
    )
    made = Candidates(
        q=np.full((*q.shape[:2], waypoints, q.shape[2]), np.nan),
        gate=gate,
        status=np.where(gate == REACHED, kind, np.where(gate == 0, Status.IK_GRASP, Status.OK)),
        room=np.where(gate > 0, np.minimum(gap, config.clearance.enough), -np.inf),
        cost=np.full(gate.shape, np.inf),
        manipulability=ease,
    )
    made.q[:, :, g] = np.where((gate > 0)[:, :, None], q, np.nan)
    _follow_all(made, arm, way, around, away, config, device)
    best = np.lexsort((made.cost, -made.room, -made.gate), axis=1)
    some_free = np.any(made.free, axis=1, keepdims=True)
    best = np.where(some_free, np.argsort(made.cost, 1, kind="stable"), best)
    best = best[:, : config.search.kept]
    return Candidates(
        *(np.take_along_axis(x, best.reshape(*best.shape, *[1] * (x.ndim - 2)), axis=1)
          for x in made)
    )  # fmt: skip


def _postures(
    arm: Arm, pos: np.ndarray, rot: np.ndarray, config: ArmConfig, device: str
) -> IkSolutions:
    """Solve every target from starts whose hands are near it, and from starts near the rest.

    The first find postures of every kind, the second those to which the way from home is short. Targets
    that the first solve nowhere are out of reach as a rule, so the second are not asked about them.
    """
    near = solve_ik(arm.chain, pos, rot, config.ik, device=device)
    some = near.ok.any(axis=1)
    starts = postures_near_rest(arm, config.search.near_rest, config.search.rest_spread)
    short = solve_ik(arm.chain, pos[some], rot[some], config.ik, starts=starts, device=device)
    both = []
    for one, other in zip(short, near, strict=True):
        whole = np.zeros((len(pos), len(starts), *one.shape[2:]), one.dtype)
        whole[some] = one
        both.append(np.concatenate([whole, other], axis=1))
    return IkSolutions(*both)


def postures_near_rest(arm: Arm, count: int, spread: float) -> Float[np.ndarray, "S A"]:
    """The rest posture, and others spread evenly round it within the limits [rad]."""
    chain = arm.chain
    share = even_spread(count, chain.joints)
    beside = np.concatenate([np.zeros((1, chain.joints)), spread * (2.0 * share - 1.0)])[:count]
    return np.clip(chain.rest + beside, chain.lower, chain.upper)


def _stricter(config: ArmConfig) -> ArmConfig:
    """Accept a little less than is allowed, because kernels count in float32."""
    pos, rot = (
        max(0.98 * most, LEAST_ERROR) for most in (config.ik.accept_pos, config.ik.accept_rot)
    )
    return replace(config, ik=replace(config.ik, accept_pos=pos, accept_rot=rot))


def _follow_all(
    made: Candidates,
    arm: Arm,
    way: Ways,
    around: Surroundings,
    away: np.ndarray,
    config: ArmConfig,
    device: str,
) -> None:
    """Take candidates through their waypoints, some at a time, until every grasp has a free one.

    Writes to `made`.
    """
    size = config.search.kept
    for first in range(0, made.gate.shape[1], size):
        some = slice(first, first + size)
        rows = np.flatnonzero((made.gate[:, some] == CLEAR).any(axis=1) & ~made.free.any(axis=1))
        if not len(rows):
            break
        part = Candidates(*(x[rows, some] for x in made))
        poses = Poses(way.poses.pos[rows], way.poses.quat_wxyz[rows])
        _follow(part, rows, arm, Ways(poses, way.grasp), around, away[rows, some], config, device)
        for whole, piece in zip(made, part, strict=True):
            whole[rows, some] = piece


def _follow(
    part: Candidates,
    rows: np.ndarray,
    arm: Arm,
    way: Ways,
    around: Surroundings,
    away: np.ndarray,
    config: ArmConfig,
    device: str,
) -> None:
    """Follow and check candidates that are clear at the grasp; writes to `part`."""
    g, pos, rot = way.grasp, way.poses.pos, way.poses.rot
    alive = part.gate == CLEAR
    start = np.where(alive[:, :, None], part.q[:, :, g], np.nan)
    back = follow(
        arm.chain, start, pos[:, g - 1 :: -1], rot[:, g - 1 :: -1], config.ik, device=device
    )
    on = follow(arm.chain, start, pos[:, g + 1 :], rot[:, g + 1 :], config.ik, device=device)
    whole = np.concatenate([back.q[:, :, ::-1], start[:, :, None], on.q], axis=2)
    part.q[:] = np.where(alive[:, :, None, None], whole, part.q)
    reached = (back.reached == g) & (on.reached == pos.shape[1] - g - 1)
    steps = np.concatenate([back.step, on.step], axis=2)
    smooth = reached & (np.nan_to_num(steps, nan=9.0).max(axis=2) <= config.path.largest_step)
    stopped = alive & ~smooth
    part.status[stopped] = Status.JUMP
    missed = stopped & ~reached
    if missed.any():
        _name_misses(part, missed, back.reached, on.reached, arm, way, config, device)
    alive = alive & smooth
    part.gate[alive] = FOLLOWED
    looked = np.unique(np.append(np.arange(0, pos.shape[1], _LOOK_EVERY), [g, pos.shape[1] - 1]))
    mask = np.broadcast_to(alive[:, :, None], (*alive.shape, len(looked)))
    at = np.broadcast_to(rows[:, None, None] * pos.shape[1] + looked, mask.shape)
    gap, kind = _least(arm, whole[:, :, looked], at, mask, around, config)
    worst = gap.argmin(axis=2)[:, :, None]
    least = np.take_along_axis(gap, worst, axis=2)[:, :, 0]
    part.status[alive] = np.take_along_axis(kind, worst, axis=2)[:, :, 0][alive]
    part.room[alive] = np.minimum(least, config.clearance.enough)[alive]
    free = alive & (least >= config.clearance.margin)
    part.gate[free], part.status[free] = FREE, Status.OK
    goal = np.broadcast_to(pos[:, None, 0], (*free.shape, 3))[free]
    off = config.search.straight * hand_detour(arm, part.q[free][:, 0], goal)
    part.cost[free] = (away - ROOM_COUNTS * part.room)[free] + off


def hand_detour(
    arm: Arm, q: Float[np.ndarray, "M A"], goal: Float[np.ndarray, "M 3"]
) -> Float[np.ndarray, " M"]:
    """How far a hand leaves the straight line from home where its joints move in straight lines [m].

    The larger distance from that line of where the hand is after a third and two thirds of the way.

    Args:
        arm: The arm.
        q: Postures that it moves to from rest [rad].
        goal: Where they have the hand [m].
    """
    home = chain_forward(arm.chain, arm.chain.rest)[0]
    share = np.array([1 / 3, 2 / 3])[:, None, None]
    line = goal - home
    between = chain_forward(arm.chain, (1 - share) * arm.chain.rest + share * q)[0] - home
    square = np.maximum((line**2).sum(axis=-1), 1e-12)
    along = np.clip((between * line).sum(axis=-1) / square, 0.0, 1.0)
    return np.linalg.norm(between - along[..., None] * line, axis=-1).max(axis=0, initial=0.0)


def _name_misses(
    part: Candidates,
    missed: np.ndarray,
    back: np.ndarray,
    on: np.ndarray,
    arm: Arm,
    way: Ways,
    config: ArmConfig,
    device: str,
) -> None:
    """Say of waypoints that were missed whether another posture reaches them; writes to `part`."""
    n, c = np.nonzero(missed)
    waypoint = np.where(
        back[n, c] < way.grasp, way.grasp - 1 - back[n, c], way.grasp + 1 + on[n, c]
    )
    # One solve per waypoint, however many candidates missed it.
    keys, inverse = np.unique(n * way.poses.pos.shape[1] + waypoint, return_inverse=True)
    rows, times = np.divmod(keys, way.poses.pos.shape[1])
    cold = solve_first(
        arm.chain, way.poses.pos[rows, times], way.poses.rot[rows, times], config.ik, device=device
    )
    _approach, reach, close, squeeze, _lift = config.path.knots
    ends = np.array([reach + close, reach + close + squeeze])
    names = np.array([Status.IK_PREGRASP, Status.IK_GRASP, Status.IK_LIFT])
    name = names[np.searchsorted(ends, times, side="left")]
    part.status[n, c] = np.where(cold.ok, Status.JUMP, name)[inverse]


def _least(
    arm: Arm,
    q: np.ndarray,
    rows: np.ndarray,
    asked: np.ndarray,
    around: Surroundings,
    config: ArmConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """Least clearance of the configurations that are asked about, and the status of what is nearest."""
    rule = config.clearance
    most = just_above(max(rule.enough, rule.margin))
    gap, kind = np.full(asked.shape, FAR), np.full(asked.shape, int(Status.OK))
    found = clear_at(arm, q[asked], rows[asked], around, with_hand=False, most=most)
    gap[asked], kind[asked] = found.min(axis=0), np.array(_KINDS)[found.argmin(axis=0)]
    return gap, kind


def _best_first(
    new: np.ndarray, clear: np.ndarray, gap: np.ndarray, away: np.ndarray, config: ArmConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Order of the candidates and the gate that each has passed, in that order."""
    room = np.minimum(gap, config.clearance.enough)
    gate = np.where(clear, CLEAR, np.where(new, REACHED, 0))
    order = np.lexsort((away - ROOM_COUNTS * room, -gate), axis=1)
    return order, np.take_along_axis(gate, order, axis=1)


def _distinct(q: np.ndarray, ok: np.ndarray) -> np.ndarray:
    """Which postures are unlike all good ones before them, (N, S)."""
    before = np.tril(np.ones((q.shape[1],) * 2, bool), k=-1)
    near = before & ok[:, None, :]
    for angle in np.moveaxis(q, 2, 0):  # joint by joint, which is sooner than all at once
        near &= np.abs(angle[:, :, None] - angle[:, None]) < _ALIKE
    return np.asarray(~np.any(near, axis=2))
