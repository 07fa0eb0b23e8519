"""Looking at the object in a scene: where it is, whether that is within the limits, who touches it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import quat_angle, quat_rotate
from bidexdata.record import Status
from bidexdata.simulation.scene import SimScene
from bidexdata.simulation.state import object_pose

from .protocols import Protocol

FloatArray = NDArray[np.float64]


class Reference(NamedTuple):
    """Where the object should be: what a check compares with."""

    pos: FloatArray
    """Of the protocol's reference point [m], (3,)."""
    quat: FloatArray
    """(4,)."""

    def raised(self, height: float) -> Reference:
        """The same, `height` [m] higher."""
        return Reference(self.pos + np.array([0.0, 0.0, height]), self.quat)


def reference(scene: SimScene, protocol: Protocol) -> Reference:
    """Where the protocol's reference point is now."""
    pos, quat = object_pose(scene)
    if protocol.reference == "source_origin":
        pos = pos + quat_rotate(quat, scene.source_origin)
    return Reference(pos, quat)


class Checked(NamedTuple):
    """What a check found."""

    status: Status
    """OK, SLIP, TURNED, UNSTABLE or BLOWN_UP."""
    moved: float
    """Displacement [m]; NaN when unstable."""
    turned: float
    """Rotation [rad]; likewise."""


def check(scene: SimScene, protocol: Protocol, wanted: Reference) -> Checked:
    """Compare the object with where it should be."""
    unstable = instability(scene, protocol)
    if unstable is not None:
        return Checked(unstable, np.nan, np.nan)
    now = reference(scene, protocol)
    moved = float(np.linalg.norm(now.pos - wanted.pos))
    turned = float(quat_angle(now.quat, wanted.quat[None])[0])
    if not moved < protocol.limit_pos:
        return Checked(Status.SLIP, moved, turned)
    if not turned < protocol.limit_rot:
        return Checked(Status.TURNED, moved, turned)
    return Checked(Status.OK, moved, turned)


def instability(scene: SimScene, protocol: Protocol) -> Status | None:
    """How the simulation has broken, None while all is well.

    UNSTABLE where MuJoCo warned or a number is not finite, BLOWN_UP where something flies faster
    than is possible.
    """
    data = scene.data
    finite = np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
    if np.any(data.warning.number) or not finite:
        return Status.UNSTABLE
    roots = [*scene.root_qvel, scene.object_qvel]
    speeds = np.linalg.norm(np.array([data.qvel[a : a + 3] for a in roots]), axis=1)
    return None if bool((speeds < protocol.unstable_speed).all()) else Status.BLOWN_UP


def touches_object(scene: SimScene) -> bool:
    """Whether any hand is in contact with the object in the last step."""
    owners = scene.geom_owner[scene.data.contact.geom].reshape(-1, 2)
    of_object = owners == scene.object_owner
    by_hand = (owners >= 0) & ~of_object
    return bool((of_object.any(axis=1) & by_hand.any(axis=1)).any())
