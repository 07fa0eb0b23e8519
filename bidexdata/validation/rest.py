"""When a load may end before its time: the object rests, and will go on resting.

Motion alone cannot tell. Grips creep at about 1 mm/s, those that hold for ever and those that let
go after two seconds alike. Friction can: under the loads with half of it the latter lose the object
at once, the former hardly move, or soon come to rest elsewhere. So each grasp is probed once, and
the looser it is the longer it is watched.

Source:
    docs/measurements.md, 8, for the form of the rule; the probe and all numbers are ours, chosen on
    loads held to their end: `python -m benchmarks.truth RUN` compares the verdicts with such runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from bidexdata.record import Status
from bidexdata.simulation.scene import SimScene
from bidexdata.simulation.state import object_speed, restore_state, saved_state

from .checks import check, reference
from .loads import clear_load, set_load
from .protocols import Protocol

FloatArray = NDArray[np.float64]


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
    """Share of the sliding friction that the probe leaves [-]."""
    probe_time: float = 0.06
    """Duration of the probe under each load [s]."""
    firm_moved: float = 0.02
    """A firm grasp moves less than this in it [m] ..."""
    firm_turned: float = math.radians(10.0)
    """... turns less than this [rad] ..."""
    firm_speed: float = 0.3
    """... and is slower than this when a load ends [m/s]."""
    settled_moved: float = 0.03
    """A grasp that settles moves less than this [m] ..."""
    settled_turned: float = math.radians(12.0)
    """... and turns less than this [rad]. One that loses the object is loose."""

    firm: tuple[Slow, ...] = (
        Slow(speed=0.012, turn=0.06, times=1.0, share=0.6, at_most=0.5),
        Slow(speed=0.0007, turn=0.005, times=2.0, share=0.9),
    )
    """Any of these ends a load on a firm grasp."""
    settled: tuple[Slow, ...] = (
        Slow(speed=0.01, turn=0.06, times=1.0, share=0.5, at_most=1.0),
        Slow(speed=0.003, turn=0.02, times=2.0, share=0.7),
    )
    """... on one that settles."""
    fair: tuple[Slow, ...] = (Slow(speed=0.0015, turn=0.01, times=2.0, share=0.8),)
    """... on a fair one: any other that keeps the object."""
    loose: tuple[Slow, ...] = ()
    """... on a loose one: none does, it is held to the end."""
    unknown: tuple[Slow, ...] = (Slow(speed=0.001, turn=0.008, times=2.0, share=0.7, after=1.0),)
    """... on one that has not been probed: under other loads than the protocol's."""

    def of(self, grip: Grip) -> tuple[Slow, ...]:
        """The rules for one kind of grip."""
        return getattr(self, grip.value)


_LIFT_STRICT = (Slow(speed=0.0005, turn=0.004, times=2.0, share=0.7, after=1.0),)
LIFT_RULES = RestRules(
    probe_time=0.12,
    firm_moved=0.01,
    firm_turned=math.radians(5.0),
    firm_speed=0.05,
    firm=(Slow(speed=0.05, turn=0.25, times=1.0, share=0.6, at_most=0.35), *RestRules().firm),
    settled=(Slow(speed=0.003, turn=0.02, times=2.0, share=0.7),),
    loose=_LIFT_STRICT,
    unknown=_LIFT_STRICT,
)
"""For the hold of a lift: the probe's one load tells less than six, and strict rules cost little
where only one hold is watched."""


class Grip(Enum):
    """How a grasp took less friction."""

    FIRM = "firm"
    SETTLED = "settled"
    FAIR = "fair"
    LOOSE = "loose"
    UNKNOWN = "unknown"


def probe(
    scene: SimScene, protocol: Protocol, rules: RestRules, loads: Sequence[FloatArray]
) -> Grip:
    """Say how the grasp takes the loads with less friction, one after the other.

    State and friction stay as they are; the load is off afterwards.

    Args:
        scene: Hands closed on the object.
        protocol: Size of the loads; what leaves its limits is lost.
        rules: The numbers.
        loads: Directions, unit vectors of the world.
    """
    model, state = scene.model, saved_state(scene)
    friction = model.geom_friction[:, 0].copy()
    start = reference(scene, protocol)
    steps = max(1, round(rules.every / model.opt.timestep))
    looks = max(1, round(rules.probe_time / rules.every))
    moved = turned = speed = 0.0
    model.geom_friction[:, 0] *= rules.probe_friction
    try:
        for load in loads:
            set_load(scene, protocol, load, 1.0)
            for _ in range(looks):
                scene.step(steps)
                now = check(scene, protocol, start)
                if now.status is not Status.OK:
                    return Grip.LOOSE
                moved, turned = max(moved, now.moved), max(turned, now.turned)
            speed = max(speed, object_speed(scene)[0])
    finally:
        model.geom_friction[:, 0] = friction
        clear_load(scene)
        restore_state(scene, state)
    slow = speed < rules.firm_speed
    if moved < rules.firm_moved and turned < rules.firm_turned and slow:
        return Grip.FIRM
    if moved < rules.settled_moved and turned < rules.settled_turned:
        return Grip.SETTLED
    return Grip.FAIR


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
