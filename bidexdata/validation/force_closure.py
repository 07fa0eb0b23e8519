"""Test f: close the hands without gravity, then gravity along each axis of the object."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bidexdata.frames import matrix_from_quat
from bidexdata.record import Status
from bidexdata.simulation.distances import measure_distances
from bidexdata.simulation.scene import SimScene
from bidexdata.simulation.state import set_pose

from .protocols import Protocol
from .stages import Execution, Grasp, Phase, check, closing_path, follow, hold, touches_object

DIRECTIONS = ("+x", "-x", "+y", "-y", "+z", "-z")
"""Loads in the order of the record's `direction`, along the object's axes."""


class Verdict(NamedTuple):
    """What became of one grasp in one test."""

    status: Status
    direction: int
    """First failing load; -1 when none failed."""
    drift_pos: float
    """Largest displacement at a check [m]; NaN when nothing was simulated."""
    drift_rot: float
    """Largest rotation at a check [rad]."""
    time: float
    """Simulated time of the failure since the start of its phase [s]; NaN on success."""


def force_closure(
    scene: SimScene, protocol: Protocol, grasp: Grasp, execution: Execution
) -> Verdict:
    """Run test f on one grasp.

    Each load starts from a copy of the closed state, so closing is simulated once. The first
    failing load decides, the rest are not run: the verdict and its direction are the same.
    """
    import mujoco

    if overlaps_at_start(scene, protocol, grasp):
        return Verdict(Status.START_PENETRATION, -1, np.nan, np.nan, 0.0)
    model, data = scene.model, scene.data
    start = (grasp.object_pos, grasp.object_quat)
    at = (grasp.hand_pos[:, 0], grasp.hand_quat[:, 0], grasp.joints[:, 0])
    set_pose(scene, *start, *at)
    model.opt.gravity[:] = 0.0
    follow(scene, protocol, closing_path(scene, protocol, grasp))
    status, moved, turned = check(scene, protocol, start)
    if status is not Status.OK:
        status = Status.UNSTABLE if status is Status.UNSTABLE else Status.THROWN
        return Verdict(status, -1, moved, turned, protocol.closing_time)
    touched = touches_object(scene)

    closed = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(model, data, closed, mujoco.mjtState.mjSTATE_INTEGRATION)
    axes = matrix_from_quat(grasp.object_quat).T
    worst = Phase(Status.OK, moved, turned, np.nan)
    for direction in range(len(DIRECTIONS)):
        mujoco.mj_setState(model, data, closed, mujoco.mjtState.mjSTATE_INTEGRATION)
        sign = 1.0 if direction % 2 == 0 else -1.0
        load = sign * protocol.gravity * axes[direction // 2]
        phase = hold(scene, protocol, load, start, execution)
        worst = Phase(
            phase.status,
            float(np.fmax(worst.drift_pos, phase.drift_pos)),
            float(np.fmax(worst.drift_rot, phase.drift_rot)),
            phase.time,
        )
        if phase.status is not Status.OK:
            lost = phase.status is not Status.UNSTABLE and not touched
            return Verdict(
                Status.NO_CONTACT if lost else phase.status,
                direction,
                worst.drift_pos,
                worst.drift_rot,
                phase.time,
            )
    return Verdict(Status.OK, -1, worst.drift_pos, worst.drift_rot, np.nan)


def overlaps_at_start(scene: SimScene, protocol: Protocol, grasp: Grasp) -> bool:
    """Whether the pre-grasp overlaps deeper than the protocol allows, with object or hands."""
    at = (grasp.hand_pos[:, 0], grasp.hand_quat[:, 0], grasp.joints[:, 0])
    d = measure_distances(scene, grasp.object_pos, grasp.object_quat, *at, reach=0.0)
    return min(d.hand_object, d.self_collision, d.inter_hand) < -protocol.start_depth
