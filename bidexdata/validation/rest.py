"""When a load may end before its time: the object rests, and will go on resting.

Motion alone cannot tell. Grips creep at about 1 mm/s, those that hold for ever and those that let
go after two seconds alike. Friction can: with half of it the latter lose the object at once, the
former hardly move. So each grasp is probed once; a firm one is accepted as soon as it is slow, any
other only when it is all but still.

Source:
    docs/measurements.md, 8, for the form of the rule; the probe and its numbers are ours:
    `python -m benchmarks.truth RUN` compares the verdicts with plain simulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bidexdata.record import Status
from bidexdata.simulation.scene import SimScene
from bidexdata.simulation.state import object_speed

from .checks import check, reference
from .protocols import Protocol


@dataclass(frozen=True, slots=True, kw_only=True)
class RestRules:
    """Numbers of the probe and of the two rules."""

    start: float = 0.06
    """Time under the load at which it may first end [s]."""
    every: float = 0.02
    """Time between two looks [s]."""
    share: float = 0.8
    """Where the object is expected to be must stay within this share of both limits [-]."""

    probe_friction: float = 0.5
    """Share of the sliding friction that the probe leaves [-]."""
    probe_time: float = 0.2
    """Duration of the probe [s]."""
    probe_moved: float = 0.004
    """A firm grasp moves less than this in the probe [m] ..."""
    probe_turned: float = math.radians(2.0)
    """... turns less than this [rad] ..."""
    probe_speed: float = 0.005
    """... and ends slower than this [m/s]."""

    firm_speed: float = 0.01
    """A firm grasp is accepted below this speed [m/s] ..."""
    firm_turn: float = 0.05
    """... and this rate of turning [rad/s] ..."""
    firm_ahead: float = 0.5
    """... if it could keep both for so long [s]."""

    other_speed: float = 0.0007
    """Any other grasp is accepted below this speed [m/s] ..."""
    other_turn: float = 0.005
    """... and this rate of turning [rad/s] ..."""
    other_factor: float = 2.0
    """... if it could keep this multiple of both to the end of the load [-]."""


def is_firm(scene: SimScene, protocol: Protocol, rules: RestRules) -> bool:
    """Whether the grasp would hold with less friction under what acts now; the state stays as it is."""
    import mujoco

    model, data = scene.model, scene.data
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    friction = model.geom_friction[:, 0].copy()
    model.geom_friction[:, 0] *= rules.probe_friction
    try:
        return _stays(scene, protocol, rules)
    finally:
        model.geom_friction[:, 0] = friction
        mujoco.mj_setState(model, data, state, kind)


def _stays(scene: SimScene, protocol: Protocol, rules: RestRules) -> bool:
    import mujoco

    start = reference(scene, protocol)
    every = max(1, round(rules.every / scene.model.opt.timestep))
    for _ in range(round(rules.probe_time / rules.every)):
        mujoco.mj_step(scene.model, scene.data, every)
        status, moved, turned = check(scene, protocol, start)
        if status is not Status.OK or moved > rules.probe_moved or turned > rules.probe_turned:
            return False
    return object_speed(scene)[0] < rules.probe_speed


def rests(
    scene: SimScene,
    protocol: Protocol,
    rules: RestRules,
    *,
    firm: bool,
    moved: float,
    turned: float,
    left: float,
) -> bool:
    """Whether the load may end here.

    Args:
        scene: Its object's speed counts.
        protocol: The limits.
        rules: The numbers.
        firm: What the probe said.
        moved: Displacement at present [m].
        turned: Rotation at present [rad].
        left: Time until the end of the load [s].
    """
    linear, angular = object_speed(scene)
    if firm:
        slow = linear < rules.firm_speed and angular < rules.firm_turn
        ahead = min(rules.firm_ahead, left)
    else:
        slow = linear < rules.other_speed and angular < rules.other_turn
        ahead = rules.other_factor * left
    return (
        slow
        and moved + ahead * linear < rules.share * protocol.limit_pos
        and turned + ahead * angular < rules.share * protocol.limit_rot
    )
