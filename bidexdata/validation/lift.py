"""Test l: close the hands round an object on the table, lift it, and hold it in the air."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bidexdata.record import Status
from bidexdata.record.status import TestStage
from bidexdata.simulation.scene import SimScene
from bidexdata.simulation.state import set_pose

from .checks import check, reference, touches_object
from .loads import clear_load, set_load
from .margin import largest_multiple
from .protocols import Protocol
from .rest import Grip, probe
from .stages import Execution, Grasp, Phase, Watch, close_hands, hold, lift_hands
from .verdict import UNSTABLE, Verdict, closing_failure, hold_cause, start_overlap

DOWN = (0.0, 0.0, -1.0)
LEFT_BEHIND = 0.5
"""An object that has risen less than this share of the lift stayed on the table [-]."""


def lift(
    scene: SimScene,
    protocol: Protocol,
    grasp: Grasp,
    execution: Execution,
    watch: Watch | None = None,
) -> Verdict:
    """Run test l on one grasp; the scene has the table z = 0.

    The load is on from the start. The object is judged against its pose at the start, raised by
    the way of the hands, at every check of the hold; what happens before only names the cause.
    """
    refused = start_overlap(scene, protocol, grasp)
    if refused is not None:
        return refused._replace(load_margin=0.0 if execution.load_margin else np.nan)
    try:
        first = _lifted(scene, protocol, grasp, execution, 1.0, watch)
        margin = np.nan
        if execution.load_margin:
            margin = largest_multiple(
                lambda m: _lifted(scene, protocol, grasp, execution, m).ended is TestStage.NONE,
                holds_one=first.ended is TestStage.NONE,
            )
    finally:
        clear_load(scene)
    phase = first.phase
    if first.ended is TestStage.NONE:
        return Verdict(
            Status.OK, drift_pos=phase.drift_pos, drift_rot=phase.drift_rot, load_margin=margin
        )
    if first.ended is TestStage.CLOSING:
        failure = closing_failure(protocol, phase.status, np.nan, np.nan)
        return failure._replace(load_margin=margin)
    cause = hold_cause(phase, touched=first.touched, thrown=first.thrown, lifted=first.lifted)
    return Verdict(cause, first.ended, -1, phase.drift_pos, phase.drift_rot, phase.time, margin)


class _Lifted(NamedTuple):
    """How one lift went."""

    ended: TestStage
    """Where it failed; NONE when it did not."""
    phase: Phase
    touched: bool = True
    thrown: bool = False
    lifted: bool = True


def _lifted(
    scene: SimScene,
    protocol: Protocol,
    grasp: Grasp,
    execution: Execution,
    multiple: float,
    watch: Watch | None = None,
) -> _Lifted:
    at = (grasp.hand_pos[:, 0], grasp.hand_quat[:, 0], grasp.joints[:, 0])
    clear_load(scene)
    set_pose(scene, grasp.object_pos, grasp.object_quat, *at)
    start = reference(scene, protocol)
    set_load(scene, protocol, np.array(DOWN), multiple)
    close_hands(scene, protocol, grasp, execution, watch)
    status, moved, turned = check(scene, protocol, start)
    if status in UNSTABLE:
        return _Lifted(TestStage.CLOSING, Phase(status, moved, turned, protocol.closing_time))
    thrown, touched = status is not Status.OK, touches_object(scene)
    lift_hands(scene, protocol, grasp, execution, watch)
    wanted = start.raised(protocol.lift.height)
    status, moved, turned = check(scene, protocol, wanted)
    rules = protocol.lift
    up_time = rules.changes * rules.steps * protocol.scene.timestep
    risen = reference(scene, protocol).pos[2] - start.pos[2]
    lifted = bool(risen > LEFT_BEHIND * rules.height)
    if status in UNSTABLE or protocol.lift_checks == 0:
        phase = Phase(status, moved, turned, up_time)
        ended = TestStage.NONE if status is Status.OK else TestStage.LIFT
    else:
        # Other loads than the protocol's, and what is out of place already, are not probed.
        probed = multiple == 1.0 and not execution.plain and status is Status.OK
        rest = execution.lift_rest
        grip = Grip.UNKNOWN
        if probed:
            grip = probe(scene, protocol, rest, [np.array(DOWN)])
            set_load(scene, protocol, np.array(DOWN), multiple)
        checks = protocol.lift_checks
        phase = hold(
            *(scene, protocol, checks, wanted, execution), rules=rest, grip=grip, watch=watch
        )
        ended = TestStage.NONE if phase.status is Status.OK else TestStage.HOLD
    return _Lifted(ended, phase, touched, thrown, lifted)
