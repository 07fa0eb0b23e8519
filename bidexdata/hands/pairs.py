"""Sphere pairs of one hand that the optimiser must keep apart.

A pair counts when its bodies may collide in the simulation (not parent and child, not excluded by
the model), when the spheres do not overlap in the rest pose or the starting postures, and when some
joint angles within the limits bring them together. Without the last condition most of the pairs
would be work for nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.hands.kinematics import hand_points
from bidexdata.hands.model import FloatArray, Hand, IntArray

if TYPE_CHECKING:
    import mujoco

_POSTURES = 2000
"""Random postures within the limits that are tried."""
_NEAR = 0.0
"""Smallest gap over the postures below which a pair counts [m]."""
_ROUNDING = 1e-6
"""Room for float32 positions in bounds of distances [m]."""


class PairGroups(NamedTuple):
    """Sphere pairs of a hand by pair of bodies, and balls that tell when none of them can meet."""

    pairs: IntArray
    """All pairs, those of one group side by side, (P, 2)."""
    hubs: IntArray
    """Spheres whose centres are the middles of each group's two balls, (G, 2)."""
    ends: IntArray
    """First pair of each group, and the one behind its last, (G, 2)."""
    reach: FloatArray
    """Sum of each group's ball radii [m]: hubs farther apart leave all its pairs apart, (G,)."""


class Balls(NamedTuple):
    """Balls that hold all spheres of a hand, one for each body that has any."""

    hubs: IntArray
    """Spheres whose centres are the middles, (b,)."""
    radius: FloatArray
    """[m], (b,)."""


def self_pairs(hand: Hand, model: mujoco.MjModel) -> IntArray:
    """List the sphere pairs that must not overlap, (P, 2)."""
    a, b = np.triu_indices(len(hand.sphere_body), k=1)
    allowed = _may_collide(hand, model)[hand.sphere_body[a], hand.sphere_body[b]]
    a, b = a[allowed], b[allowed]
    rest = np.clip(0.0, hand.joint_lower, hand.joint_upper)
    standing = np.stack([rest, hand.posture_open, hand.posture_curved])
    apart = _gap(hand, standing, a, b).min(axis=0) > 0
    a, b = a[apart], b[apart]
    near = np.full(len(a), np.inf)
    for block in np.array_split(_random_postures(hand), 20):
        near = np.minimum(near, _gap(hand, block, a, b).min(axis=0))
    meets = near < _NEAR
    return np.stack([a[meets], b[meets]], axis=1).astype(np.int32)


def pair_groups(hand: Hand) -> PairGroups:
    """Group `hand.self_pairs` by the bodies of their spheres."""
    pairs = hand.self_pairs.reshape(-1, 2)
    bodies = hand.sphere_body[pairs]
    ordered = np.where(bodies[:, :1] > bodies[:, 1:], pairs[:, ::-1], pairs)
    order = np.lexsort((*ordered.T[::-1], bodies.max(axis=1), bodies.min(axis=1)))
    pairs = ordered[order]
    bodies = hand.sphere_body[pairs]
    first = np.flatnonzero(np.any(np.diff(bodies, axis=0, prepend=-1) != 0, axis=1))
    stop = np.append(first[1:], len(pairs))[: len(first)]
    reach = _reach(hand)
    one, other = (_balls(reach, side, first) for side in pairs.T)
    return PairGroups(
        pairs=pairs,
        hubs=np.stack([one.hubs, other.hubs], axis=1),
        ends=np.stack([first, stop], axis=1).astype(np.int32),
        reach=one.radius + other.radius,
    )


def body_balls(hand: Hand) -> Balls:
    """Put one ball around the spheres of each body."""
    order = np.argsort(hand.sphere_body, kind="stable")
    first = np.flatnonzero(np.diff(hand.sphere_body[order], prepend=-1))
    return _balls(_reach(hand), order, first)


def _reach(hand: Hand) -> FloatArray:
    """Radius of the ball in the middle of each sphere that holds another [m], (K, K).

    Infinite for spheres of two bodies.
    """
    offset = hand.sphere_pos[:, None] - hand.sphere_pos
    reach = np.sqrt(np.einsum("kni,kni->kn", offset, offset)) + hand.sphere_radius
    return np.where(hand.sphere_body[:, None] == hand.sphere_body, reach, np.inf)


def _balls(reach: FloatArray, spheres: np.ndarray, first: np.ndarray) -> Balls:
    """Put a ball around each run of spheres of one body, in the middle of one of the body's.

    Args:
        reach: From `_reach`.
        spheres: The runs, one after the other.
        first: Where each run begins.
    """
    of_run = np.maximum.reduceat(reach[:, spheres], first, axis=1)
    return Balls(of_run.argmin(axis=0).astype(np.int32), of_run.min(axis=0) + _ROUNDING)


def _may_collide(hand: Hand, model: mujoco.MjModel) -> np.ndarray:
    """Pairs of bodies that the simulation lets collide, (B, B) bool."""
    allowed = ~np.eye(len(hand.body_names), dtype=bool)
    for child, parent in enumerate(hand.body_parent):
        if parent >= 0:
            allowed[child, parent] = allowed[parent, child] = False
    # MuJoCo packs an excluded pair as (body1 << 16) + body2; body 0 is the world.
    first, second = model.exclude_signature >> 16, model.exclude_signature & 0xFFFF
    allowed[first - 1, second - 1] = allowed[second - 1, first - 1] = False
    return allowed


def _random_postures(hand: Hand) -> FloatArray:
    """The same postures every time: coupled joints together, half of them at a limit."""
    rng = np.random.default_rng(0)
    share = rng.random((_POSTURES, hand.coupling.shape[1]))
    share[::2] = np.clip(2 * share[::2] - 0.5, 0, 1)
    share = share @ hand.coupling.T
    return hand.joint_lower + share * (hand.joint_upper - hand.joint_lower)


def _gap(hand: Hand, joints: FloatArray, a: np.ndarray, b: np.ndarray) -> FloatArray:
    """Gaps between spheres a and b in each posture [m], (n, pairs)."""
    centre = hand_points(hand, joints).sphere
    apart = np.linalg.norm(centre[:, a] - centre[:, b], axis=-1)
    return apart - hand.sphere_radius[a] - hand.sphere_radius[b]
