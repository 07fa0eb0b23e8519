"""Camera: a pinhole that looks at a point, and the distance at which everything fits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.pictures.scene import Vector

FloatArray = NDArray[np.float64]

FIELD_OF_VIEW = float(np.radians(28.0))
"""Vertical opening angle [rad]: long enough a lens that hands are not distorted."""


class Camera(NamedTuple):
    """A pinhole camera in the world frame."""

    position: FloatArray
    """(3,) [m]."""
    R_world_camera: FloatArray
    """Columns: right, up, backward, (3, 3)."""
    tan_half_height: float
    """Tangent of half the vertical opening angle [-]."""


def look_at(
    target: Vector, direction: Vector, distance: float, *, fov: float = FIELD_OF_VIEW
) -> Camera:
    """Look at `target` [m] from `distance` [m] along the unit vector `direction` (to the camera).

    World z is up in the picture; a camera exactly above or below has world y up.
    """
    R = view_rotation(direction)
    position = np.asarray(target, np.float64) + distance * R[:, 2]
    return Camera(position, R, float(np.tan(0.5 * fov)))


def view_rotation(direction: Vector) -> FloatArray:
    """Rotation whose columns are the camera's right, up and backward = `direction`, (3, 3)."""
    back = np.asarray(direction, np.float64)
    back = back / np.linalg.norm(back)
    up = np.array([0.0, 0.0, 1.0]) if abs(back[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back], axis=1)


def framed(
    points: FloatArray,
    direction: Vector,
    aspect: float,
    *,
    margin: float = 0.05,
    fov: float = FIELD_OF_VIEW,
) -> Camera:
    """Look along `direction` from where all points fill the picture.

    Args:
        points: What must be inside the picture, (n, 3) [m]; at least one.
        direction: From the points to the camera, unit.
        aspect: Width over height [-].
        margin: Free border as a fraction of the picture [-].
        fov: Vertical opening angle [rad].
    """
    R = view_rotation(direction)
    local = points @ R
    tangent = np.tan(0.5 * fov) * (1 - 2 * margin) * np.array([aspect, 1.0])
    middle = 0.5 * (local.min(axis=0) + local.max(axis=0))
    # A point at depth z (towards the camera) is inside when |x| <= (distance - z) tan.
    # Perspective shifts the centre, so the middle of the slanted extents is found first.
    for axis in (0, 1):
        above = np.max(local[:, axis] / tangent[axis] + local[:, 2])
        below = np.max(-local[:, axis] / tangent[axis] + local[:, 2])
        middle[axis] = 0.5 * (above - below) * tangent[axis]
    centred = local - middle
    need = np.abs(centred[:, :2]) / tangent + centred[:, 2:]
    distance = max(float(need.max()), float(centred[:, 2].max()) + 1e-3)
    return look_at(R @ middle, direction, distance, fov=fov)
