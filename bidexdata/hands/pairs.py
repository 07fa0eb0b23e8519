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
    ordered = np.where((bodies[:, :1] > bodies[:, 1:]), pairs[:, ::-1], pairs)
    order = np.lexsort((*ordered.T[::-1], bodies.max(axis=1), bodies.min(axis=1)))
    pairs = ordered[order]
    bodies = hand.sphere_body[pairs]
    first = np.flatnonzero(np.any(np.diff(bodies, axis=0, prepend=-1) != 0, axis=1))
    ends = np.stack([first, np.append(first[1:], len(pairs))[: len(first)]], axis=1)
    balls = [[_ball(hand, np.unique(side)) for side in pairs[a:b].T] for a, b in ends]
    hubs = np.array([[hub for hub, _ in two] for two in balls], np.int32).reshape(-1, 2)
    reach = np.array([sum(radius for _, radius in two) for two in balls])
    return PairGroups(pairs, hubs, ends.astype(np.int32), reach + _ROUNDING)


def body_balls(hand: Hand) -> Balls:
    """Put one ball around the spheres of each body."""
    owned = [np.flatnonzero(hand.sphere_body == b) for b in np.unique(hand.sphere_body)]
    balls = [_ball(hand, spheres) for spheres in owned]
    radius = np.array([radius for _, radius in balls]) + _ROUNDING
    return Balls(np.array([hub for hub, _ in balls], np.int32), radius)


def _ball(hand: Hand, spheres: np.ndarray) -> tuple[int, float]:
    """Find the smallest ball around spheres of one body whose middle is one of its spheres'."""
    body = np.flatnonzero(hand.sphere_body == hand.sphere_body[spheres[0]])
    offset = hand.sphere_pos[body, None] - hand.sphere_pos[spheres]
    radius = (np.linalg.norm(offset, axis=-1) + hand.sphere_radius[spheres]).max(axis=1)
    best = int(np.argmin(radius))
    return int(body[best]), float(radius[best])


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
