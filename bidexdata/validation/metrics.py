"""Figures of one grasp at its grasp pose: penetration depths, contact number and distances.

Source:
    DexGraspBench (its metrics at the grasp pose), over both hands and all fingers as in
    BiDexGrasp, section 6. Which of its index and name traps are reproduced is the protocol's
    `MetricRules`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.hands.model import Hand
from bidexdata.simulation.distances import Distances, measure_distances
from bidexdata.simulation.scene import SimScene

from .protocols import MetricRules
from .stages import Grasp

FloatArray = NDArray[np.float64]


class Metrics(NamedTuple):
    """The metric columns of one grasp."""

    pd: float
    """Deepest overlap of one hand geom and one piece [m]."""
    spd: float
    """Deepest overlap of two geoms of a hand or of two hands [m]."""
    cdc: float
    """Largest minus smallest signed finger-object distance, capped at the reach [m]."""
    contact_number: int
    """Hand bodies in contact with the object, by the protocol's rule."""
    contact_distance: float
    """Mean over fingers of the distance to the object, 0 where a finger is inside [m]."""


def measure(scene: SimScene, rules: MetricRules, grasp: Grasp) -> Distances:
    """Measure the distances at the grasp pose as the rules want them."""
    return measure_distances(
        scene,
        grasp.object_pos,
        grasp.object_quat,
        grasp.hand_pos[:, 1],
        grasp.hand_quat[:, 1],
        grasp.joints[:, 1],
        reach=rules.reach,
        full_broad_phase=rules.full_broad_phase,
        last_body_counts=rules.last_body_counts,
    )


def grasp_metrics(distances: Distances, rules: MetricRules, hands: Sequence[Hand]) -> Metrics:
    """Compute the figures from the distances at the grasp.

    Args:
        distances: From `measure`.
        rules: What counts.
        hands: Those of the distances, for the names of their bodies.
    """
    fingers = _by_prefix(distances, hands) if rules.fingers_by_prefix else distances.fingers
    has_fingers = len(fingers) > 0
    deepest = min(distances.hand_object, 0.0)
    among = min(distances.self_collision, distances.inter_hand, 0.0)
    if rules.table_is_hand:
        deepest = min(deepest, distances.object_table)
        among = min(among, distances.table)
    touching = _touching(distances, rules)
    counted = [t[_counted(rules, hand)] for t, hand in zip(touching, hands, strict=True)]
    return Metrics(
        pd=-deepest or 0.0,
        spd=-among or 0.0,
        cdc=float(np.ptp(fingers)) if has_fingers else np.nan,
        contact_number=int(sum(t.sum() for t in counted)),
        contact_distance=float(np.maximum(fingers, 0.0).mean()) if has_fingers else np.nan,
    )


def _touching(distances: Distances, rules: MetricRules) -> list[NDArray[np.bool_]]:
    """Whether each body is in contact, per hand (B,).

    Where depth does not count, a body that is deep in one piece may still touch another.
    """
    if rules.deep_counts:
        return [b < rules.contact_within for b in distances.bodies]
    contacts, found = distances.contacts, [np.zeros(len(b), bool) for b in distances.bodies]
    close = np.abs(contacts.dist) < rules.contact_within
    for hand, body in zip(contacts.hand[close], contacts.body[close], strict=True):
        found[hand][body] = True
    return found


def _counted(rules: MetricRules, hand: Hand) -> NDArray[np.bool_]:
    return np.array([name not in rules.uncounted_bodies for name in hand.plain_body_names])


def _by_prefix(distances: Distances, hands: Sequence[Hand]) -> FloatArray:
    """Smallest distance of the bodies whose names begin with a finger's, (F,).

    Where no name does, the finger's bodies are those of the hand's spec.
    """
    nearest = []
    for hand, bodies in zip(hands, distances.bodies, strict=True):
        for finger, own in hand.fingers.items():
            begin = [k for k, n in enumerate(hand.plain_body_names) if n.startswith(finger)]
            mine = begin or [hand.body_names.index(name) for name in own]
            nearest.append(float(bodies[mine].min()))
    return np.array(nearest)
