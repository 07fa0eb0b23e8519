"""The phases of a test on one grasp: close the hands, lift them, hold under a load.

Everything happens in the scene's state; poses are in the world frame. Python wakes once per
control change, check or look at the rest rule; MuJoCo steps in between.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import quat_slerp
from bidexdata.record import Status
from bidexdata.simulation.scene import SimScene
from bidexdata.simulation.state import set_targets

from .checks import Reference, check, instability
from .protocols import Protocol
from .rest import LIFT_RULES, Grip, RestRules, rests

FloatArray = NDArray[np.float64]

Watch = Callable[[str, float, SimScene], None]
"""Looks at the scene after every few steps; gets the name of the phase and the simulated time since
it began [s]. Must not change the scene. That it looks changes no step and no check."""
WATCH_STEPS = 10
"""Steps between two looks of a `Watch`, fewer where a check comes sooner."""


class EveryStep:
    """A `Watch` of this class looks after every single step."""

    def __call__(self, phase: str, lasted: float, scene: SimScene) -> None:
        """Look."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, kw_only=True)
class Execution:
    """Choices of how to run a protocol that cost time or save it, and are no part of it.

    Unless `plain`, a load ends when the rules of rest say that the object stays within the limits
    to its end, and `simulation.noslip` does its part of a step; `benchmarks/truth.py` compares the verdicts
    with plain ones.
    """

    plain: bool = False
    """Simulate every load to its end, and leave all of a step to the engine."""
    rest: RestRules = field(default_factory=RestRules)
    """When a load of test f may end before its time."""
    lift_rest: RestRules = LIFT_RULES
    """When the hold of a lift may."""
    load_margin: bool = False
    """Measure the load margin too; it costs ten (test l) to twenty times the verdict."""
    analytic: bool = False
    """Compute Q1 and the QP certificate too."""


class Motion(NamedTuple):
    """How two arms take the hands along a grasp; float64."""

    status: Status
    """OK, or why there is none."""
    path: FloatArray
    """Joint angles at W knots, arm then wrist, padded beyond a shorter chain [rad], (2, W, A)."""
    time: FloatArray
    """When both arms pass them, since home [s], (W,)."""
    knots: tuple[int, ...]
    """Knots of each phase of `record.fields.PHASES`, the first knot of all not counted."""


class Grasp(NamedTuple):
    """One grasp and where its object is; float64, world frame."""

    object_pos: FloatArray
    """(3,) [m]."""
    object_quat: FloatArray
    """(4,)."""
    hand_pos: FloatArray
    """(H, S, 3) [m]."""
    hand_quat: FloatArray
    """(H, S, 4)."""
    joints: FloatArray
    """(H, S, J) [rad]."""
    motion: Motion | None = None
    """Of arms, where the hands are on some."""


class ControlPath(NamedTuple):
    """Targets after each of T control changes."""

    pos: FloatArray
    """Of the hand roots, (T, H, 3) [m]."""
    quat: FloatArray
    """Of the hand roots, (T, H, 4)."""
    ctrl: FloatArray
    """Of all actuators of the model, (T, nu)."""


class Phase(NamedTuple):
    """How a phase ended."""

    status: Status
    drift_pos: float
    """Largest displacement from where the object should be, at a check or the early end [m]."""
    drift_rot: float
    """Largest rotation from there, likewise [rad]."""
    time: float
    """Simulated time at which the phase failed, or was accepted, since its start [s]."""


def closing_path(scene: SimScene, protocol: Protocol, grasp: Grasp) -> ControlPath:
    """Interpolate pre-grasp, grasp and squeeze, piecewise: the two segments stay separate.

    Source:
        DexGraspBench: equal control changes, position linear, quaternion slerp, controls linear;
        the first target is already one part of the way.
    """
    t = np.arange(1, protocol.segment_changes + 1) / protocol.segment_changes
    pos, quat, ctrl = [], [], []
    for a, b in ((0, 1), (1, 2)):
        step = t[:, None, None]
        pos.append((1 - step) * grasp.hand_pos[:, a] + step * grasp.hand_pos[:, b])
        quat.append(quat_slerp(grasp.hand_quat[:, a], grasp.hand_quat[:, b], t[:, None]))
        joints = (1 - step) * grasp.joints[:, a] + step * grasp.joints[:, b]
        controls = np.zeros((len(t), scene.model.nu))
        for i, own in enumerate(scene.joint_qpos):
            controls[:, scene.actuators[i]] = scene.controls(i, joints[:, i, : len(own)])
        ctrl.append(controls)
    return ControlPath(np.concatenate(pos), np.concatenate(quat), np.concatenate(ctrl))


