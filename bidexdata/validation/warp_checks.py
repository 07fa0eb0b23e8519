"""The checks of `stages` on many worlds at once, and stepping that survives a world that blows up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import quat_angle
from bidexdata.record import Status
from bidexdata.simulation.scene import SimScene

from .protocols import Protocol
from .rest import Slow
from .warp_worlds import ContactOverflow, FloatArray, Worlds

Flags = NDArray[np.bool_]
Statuses = NDArray[np.int8]

REST = Slow(speed=0.003, turn=0.02, times=2.0, share=0.8)
"""A load may end for objects that are so slow."""


def advance(scene: SimScene, protocol: Protocol, worlds: Worlds, steps: int) -> Statuses:
    """Step all worlds.

    Where one blows up and fills the buffers of contacts, which all share, it is parked and the
    others take these steps again.

    Returns:
        What became of each world: OK, or UNSTABLE or BLOWN_UP where it was parked, (count,).

    Raises:
        ContactOverflow: Buffers are too small for worlds in which nothing blows up.
    """
    every = np.arange(worlds.count)
    before = worlds.read(every)
    blown = np.full(worlds.count, Status.OK, np.int8)
    while True:
        try:
            worlds.step(steps)
            return blown
        except ContactOverflow:
            now = instability(scene, protocol, *worlds.motion(every))
            new = (now != Status.OK) & (blown == Status.OK)
            if not new.any():
                raise
            blown[new] = now[new]
            worlds.write(every, before)
            worlds.park(np.flatnonzero(blown))


def check_worlds(
    scene: SimScene,
    protocol: Protocol,
    qpos: FloatArray,
    qvel: FloatArray,
    pos: FloatArray,
    quat: FloatArray,
) -> tuple[Statuses, FloatArray, FloatArray]:
    """Compare objects with where they should be.

    Args:
        scene: Where everything lies in a state.
        protocol: The limits.
        qpos: (N, nq).
        qvel: (N, nv).
        pos: Where the objects should be [m], (N, 3).
        quat: (N, 4).

    Returns:
        Status, displacement [m] and angle [rad], each (N,); not numbers where it is unstable.
    """
    at = scene.object_qpos
    with np.errstate(invalid="ignore", over="ignore"):
        moved = np.linalg.norm(qpos[:, at : at + 3] - pos, axis=1)
        turned = quat_angle(quat, qpos[:, at + 3 : at + 7])
    status = np.full(len(qpos), Status.OK, np.int8)
    status[~(turned < protocol.limit_rot)] = Status.TURNED
    status[~(moved < protocol.limit_pos)] = Status.SLIP
    found = instability(scene, protocol, qpos, qvel)
    broken = found != Status.OK
    status[broken], moved[broken], turned[broken] = found[broken], np.nan, np.nan
    return status, moved, turned


def instability(
    scene: SimScene, protocol: Protocol, qpos: FloatArray, qvel: FloatArray
) -> Statuses:
    """Tell what blew up: UNSTABLE where a number is not finite, else BLOWN_UP or OK, (N,)."""
    finite = np.isfinite(qpos).all(axis=1) & np.isfinite(qvel).all(axis=1)
    roots = np.array([*scene.root_qvel, scene.object_qvel])
    with np.errstate(invalid="ignore", over="ignore"):
        speeds = np.linalg.norm(qvel[:, roots[:, None] + np.arange(3)], axis=2)
    slow = (speeds < protocol.unstable_speed).all(axis=1)
    found = np.where(slow, Status.OK, Status.BLOWN_UP)
    return np.where(finite, found, Status.UNSTABLE).astype(np.int8)


def rests(
    scene: SimScene,
    protocol: Protocol,
    qvel: FloatArray,
    moved: FloatArray,
    turned: FloatArray,
    left: FloatArray,
) -> Flags:
    """Whether objects are so slow that they stay within the limits to the end, (N,).

    Friction cannot be halved for some worlds only, so there is no probe as in `rest.probe`.

    Args:
        scene: Where everything lies in a state.
        protocol: The limits.
        qvel: (N, nv).
        moved: Present displacement [m], (N,).
        turned: Present rotation [rad], (N,).
        left: Time to the end of the load [s], (N,).
    """
    at = scene.object_qvel
    linear = np.linalg.norm(qvel[:, at : at + 3], axis=1)
    angular = np.linalg.norm(qvel[:, at + 3 : at + 6], axis=1)
    return (
        (linear < REST.speed)
        & (angular < REST.turn)
        & (moved + REST.times * left * linear < REST.share * protocol.limit_pos)
        & (turned + REST.times * left * angular < REST.share * protocol.limit_rot)
    )
