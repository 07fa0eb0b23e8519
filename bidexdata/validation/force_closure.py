"""Test f: close the hands without gravity, then the load along each axis of the object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import matrix_from_quat
from bidexdata.record import Status
from bidexdata.record.fields import DIRECTIONS
from bidexdata.record.status import TestStage
from bidexdata.simulation.scene import SimScene
from bidexdata.simulation.state import restore_state, saved_state, set_pose

from .checks import Reference, check, reference, touches_object
from .loads import clear_load, set_load
from .margin import largest_multiple
from .protocols import Protocol
from .rest import Grip, probe
from .stages import Execution, Grasp, Phase, Watch, close_hands, hold, wait_for_load
from .verdict import UNSTABLE, Verdict, closing_failure, hold_cause, start_overlap


def force_closure(
    scene: SimScene,
    protocol: Protocol,
    grasp: Grasp,
    execution: Execution,
    watch: Watch | None = None,
) -> Verdict:
    """Run test f on one grasp.

    Each load starts from a copy of the closed state, so closing is simulated once. The first
    failing load decides, the rest are not run: the verdict and its direction are the same.
    """
    no_margin = 0.0 if execution.load_margin else np.nan
    refused = start_overlap(scene, protocol, grasp)
    if refused is not None:
        return refused._replace(load_margin=no_margin)
    at = (grasp.hand_pos[:, 0], grasp.hand_quat[:, 0], grasp.joints[:, 0])
    clear_load(scene)
    set_pose(scene, grasp.object_pos, grasp.object_quat, *at)
    wanted = reference(scene, protocol)
    close_hands(scene, protocol, grasp, execution, watch)
    wait_for_load(scene, protocol, execution, watch)
    status, moved, turned = check(scene, protocol, wanted)
    if status in UNSTABLE or (protocol.check_closing and status is not Status.OK):
        failure = closing_failure(protocol, status, moved, turned)
        return failure._replace(load_margin=no_margin)
    touched = touches_object(scene)
    closed = saved_state(scene)
    loads = [_load(grasp, name) for name in protocol.directions]
    grip = Grip.UNKNOWN if execution.plain else probe(scene, protocol, execution.rest, loads)

    def loaded(multiple: float, watch: Watch | None = None) -> tuple[int, Phase]:
        # What the probe said holds for the protocol's own load; others end by a rule of their own.
        how = grip if multiple == 1.0 else Grip.UNKNOWN
        return _all_directions(
            scene, protocol, grasp, closed, wanted, execution, how, multiple, watch
        )

    direction, phase = loaded(1.0, watch)
    drift_pos = float(np.fmax(moved, phase.drift_pos))
    drift_rot = float(np.fmax(turned, phase.drift_rot))
    margin = np.nan
    if execution.load_margin:
        margin = largest_multiple(lambda m: loaded(m)[0] < 0, holds_one=phase.status is Status.OK)
    if direction < 0:
        return Verdict(Status.OK, drift_pos=drift_pos, drift_rot=drift_rot, load_margin=margin)
    cause = hold_cause(phase, touched=touched, thrown=status is not Status.OK)
    return Verdict(cause, TestStage.HOLD, direction, drift_pos, drift_rot, phase.time, margin)


def _all_directions(
    scene: SimScene,
    protocol: Protocol,
    grasp: Grasp,
    closed: NDArray[np.float64],
    wanted: Reference,
    execution: Execution,
    grip: Grip,
    multiple: float,
    watch: Watch | None,
) -> tuple[int, Phase]:
    """Hold under each load in turn; the first failing direction, -1 when none fails."""
    worst = Phase(Status.OK, 0.0, 0.0, np.nan)
    for name in protocol.directions:
        direction = DIRECTIONS.index(name)
        restore_state(scene, closed)
        set_load(scene, protocol, _load(grasp, name), multiple)
        look = None if watch is None else _named(watch, f"load {name}")
        phase = hold(
            *(scene, protocol, protocol.checks, wanted, execution),
            rules=execution.rest,
            grip=grip,
            watch=look,
        )
        clear_load(scene)
        worst = Phase(
            phase.status,
            float(np.fmax(worst.drift_pos, phase.drift_pos)),
            float(np.fmax(worst.drift_rot, phase.drift_rot)),
            phase.time,
        )
        if phase.status is not Status.OK:
            return direction, worst
    return -1, worst


def _load(grasp: Grasp, name: str) -> NDArray[np.float64]:
    """Unit vector of a load in the world, (3,)."""
    axis = matrix_from_quat(grasp.object_quat).T[DIRECTIONS.index(name) // 2]
    return axis if name[0] == "+" else -axis


def _named(watch: Watch, phase: str) -> Watch:
    return lambda _, lasted, scene: watch(phase, lasted, scene)
