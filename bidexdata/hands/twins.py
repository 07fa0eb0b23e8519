"""Which joint and contact point of one hand is the mirror image of which of the other's.

`mirror` answers this for the two sides of one spec; here the two hands are all there is, as in a
release.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bidexdata.frames import invert
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.hands.mirror import NoMirrorImage
from bidexdata.hands.model import FloatArray, Hand, IntArray

_FLIP = np.diag([1.0, -1.0, 1.0, 1.0])
"""Between a palm frame and its mirror image: y -> -y."""
_SAME_LIMITS = 1e-6
"""[rad]. Files carry limits with about this accuracy."""


class Twin(NamedTuple):
    """How a posed hand is mirrored onto the hand of the other side."""

    image: FloatArray
    """Points of its hand frame to their images in the other's, a reflection, (4, 4)."""
    joint: IntArray
    """Index in the other hand of each joint's twin, (J,)."""
    factor: FloatArray
    """Factor of each joint's angle, 1 or -1, (J,)."""
    contact: IntArray
    """Index in the other hand of each contact point's twin, (C,)."""


def twin_of(hand: Hand, other: Hand) -> Twin:
    """Find the mirror image of `hand` in `other`, by names behind the sides' prefixes.

    Raises:
        NoMirrorImage: The hands have other joints, contact points or limits, or are of one side.
    """
    if hand.side == other.side:
        raise NoMirrorImage(f"both hands are {hand.side} hands, and neither is the other's image")
    image = other.T_hand_palm @ _FLIP @ invert(hand.T_hand_palm)
    joint = _matched(hand, other, "joint_names")
    contact = _matched(hand, other, "contact_names")
    # A reflection M turns a rotation about a into one by the same angle about -M a.
    along = np.sum(_axes(other)[joint] * (-_axes(hand) @ image[:3, :3].T), axis=1)
    factor = np.where(along < 0, -1.0, 1.0)
    limits = np.sort(factor[:, None] * np.stack([hand.joint_lower, hand.joint_upper], 1), axis=1)
    theirs = np.stack([other.joint_lower, other.joint_upper], 1)[joint]
    apart = np.abs(limits - theirs).max(axis=1) > _SAME_LIMITS
    if apart.any():
        name = hand.joint_names[int(np.argmax(apart))]
        raise NoMirrorImage(f"the twin of joint {name!r} has other limits")
    return Twin(image, joint, factor, contact)


def _matched(hand: Hand, other: Hand, names: str) -> IntArray:
    mine = [n.removeprefix(hand.prefix) for n in getattr(hand, names)]
    theirs = [n.removeprefix(other.prefix) for n in getattr(other, names)]
    lacks = sorted(set(mine) ^ set(theirs))
    if lacks:
        raise NoMirrorImage(
            f"the {hand.side} and the {other.side} hand ({hand.name}, {other.name}) are no mirror "
            f"images: only one has {lacks[0]!r} among its {names}"
        )
    return np.array([theirs.index(name) for name in mine], np.int32)


def _axes(hand: Hand) -> FloatArray:
    """Axes of the joints in the hand frame at zero angles, (J, 3)."""
    count = len(hand.joint_names)
    _, rot = forward_kinematics(hand, np.zeros(count))
    mover = [int(np.flatnonzero(hand.body_joint == j)[0]) for j in range(count)]
    return np.einsum("jik,jk->ji", rot[mover], hand.joint_axis)
