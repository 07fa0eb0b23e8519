"""Contact sets: which of a hand's contact points a grasp is made with.

Source: BiDexGrasp names fingertips alone as its first limitation; pads and palm are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from bidexdata.hands.model import Hand, IntArray, Part

ContactSet = Literal["fingertips", "pads", "with_palm"]

_PARTS: dict[ContactSet, tuple[Part, ...]] = {
    "fingertips": ("fingertip",),
    "pads": ("fingertip", "pad"),
    "with_palm": ("fingertip", "palm"),
}


def set_numbers(hand: Hand, name: ContactSet) -> IntArray:
    """Number the contact points of a set among all of the hand; the fingertips come first."""
    parts = _PARTS[name]
    return np.flatnonzero([part in parts for part in hand.contact_part]).astype(np.int32)


def contact_view(hand: Hand, name: ContactSet) -> Hand:
    """Give the hand with the contact points of one set only; all else is shared."""
    kept = set_numbers(hand, name)
    return replace(
        hand,
        contact_names=tuple(hand.contact_names[c] for c in kept),
        contact_body=hand.contact_body[kept],
        contact_pos=hand.contact_pos[kept],
        contact_radius=hand.contact_radius[kept],
        contact_normal=hand.contact_normal[kept],
        contact_finger=tuple(hand.contact_finger[c] for c in kept),
        contact_part=tuple(hand.contact_part[c] for c in kept),
    )


def usable_sets(hands: Sequence[Hand], names: Sequence[ContactSet]) -> tuple[ContactSet, ...]:
    """Leave out sets that give every hand the points of one before them, as without a palm's places.

    So hands without such points make grasps by their fingertips, whatever sets are asked for.
    """
    found: dict[tuple[bytes, ...], ContactSet] = {}
    for name in names:
        found.setdefault(tuple(set_numbers(hand, name).tobytes() for hand in hands), name)
    return tuple(found.values())
