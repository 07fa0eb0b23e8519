"""Verdict: what became of one grasp in one test, and how its cause is named."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bidexdata.record import Status
from bidexdata.record.status import TestStage
from bidexdata.simulation.distances import measure_distances
from bidexdata.simulation.scene import SimScene

from .protocols import Protocol
from .stages import Grasp, Phase

UNSTABLE = (Status.UNSTABLE, Status.BLOWN_UP)


class Verdict(NamedTuple):
    """What became of one grasp in one test."""

    status: Status
    failed_stage: TestStage = TestStage.NONE
    direction: int = -1
    """First failing load of test f, a place in `record.fields.DIRECTIONS`; -1 when none failed."""
    drift_pos: float = np.nan
    """Largest displacement at a check or an early end [m]; NaN when nothing was simulated, or the
    simulation broke while closing."""
    drift_rot: float = np.nan
    """Largest rotation, likewise [rad]."""
    time: float = np.nan
    """Simulated time of the failure since the start of its phase [s]; NaN on success."""
    load_margin: float = np.nan
    """Largest multiple of the load that holds, 0 where the hands never closed on the object, or
    arms overlapped something; NaN where it was not measured."""


def start_overlap(scene: SimScene, protocol: Protocol, grasp: Grasp) -> Verdict | None:
    """Refuse a pre-grasp that overlaps deeper than the protocol allows; None when it does not.

    Counted are each hand with the object, with itself and with the other; in a scene with a table
    hands with the table (in every protocol), and where the protocol takes the table for a hand
    (`MetricRules.table_is_hand`) the object with the table.
    """
    at = (grasp.hand_pos[:, 0], grasp.hand_quat[:, 0], grasp.joints[:, 0])
    counts = protocol.metrics.last_body_counts
    d = measure_distances(
        scene, grasp.object_pos, grasp.object_quat, *at, reach=0.0, last_body_counts=counts
    )
    deepest = min(d.hand_object, d.self_collision, d.inter_hand, d.table)
    if protocol.metrics.table_is_hand:
        deepest = min(deepest, d.object_table)
    if deepest < -protocol.start_depth:
        return Verdict(Status.START_PENETRATION, TestStage.START, time=0.0)
    return None


def closing_failure(protocol: Protocol, status: Status, moved: float, turned: float) -> Verdict:
    """The verdict on an object that left the limits, or a simulation that broke, while closing."""
    cause = status if status in UNSTABLE else Status.THROWN
    return Verdict(cause, TestStage.CLOSING, -1, moved, turned, protocol.closing_time)


def hold_cause(phase: Phase, *, touched: bool, thrown: bool = False, lifted: bool = True) -> Status:
    """Why a load was not held.

    Args:
        phase: The failed phase.
        touched: A hand was in contact with the object when the hands had closed.
        thrown: The object was beyond the limits when the hands had closed.
        lifted: The object had left the table when the hands were up.
    """
    if phase.status in UNSTABLE:
        return phase.status
    if thrown:
        return Status.THROWN
    if not touched:
        return Status.NO_CONTACT
    if not lifted:
        return Status.NOT_LIFTED
    return phase.status
