"""When a load may end before its time: the object rests, and will go on resting.

Motion alone cannot tell. Grips creep at about 1 mm/s, those that hold for ever and those that let
go after two seconds alike. Friction can: with half of it the latter lose the object at once, the
former hardly move, or soon come to rest elsewhere. So each grasp is probed once, and the looser it
is the longer it is watched.

Source:
    docs/measurements.md, 8, for the form of the rule; the probe and all numbers are ours, chosen on
    loads held to their end: `python -m benchmarks.truth RUN` compares the verdicts with such runs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from bidexdata.record import Status
from bidexdata.simulation.scene import SimScene
from bidexdata.simulation.state import object_speed, restore_state, saved_state

from .checks import check, reference
from .protocols import Protocol


@dataclass(frozen=True, slots=True, kw_only=True)
class Slow:
    """A load may end when the object is this slow, and would stay near by going on as it does."""

    speed: float
    """Of the centre of mass [m/s]."""
    turn: float
    """Rate of turning [rad/s]."""
    times: float
    """Going on for this multiple of the time that is left [-] ..."""
    share: float
    """... keeps the object within this share of both limits [-]."""
    at_most: float | None = None
    """No longer than this counts as time that is left [s]."""
    after: float = 0.0
    """Not before the load has lasted this long [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RestRules:
    """Numbers of the probe and of the rules."""

    start: float = 0.04
    """Time under the load at which it may first end [s]."""
    every: float = 0.02
    """Time between two looks [s]."""
    probe_friction: float = 0.5
    """Share of the sliding friction that the first probe leaves [-]."""
    probe_time: float = 0.2
    """Duration of the first probe [s]."""
    firm_moved: float = 0.006
    """A firm grasp moves less than this in it [m] ..."""
    firm_turned: float = math.radians(2.5)
    """... turns less than this [rad] ..."""
    firm_end: float = 0.008
    """... and ends slower than this [m/s]."""
    settled_moved: float = 0.015
    """A grasp that settles moves less than this [m] ..."""
    settled_turned: float = math.radians(10.0)
    """... turns less than this [rad] ..."""
    settled_end: float = 0.002
    """... and ends slower than this [m/s]."""
    loose_friction: float = 2 / 3
    """Share of the sliding friction that the second probe leaves [-]."""
    loose_time: float = 0.1
    """Duration of the second probe [s]."""
    loose_moved: float = 0.008
    """A loose grasp moves more than this in both probes [m]."""

    firm: tuple[Slow, ...] = (
        Slow(speed=0.04, turn=0.2, times=1.0, share=0.6, at_most=0.4),
        Slow(speed=0.012, turn=0.06, times=1.0, share=0.6, at_most=0.5),
        Slow(speed=0.0007, turn=0.005, times=2.0, share=0.9),
    )
    """Any of these ends a load on a firm grasp."""
    settled: tuple[Slow, ...] = (Slow(speed=0.003, turn=0.02, times=2.0, share=0.9),)
    """... on one that settles."""
    fair: tuple[Slow, ...] = (Slow(speed=0.0015, turn=0.01, times=2.0, share=0.8),)
    """... on any other that is not loose."""
    loose: tuple[Slow, ...] = (Slow(speed=0.0005, turn=0.004, times=2.0, share=0.7, after=1.0),)
    """... on a loose one."""

    def of(self, grip: Grip) -> tuple[Slow, ...]:
        """The rules for one kind of grip."""
        return getattr(self, grip.value)


class Grip(Enum):
    """How a grasp took less friction."""

    FIRM = "firm"
    SETTLED = "settled"
    FAIR = "fair"
    LOOSE = "loose"


def probe(scene: SimScene, protocol: Protocol, rules: RestRules) -> Grip:
    """Say how the grasp takes less friction under what acts now; the state stays as it is."""
    way = _with_friction(scene, protocol, rules, rules.probe_friction, rules.probe_time)
    if way.within(rules.firm_moved, rules.firm_turned, rules.firm_end):
        return Grip.FIRM
    if way.within(rules.settled_moved, rules.settled_turned, rules.settled_end):
        return Grip.SETTLED
    if way.moved < rules.loose_moved:
        return Grip.FAIR
    way = _with_friction(scene, protocol, rules, rules.loose_friction, rules.loose_time)
    return Grip.FAIR if way.moved < rules.loose_moved else Grip.LOOSE


class _Way(NamedTuple):
    """How far an object went in a probe; infinite when it was lost."""

    moved: float
    """Largest displacement [m]."""
    turned: float
    """Largest rotation [rad]."""
    speed: float
    """At the end [m/s]."""

    def within(self, moved: float, turned: float, speed: float) -> bool:
        return self.moved < moved and self.turned < turned and self.speed < speed


def _with_friction(
    scene: SimScene, protocol: Protocol, rules: RestRules, share: float, duration: float
) -> _Way:
    model, state = scene.model, saved_state(scene)
    friction = model.geom_friction[:, 0].copy()
    start = reference(scene, protocol)
    steps = max(1, round(rules.every / model.opt.timestep))
    largest = np.zeros(2)
    model.geom_friction[:, 0] *= share
    try:
        for _ in range(round(duration / rules.every)):
            scene.step(steps)
            now = check(scene, protocol, start)
            if now.status is not Status.OK:
                return _Way(np.inf, np.inf, np.inf)
            largest = np.maximum(largest, (now.moved, now.turned))
        return _Way(float(largest[0]), float(largest[1]), object_speed(scene)[0])
    finally:
        model.geom_friction[:, 0] = friction
        restore_state(scene, state)


def rests(
    scene: SimScene,
    protocol: Protocol,
    rules: RestRules,
    grip: Grip,
    *,
    moved: float,
    turned: float,
    lasted: float,
    left: float,
) -> bool:
    """Whether the load may end here.

    Args:
        scene: Its object's speed counts.
        protocol: The limits.
        rules: The numbers.
        grip: What the probe said.
        moved: Displacement at present [m].
        turned: Rotation at present [rad].
        lasted: Time since its start [s].
        left: Time until the end of the load [s].
    """
    linear, angular = object_speed(scene)
    for slow in rules.of(grip):
        ahead = slow.times * (left if slow.at_most is None else min(left, slow.at_most))
        if (
            lasted >= slow.after
            and linear < slow.speed
            and angular < slow.turn
            and moved + ahead * linear < slow.share * protocol.limit_pos
            and turned + ahead * angular < slow.share * protocol.limit_rot
        ):
            return True
    return False
