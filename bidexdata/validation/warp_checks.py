"""The checks of `stages` on many worlds at once, and stepping that survives a world that blows up."""

from __future__ import annotations

from typing import NamedTuple

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


class ObjectPoses(NamedTuple):
    """Where N objects should be."""

    pos: FloatArray
    """(N, 3) [m]."""
    quat: FloatArray
    """(N, 4)."""


class WorldChecks(NamedTuple):
    """What `checks.check` finds, of N worlds."""

    status: Statuses
    moved: FloatArray
    """Displacement [m], (N,); no number where the world is unstable."""
    turned: FloatArray
    """Rotation [rad], (N,); likewise."""

    def unless(self, broken: Statuses) -> WorldChecks:
        """The same, but for worlds that are known to have broken, (N,): not OK."""
        bad = broken != Status.OK
        return WorldChecks(
            np.where(bad, broken, self.status),
            np.where(bad, np.nan, self.moved),
            np.where(bad, np.nan, self.turned),
        )


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
    wanted: ObjectPoses,
) -> WorldChecks:
    """Compare objects with where they should be.

    Args:
        scene: Where everything lies in a state.
        protocol: The limits.
        qpos: (N, nq).
        qvel: (N, nv).
        wanted: Where the objects should be.
    """
    at = scene.object_qpos
    with np.errstate(invalid="ignore", over="ignore"):
        moved = np.linalg.norm(qpos[:, at : at + 3] - wanted.pos, axis=1)
        turned = quat_angle(wanted.quat, qpos[:, at + 3 : at + 7])
    status = np.full(len(qpos), Status.OK, np.int8)
    status[~(turned < protocol.limit_rot)] = Status.TURNED
    status[~(moved < protocol.limit_pos)] = Status.SLIP
    return WorldChecks(status, moved, turned).unless(instability(scene, protocol, qpos, qvel))


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
    now: WorldChecks,
    left: FloatArray,
) -> Flags:
    """Whether objects are so slow that they stay within the limits to the end, (N,).

    Friction cannot be halved for some worlds only, so there is no probe as in `rest.probe`.

    Args:
        scene: Where everything lies in a state.
        protocol: The limits.
        qvel: (N, nv).
        now: Where the objects are.
        left: Time to the end of the load [s], (N,).
    """
    at = scene.object_qvel
    linear = np.linalg.norm(qvel[:, at : at + 3], axis=1)
    angular = np.linalg.norm(qvel[:, at + 3 : at + 6], axis=1)
    return (
        (linear < REST.speed)
        & (angular < REST.turn)
        & (now.moved + REST.times * left * linear < REST.share * protocol.limit_pos)
        & (now.turned + REST.times * left * angular < REST.share * protocol.limit_rot)
    )
