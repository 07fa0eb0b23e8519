"""Where to look from: the directions that show most of both hands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bidexdata.pictures.camera import FIELD_OF_VIEW, framed
from bidexdata.pictures.raycast import RayScene
from bidexdata.pictures.scene import GROUND, Part

FloatArray = NDArray[np.float64]

DEFAULT_DIRECTION = (0.55, -0.72, 0.42)
"""To the camera, when there are no hands: from the right front, above."""
SUBJECTS = ("left", "right")
OBJECT = "object"
_SIDE = 48  # pixels of the trial pictures: enough to compare areas
_FRAMING_POINTS = 2000  # enough to place a trial camera
_TILT = np.radians(20.0)
_CIRCLE = 16


def choose_views(
    parts: Sequence[Part], scene: RayScene, count: int = 1, *, fov: float = FIELD_OF_VIEW
) -> list[FloatArray]:
    """Choose directions to the camera, unit, (count of (3,)); `scene` begins with the same parts.

    The candidates lie around the line between the hands, so that the hands stand on opposite sides
    of the picture; a single hand stands opposite to the object, which then counts as the other.
    The first shows most of the hand that is seen least; each further one does so
    among those at least 60 degrees away from the ones chosen before. Ties go to the candidate
    with the lowest number, so the choice is deterministic. The trial cameras have the opening angle
    `fov` [rad]: a small one stands far off, behind what else may be in the way.
    """
    subjects = _subjects(parts)
    candidates = _candidates([_middle([parts[i] for i in group]) for group in subjects])
    if not subjects:
        return [candidates[k] for k in range(count)]
    points = subject_points(parts)
    points = points[:: 1 + len(points) // _FRAMING_POINTS]
    areas = [scene.visible(framed(points, d, 1.0, fov=fov), _SIDE, _SIDE) for d in candidates]
    score = np.array([min(a[group].sum() for group in subjects) for a in areas], np.float64)
    score *= _readable(candidates[:, 2])
    chosen: list[FloatArray] = []
    allowed = np.ones(len(candidates), bool)
    for _ in range(count):
        best = int(np.argmax(np.where(allowed, score, -1.0)))
        chosen.append(candidates[best])
        allowed &= candidates @ candidates[best] < np.cos(np.radians(60.0))
        if not allowed.any():
            allowed[:] = True
    return chosen


def side_direction(hand_centres: Sequence[FloatArray]) -> FloatArray:
    """Direction to a camera that has the hands on its two sides, nearest to the default, (3,).

    Args:
        hand_centres: Where the hands are, each (3,) [m]; any number. For a single hand give the
            object's centre too.
    """
    return _candidates(hand_centres)[0]


def subject_points(parts: Sequence[Part]) -> FloatArray:
    """Points that must be inside the picture: everything but the ground, (n, 3) [m]."""
    shown = [p.vertices for p in parts if p.label != GROUND and len(p.vertices)]
    return np.concatenate(shown) if shown else np.zeros((1, 3))


def _subjects(parts: Sequence[Part]) -> list[list[int]]:
    """Numbers of the parts of each thing that must be seen: the hands, or one hand and the object."""
    solid = [i for i, p in enumerate(parts) if len(p.faces)]
    hands = [[i] for i in solid if parts[i].label in SUBJECTS]
    whole = [i for i in solid if parts[i].label == OBJECT]
    return [whole, *hands] if len(hands) == 1 and whole else hands


def _middle(parts: Sequence[Part]) -> FloatArray:
    return np.concatenate([p.vertices for p in parts]).mean(axis=0)


def _readable(height: FloatArray) -> FloatArray:
    # People read a picture taken from a little above best, one from below worst.
    return np.interp(height, [-0.6, 0.1, 0.6, 0.95], [0.5, 1.0, 1.0, 0.8])


def _candidates(centres: Sequence[FloatArray]) -> FloatArray:
    default = np.array(DEFAULT_DIRECTION) / np.linalg.norm(DEFAULT_DIRECTION)
    if not centres:
        return np.concatenate([default[None], _rings(np.array([0.0, 0.0, 1.0]), default)])
    axis = centres[-1] - centres[0]
    length = np.linalg.norm(axis)
    # One hand, or two in one place: all around the vertical.
    return _rings(axis / length if length > 1e-9 else np.array([0.0, 0.0, 1.0]), default)


def _rings(axis: FloatArray, nearest: FloatArray) -> FloatArray:
    # Directions across the axis and tilted to either end; the first is nearest to `nearest`.
    across = nearest - axis * (axis @ nearest)
    if np.linalg.norm(across) < 1e-6:
        across = np.roll(axis, 1) - axis * (axis @ np.roll(axis, 1))
    across /= np.linalg.norm(across)
    other = np.cross(axis, across)
    angle = 2 * np.pi * np.arange(_CIRCLE) / _CIRCLE
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * other
    return np.concatenate([np.cos(t) * ring + np.sin(t) * axis for t in (0.0, _TILT, -_TILT)])
