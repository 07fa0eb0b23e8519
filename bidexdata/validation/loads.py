"""The load on a scene: on, or off."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bidexdata.simulation.scene import SimScene

from .protocols import Protocol


def set_load(
    scene: SimScene, protocol: Protocol, direction: NDArray[np.float64], multiple: float
) -> None:
    """Apply the protocol's load along a unit vector of the world, `multiple` times on the object.

    Whatever the multiple, everything but the object feels gravity once: a margin is one of the
    object's load, not of the hands' own weight.
    """
    gravity = protocol.gravity * np.asarray(direction)
    force = scene.object_mass * gravity * multiple
    if protocol.load == "gravity":
        scene.model.opt.gravity[:] = gravity
        force = scene.object_mass * gravity * (multiple - 1.0)
    scene.data.xfrc_applied[scene.object_body, :3] = force


def clear_load(scene: SimScene) -> None:
    """Take every load away."""
    scene.model.opt.gravity[:] = 0.0
    scene.data.xfrc_applied[scene.object_body] = 0.0