def lift_path(protocol: Protocol, grasp: Grasp) -> FloatArray:
    """Positions of the hand roots after each change of the lift, (T, H, 3) [m]."""
    done = np.arange(1, protocol.lift.changes + 1) / protocol.lift.changes
    up = np.array([0.0, 0.0, protocol.lift.height])
    return grasp.hand_pos[:, 2] + done[:, None, None] * up


def close_hands(
    scene: SimScene,
    protocol: Protocol,
    grasp: Grasp,
    execution: Execution,
    watch: Watch | None = None,
) -> None:
    """Go from pre-grasp over grasp to squeeze from the scene's present state."""
    looks = Looks("closing", watch)
    for pos, quat, ctrl in zip(*closing_path(scene, protocol, grasp), strict=True):
        scene.data.ctrl[:] = ctrl
        set_targets(scene, pos, quat)
        if not advance(scene, protocol, protocol.segment_steps, execution, looks):
            return


def wait_for_load(
    scene: SimScene, protocol: Protocol, execution: Execution, watch: Watch | None = None
) -> None:
    """Hold the squeeze until the loads of test f begin."""
    if protocol.load_after is not None:
        steps = round(protocol.load_after / scene.model.opt.timestep)
        closed = 2 * protocol.segment_changes * protocol.segment_steps
        advance(scene, protocol, steps, execution, Looks("closing", watch, closed))


def lift_hands(
    scene: SimScene,
    protocol: Protocol,
    grasp: Grasp,
    execution: Execution,
    watch: Watch | None = None,
) -> None:
    """Raise the hands' targets from the squeeze; controls of the fingers stay."""
    looks = Looks("lift", watch)
    for pos in lift_path(protocol, grasp):
        set_targets(scene, pos, grasp.hand_quat[:, 2])
        if not advance(scene, protocol, protocol.lift.steps, execution, looks):
            return


@dataclass(slots=True)
class Looks:
    """A watch in one phase, which may be none, and how many steps of the phase are done."""

    phase: str
    watch: Watch | None
    done: int = 0

    @property
    def every(self) -> int:
        """Steps between two looks."""
        if self.watch is None:
            return sys.maxsize
        return 1 if isinstance(self.watch, EveryStep) else WATCH_STEPS


def advance(
    scene: SimScene, protocol: Protocol, steps: int, execution: Execution, looks: Looks
) -> bool:
    """Step; whether the simulation is still sane at the end."""
    end = looks.done + steps
    while looks.done < end:
        left = end - looks.done
        chunk = min(left, looks.every)
        scene.step(chunk, plain=execution.plain)
        looks.done += chunk
        if looks.watch is not None:
            looks.watch(looks.phase, looks.done * scene.model.opt.timestep, scene)
    return instability(scene, protocol) is None


def hold(
    scene: SimScene,
    protocol: Protocol,
    checks: int,
    wanted: Reference,
    execution: Execution,
    *,
    rules: RestRules,
    grip: Grip,
    watch: Watch | None = None,
) -> Phase:
    """Hold under the load that is on, from the scene's present state.

    Args:
        scene: Its state is where the phase starts.
        protocol: Interval of the checks, limits.
        checks: Number of checks.
        wanted: Where the object should be.
        execution: Whether rest may end the phase early, and who computes a step.
        rules: When rest does.
        grip: What `rest.probe` said of the grasp.
        watch: Looks on.
    """
    timestep = scene.model.opt.timestep
    stops = not execution.plain
    look = max(1, round(rules.every / timestep))
    first = round(rules.start / timestep)
    per_check = protocol.steps_per_check
    largest = [0.0, 0.0]
    looks = Looks("hold", watch)
    step = 0
    while step < checks * per_check:
        to_check = per_check - step % per_check
        chunk = min(to_check, look - step % look) if stops else to_check
        sane = advance(scene, protocol, chunk, execution, looks)
        step += chunk
        is_check = step % per_check == 0
        may_stop = stops and step % look == 0 and step >= first
        if not (is_check or may_stop or not sane):
            continue
        status, moved, turned = check(scene, protocol, wanted)
        if is_check or not sane:
            largest = [np.fmax(largest[0], moved), np.fmax(largest[1], turned)]
            if status is not Status.OK:
                return Phase(status, float(largest[0]), float(largest[1]), step * timestep)
        if may_stop:
            lasted = step * timestep
            left = checks * protocol.check_every - lasted
            times = {"lasted": lasted, "left": left}
            if rests(scene, protocol, rules, grip, moved=moved, turned=turned, **times):
                largest = [np.fmax(largest[0], moved), np.fmax(largest[1], turned)]
                return Phase(Status.OK, float(largest[0]), float(largest[1]), step * timestep)
    return Phase(Status.OK, float(largest[0]), float(largest[1]), checks * protocol.check_every)
