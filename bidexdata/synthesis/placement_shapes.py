"""A hand's two start postures as points in its palm frame, and the checks that placement makes."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bidexdata import frames
from bidexdata.hands.kinematics import hand_points
from bidexdata.hands.model import Hand

# A preferred direction this close to the palm normal (sine) says nothing about the roll.
_PARALLEL = 1e-3
# A palm faces sideways when its normal is more than 30 degrees (cosine) from the vertical.
_SIDEWAYS = 0.87


class StartShape(NamedTuple):
    """One hand in one posture, in its palm frame."""

    joints: Float[np.ndarray, " J"]
    """[rad]."""
    contacts: Float[np.ndarray, "C 3"]
    """Centres of the contact spheres [m]."""
    contact_radius: Float[np.ndarray, " C"]
    """[m]."""
    spheres: Float[np.ndarray, "K 3"]
    """Centres of the collision spheres [m]."""
    sphere_radius: Float[np.ndarray, " K"]
    """[m]."""
    middle: Float[np.ndarray, " 3"]
    """The point that hangs over the hull point [m]."""
    T_palm_hand: Float[np.ndarray, "4 4"]


@lru_cache(maxsize=32)
def start_shapes(hand: Hand, over: str) -> tuple[StartShape, StartShape]:
    """Give the hand in its open and in its curved posture.

    Args:
        hand: The hand.
        over: `contacts` or `palm`: what hangs over the hull point.
    """
    T_palm_hand = frames.invert(hand.T_hand_palm)
    shapes = []
    for joints in (hand.posture_open, hand.posture_curved):
        points = hand_points(hand, joints)
        contacts = frames.apply(T_palm_hand, points.contact)
        shapes.append(
            StartShape(
                joints=joints,
                contacts=contacts,
                contact_radius=hand.contact_radius,
                spheres=frames.apply(T_palm_hand, points.sphere),
                sphere_radius=hand.sphere_radius,
                middle=contacts.mean(axis=0) if over == "contacts" else np.zeros(3),
                T_palm_hand=T_palm_hand,
            )
        )
    return shapes[0], shapes[1]


def tangent_frames(
    z: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "n 3 3"]:
    """Complete unit vectors z to frames whose x is as close to `direction` as it can be.

    Where the direction is along z, x follows the axis that is least aligned with z.
    """
    x = direction - (z @ direction)[:, None] * z
    length = np.linalg.norm(x, axis=1, keepdims=True)
    x = np.where(length > _PARALLEL, x / np.maximum(length, _PARALLEL), 0.0)
    lost = length[:, 0] <= _PARALLEL
    if lost.any():
        x[lost] = frames.rotation_with_z(z[lost])[:, :, 0]
    return np.stack([x, np.cross(z, x), z], axis=-1)


def roll_from_down(
    turn: Float[np.ndarray, " n"],
    roll: Float[np.ndarray, " n"],
    normal: Float[np.ndarray, "n 3"],
    direction: Float[np.ndarray, " 3"],
    down: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, " n"]:
    """Turn from fingers down where the palm faces sideways, else from the preferred direction.

    Args:
        turn: From fingers down [rad].
        roll: From the preferred direction [rad].
        normal: Outward hull normals, object frame.
        direction: Preferred direction of the fingers.
        down: Where the table is.

    Returns:
        Turns from the preferred direction [rad].
    """
    # Sums and not products with BLAS, so that the number of starts cannot change the rounding.
    across = np.sum(tangent_frames(-normal, direction) * down[:, None], axis=1)
    of_down = np.arctan2(across[:, 1], across[:, 0])
    sideways = np.abs(np.sum(normal * down, axis=1)) < _SIDEWAYS
    return np.where(sideways, of_down + turn, roll)


def hands_apart(
    left: list[np.ndarray], right: list[np.ndarray], clearance: float
) -> Bool[np.ndarray, " n"]:
    """Tell which starts keep all spheres of one hand clear of the other's.

    Args:
        left: Sphere centres (n, K, 3) and radii (K,) [m].
        right: The same of the other hand.
        clearance: Least gap between any two spheres [m].
    """
    (a, r_a), (b, r_b) = left, right
    free = np.ones(len(a), bool)
    # Hands whose bounding balls are apart need no closer look.
    centre_a, centre_b = a.mean(axis=1), b.mean(axis=1)
    reach_a = (np.linalg.norm(a - centre_a[:, None], axis=2) + r_a).max(axis=1, initial=0.0)
    reach_b = (np.linalg.norm(b - centre_b[:, None], axis=2) + r_b).max(axis=1, initial=0.0)
    near = np.linalg.norm(centre_a - centre_b, axis=1) < reach_a + reach_b + clearance
    bound = (r_a[:, None] + r_b + clearance) ** 2
    for i in np.flatnonzero(near):
        u, v = a[i] - centre_a[i], b[i] - centre_a[i]
        square = (u * u).sum(1)[:, None] + (v * v).sum(1) - 2.0 * (u @ v.T)
        free[i] = not np.any(square < bound)
    return free
