"""Figures of one grasp at its grasp pose: penetration depths, contact number and distances.

Source:
    DexGraspBench (its metrics at the grasp pose), over both hands and all fingers as in
    BiDexGrasp, section 6; its index and name traps are not reproduced.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bidexdata.simulation.distances import Distances


class Metrics(NamedTuple):
    """The metric columns of one grasp."""

    pd: float
    """Deepest hand-object overlap [m]."""
    spd: float
    """Deepest overlap within a hand or between hands [m]."""
    cdc: float
    """Largest minus smallest signed finger-object distance, capped at the reach [m]."""
    contact_number: int
    """Hand bodies within the contact threshold of the object, or inside it."""
    contact_distance: float
    """Mean over fingers of the distance to the object, 0 where a finger is inside [m]."""


def grasp_metrics(distances: Distances, contact_within: float) -> Metrics:
    """Compute the figures from the distances at the grasp.

    Args:
        distances: Measured with the protocol's reach.
        contact_within: A body closer than this counts as in contact [m].
    """
    fingers = distances.fingers
    has_fingers = len(fingers) > 0
    return Metrics(
        pd=max(0.0, -distances.hand_object),
        spd=max(0.0, -distances.self_collision, -distances.inter_hand),
        cdc=float(np.ptp(fingers)) if has_fingers else np.nan,
        contact_number=int(sum((b < contact_within).sum() for b in distances.bodies)),
        contact_distance=float(np.maximum(fingers, 0.0).mean()) if has_fingers else np.nan,
    )
