"""Test l: close the hands round an object on the table, lift it, and hold it in the air.

How the hands are moved is a `Moves`: here they float on their welds, in `arm_lift` arms carry them.
What is judged, and when, is the same for both.
"""

from __future__ import annotations

from collections.abc import Callable
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


class Moves(NamedTuple):
    """What moves the hands; each part goes on from the scene's present state."""

    place: Callable[[], None]
    """Put the object and the hands where the test begins."""
    come: Callable[[Watch | None], float]
    """Bring the hands to the pre-grasp; gives the simulated time that this took [s]."""
    close: Callable[[Watch | None], None]
    """Close them."""
    rise: Callable[[Watch | None], float]
    """Lift them and wait; gives the simulated time [s]."""


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
    return lift_verdict(
        scene, protocol, _welds(scene, protocol, grasp, execution), execution, watch
    )


def lift_verdict(
    scene: SimScene,
    protocol: Protocol,
    moves: Moves,
    execution: Execution,
    watch: Watch | None = None,
) -> Verdict:
    """Lift the object once, and where it is asked for under other loads too.

    Args:
        scene: With hands, object and table.
        protocol: The settings.
        moves: Of the hands.
        execution: Early ends, and whether the load margin is measured.
        watch: Looks on at the first lift.
    """
    try:
        first = _lifted(scene, protocol, moves, execution, 1.0, watch)
        margin = np.nan
        if execution.load_margin:
            margin = largest_multiple(
                lambda m: _lifted(scene, protocol, moves, execution, m).ended is TestStage.NONE,
                holds_one=first.ended is TestStage.NONE,
            )
    finally:
        clear_load(scene)
    phase = first.phase
    if first.ended is TestStage.NONE:
        return Verdict(
            Status.OK, drift_pos=phase.drift_pos, drift_rot=phase.drift_rot, load_margin=margin
        )
    if first.ended is TestStage.APPROACH:
        cause = phase.status if phase.status in UNSTABLE else Status.THROWN
        return Verdict(cause, first.ended, -1, phase.drift_pos, phase.drift_rot, phase.time, margin)
    if first.ended is TestStage.CLOSING:
        failure = closing_failure(protocol, phase.status, np.nan, np.nan)
        return failure._replace(load_margin=margin)
    cause = hold_cause(phase, touched=first.touched, thrown=first.thrown, lifted=first.lifted)
    return Verdict(cause, first.ended, -1, phase.drift_pos, phase.drift_rot, phase.time, margin)


def _welds(scene: SimScene, protocol: Protocol, grasp: Grasp, execution: Execution) -> Moves:
    """Hands that begin at the pre-grasp and follow the bodies that they are welded to."""

    def place() -> None:
        at = (grasp.hand_pos[:, 0], grasp.hand_quat[:, 0], grasp.joints[:, 0])
        set_pose(scene, grasp.object_pos, grasp.object_quat, *at)

    def rise(watch: Watch | None) -> float:
        lift_hands(scene, protocol, grasp, execution, watch)
        return protocol.lift.changes * protocol.lift.steps * protocol.scene.timestep

    return Moves(
        place=place,
        come=lambda _: 0.0,
        close=lambda watch: close_hands(scene, protocol, grasp, execution, watch),
        rise=rise,
    )


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
    moves: Moves,
    execution: Execution,
    multiple: float,
    watch: Watch | None = None,
) -> _Lifted:
    clear_load(scene)
    moves.place()
    start = reference(scene, protocol)
    set_load(scene, protocol, np.array(DOWN), multiple)
    came = moves.come(watch)
    if came > 0:
        seen = check(scene, protocol, start)
        if seen.status is not Status.OK:
            return _Lifted(TestStage.APPROACH, Phase(*seen, came))
    moves.close(watch)
    closed = check(scene, protocol, start)
    if closed.status in UNSTABLE:
        return _Lifted(TestStage.CLOSING, Phase(*closed, protocol.closing_time))
    touched = touches_object(scene)
    up_time = moves.rise(watch)
    wanted = start.raised(protocol.lift.height)
    up = check(scene, protocol, wanted)
    risen = reference(scene, protocol).pos[2] - start.pos[2]
    if up.status in UNSTABLE or protocol.lift_checks == 0:
        phase = Phase(*up, up_time)
        ended = TestStage.NONE if up.status is Status.OK else TestStage.LIFT
    else:
        grip = Grip.UNKNOWN
        # Other loads than the protocol's, and what is out of place already, are not probed.
        if multiple == 1.0 and not execution.plain and up.status is Status.OK:
            grip = probe(scene, protocol, execution.lift_rest, [np.array(DOWN)])
            set_load(scene, protocol, np.array(DOWN), multiple)
        phase = hold(
            *(scene, protocol, protocol.lift_checks, wanted, execution),
            rules=execution.lift_rest,
            grip=grip,
            watch=watch,
        )
        ended = TestStage.NONE if phase.status is Status.OK else TestStage.HOLD
    return _Lifted(
        ended,
        phase,
        touched=touched,
        thrown=closed.status is not Status.OK,
        lifted=bool(risen > LEFT_BEHIND * protocol.lift.height),
    )
