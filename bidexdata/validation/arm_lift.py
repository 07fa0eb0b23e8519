"""Test a: test l with hands on two arms, which come from home and lift along their own paths.

The arms' servos follow the stored motion in joint space. Its approach takes the stored times; closing,
squeezing and lifting take those of test l, so that what differs is who carries the hands.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.arms.arm_scene import ArmScene, ServoSettings, command_arms, set_arms
from bidexdata.arms.contacts import ARMS, ITSELF, OBJECT, TABLE, least_distances, pair_kinds
from bidexdata.record import Status
from bidexdata.record.fields import PHASES
from bidexdata.record.status import TestStage
from bidexdata.simulation.scene import SimScene

from .arm_rules import ArmRules
from .lift import Moves, lift_verdict
from .protocols import Protocol
from .stages import (
    WATCH_STEPS,
    EveryStep,
    Execution,
    Grasp,
    Looks,
    Motion,
    Watch,
    advance,
    closing_path,
)
from .verdict import Verdict, start_overlap

FloatArray = NDArray[np.float64]

OVERLAPS = {
    TABLE: Status.COLLISION_TABLE,
    OBJECT: Status.COLLISION_OBJECT,
    ARMS: Status.COLLISION_ARMS,
    ITSELF: Status.COLLISION_SELF,
}
"""What an overlap of arms is called, by its place in `ArmDepths`."""
_STAGE_OF = {
    "approach": TestStage.APPROACH,
    "closing": TestStage.CLOSING,
    "lift": TestStage.LIFT,
    "hold": TestStage.HOLD,
}


class ArmTest(NamedTuple):
    """The scenes of test a."""

    floating: SimScene
    """Hands without arms, object and table: for the start check, as in test l."""
    arms: ArmScene


def servo_settings(rules: ArmRules) -> ServoSettings:
    """How the rules of a protocol drive the arms of a scene."""
    return ServoSettings(
        gravity_compensation=rules.gravity_compensation,
        arm_gain=rules.arm_gain,
        wrist_gain=rules.wrist_gain,
        servo_bound=rules.servo_bound,
    )


def lift_with_arms(
    scenes: ArmTest,
    protocol: Protocol,
    grasp: Grasp,
    execution: Execution,
    watch: Watch | None = None,
) -> Verdict:
    """Run test a on one grasp.

    A grasp without a motion fails with the status of its arms and is not simulated. One that test l
    would pass fails with a status of arms too where these overlap table, object, each other or
    themselves deeper than the protocol allows at any step; its `failed_stage` then says when, and
    its load margin is 0.

    Args:
        scenes: Of the grasp's object and size.
        protocol: The settings, `arm` among them.
        grasp: With its motion.
        execution: Early ends and who computes a step.
        watch: Looks on; its scene is the one with arms.
    """
    motion = grasp.motion
    assert motion is not None
    assert protocol.arm is not None
    no_margin = 0.0 if execution.load_margin else np.nan
    if motion.status is not Status.OK:
        return Verdict(motion.status, load_margin=no_margin)
    refused = start_overlap(scenes.floating, protocol, grasp)
    if refused is not None:
        return refused._replace(load_margin=no_margin)
    overlaps = _Overlaps(scenes.arms, protocol.arm.depth, watch)
    moves = _arms(scenes.arms, protocol, grasp, motion, execution)
    verdict = lift_verdict(scenes.arms.scene, protocol, moves, execution, overlaps)
    if verdict.status is Status.OK and overlaps.first is not None:
        cause, stage, time = overlaps.first
        return verdict._replace(status=cause, failed_stage=stage, time=time, load_margin=no_margin)
    return verdict


def phase_targets(motion: Motion, phase: str, count: int) -> tuple[FloatArray, ...]:
    """Targets of the arms' joints after each of a number of equal parts of a phase.

    Args:
        motion: The motion.
        phase: One of `record.fields.PHASES`; its knots are evenly spaced.
        count: Parts.

    Returns:
        `count` arrays [rad], (2, A).
    """
    first = sum(motion.knots[: PHASES.index(phase)])
    knots = motion.knots[PHASES.index(phase)]
    return tuple(_between(motion.path, first + knots * np.arange(1, count + 1) / count))


def approach_targets(motion: Motion, every: float) -> tuple[FloatArray, ...]:
    """Targets on the way from home to the pre-grasp, one every `every` seconds [rad], (2, A) each."""
    last = sum(motion.knots[: PHASES.index("close")])
    time = motion.time[: last + 1] - motion.time[0]
    count = max(1, int(np.ceil(time[-1] / every - 1e-9)))
    when = np.minimum(every * np.arange(1, count + 1), time[-1])
    return tuple(_between(motion.path, np.interp(when, time, np.arange(last + 1))))


def _between(path: FloatArray, at: FloatArray) -> FloatArray:
    """Joint angles at broken numbers of knots, (T, 2, A)."""
    before = np.clip(np.floor(at).astype(int), 0, path.shape[1] - 2)
    share = (at - before)[:, None, None]
    knots = np.swapaxes(path, 0, 1)
    return (1 - share) * knots[before] + share * knots[before + 1]


def _arms(
    arms: ArmScene, protocol: Protocol, grasp: Grasp, motion: Motion, execution: Execution
) -> Moves:
    """Hands that arms carry along a motion."""
    scene, rules, lifts = arms.scene, protocol.arm, protocol.lift
    assert rules is not None
    timestep = protocol.scene.timestep

    def follow(targets: tuple[FloatArray, ...], steps: int, looks: Looks) -> bool:
        for q in targets:
            command_arms(arms, q)
            if not advance(scene, protocol, steps, execution, looks):
                return False
        return True

    def place() -> None:
        home = motion.path[:, 0]
        set_arms(arms, grasp.object_pos, grasp.object_quat, home, grasp.joints[:, 0])

    def come(watch: Watch | None) -> float:
        looks = Looks("approach", watch)
        targets = approach_targets(motion, lifts.steps * timestep)
        if follow(targets, lifts.steps, looks):
            advance(scene, protocol, round(rules.settle / timestep), execution, looks)
        return looks.done * timestep

    def close(watch: Watch | None) -> None:
        looks, changes = Looks("closing", watch), protocol.segment_changes
        arm = [q for phase in ("close", "squeeze") for q in phase_targets(motion, phase, changes)]
        for ctrl, q in zip(closing_path(scene, protocol, grasp).ctrl, arm, strict=True):
            scene.data.ctrl[:] = ctrl
            if not follow((q,), protocol.segment_steps, looks):
                return

    def rise(watch: Watch | None) -> float:
        looks = Looks("lift", watch)
        if follow(phase_targets(motion, "lift", lifts.changes), lifts.steps, looks):
            advance(scene, protocol, round(rules.wait / timestep), execution, looks)
        return looks.done * timestep

    return Moves(place=place, come=come, close=close, rise=rise)


class _Overlaps(EveryStep):
    """Notes the first step at which arms overlap something too deep, and lets another watch look."""

    def __init__(self, arms: ArmScene, depth: float, watch: Watch | None) -> None:
        self.first: tuple[Status, TestStage, float] | None = None
        """What, in which part of the test, and when since that part began [s]."""
        self._arms, self._depth, self._watch = arms, depth, watch
        self._kinds = pair_kinds(arms, hands_touch=True).of_arms_alone()
        self._phase, self._steps = "", 0

    def __call__(self, phase: str, lasted: float, scene: SimScene) -> None:
        if self.first is None:
            least = least_distances(self._arms, self._kinds)
            if least.min() < -self._depth:
                self.first = (OVERLAPS[int(least.argmin())], _STAGE_OF[phase], lasted)
        if self._watch is None:
            return
        self._steps = self._steps + 1 if phase == self._phase else 1
        self._phase = phase
        if self._steps % WATCH_STEPS == 0:
            self._watch(phase, lasted, scene)
