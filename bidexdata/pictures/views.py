"""Where to look from: the directions that show most of both hands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bidexdata.pictures.camera import framed
from bidexdata.pictures.raycast import Viewfinder
from bidexdata.pictures.scene import Part

FloatArray = NDArray[np.float64]

DEFAULT_DIRECTION = (0.55, -0.72, 0.42)
"""To the camera, when there are no hands: from the right front, above."""
SUBJECTS = ("left", "right")
_SIDE = 48  # pixels of the trial pictures: enough to compare areas
_FRAMING_POINTS = 2000  # enough to place a trial camera
_TILT = np.radians(20.0)
_CIRCLE = 16


def choose_views(parts: Sequence[Part], count: int = 1, *, device: str = "cpu") -> list[FloatArray]:
    """Choose directions to the camera, unit, (count of (3,)).

    The candidates lie around the line between the hands, so that the hands stand on opposite sides
    of the picture. The first shows most of the hand that is seen least; each further one does so
    among those at least 60 degrees away from the ones chosen before. Ties go to the candidate
    with the lowest number, so the choice is deterministic.
    """
    subjects = [i for i, p in enumerate(parts) if p.label in SUBJECTS and len(p.faces)]
    candidates = _candidates([parts[i].vertices.mean(axis=0) for i in subjects])
    if not subjects:
        return [candidates[k] for k in range(count)]
    points = subject_points(parts)
    points = points[:: 1 + len(points) // _FRAMING_POINTS]
    finder = Viewfinder(parts, device)
    score = np.array(
        [finder.visible(framed(points, d, 1.0), _SIDE, _SIDE)[subjects].min() for d in candidates],
        np.float64,
    )
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


def subject_points(parts: Sequence[Part]) -> FloatArray:
    """Points that must be inside the picture: everything but the ground, (n, 3) [m]."""
    shown = [p.vertices for p in parts if p.label != "ground" and len(p.vertices)]
    return np.concatenate(shown) if shown else np.zeros((1, 3))


def _readable(height: FloatArray) -> FloatArray:
    # People read a picture taken from a little above best, one from below worst.
    return np.interp(height, [-0.6, 0.1, 0.6, 0.95], [0.5, 1.0, 1.0, 0.8])


def _candidates(centres: Sequence[FloatArray]) -> FloatArray:
    default = np.array(DEFAULT_DIRECTION) / np.linalg.norm(DEFAULT_DIRECTION)
    if not centres:
        axis = np.array([0.0, 0.0, 1.0])
    elif len(centres) == 1:
        # One hand: all around, on three heights.
        axis = np.array([0.0, 0.0, 1.0])
    else:
        axis = centres[1] - centres[0]
        length = np.linalg.norm(axis)
        axis = axis / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    across = default - axis * (axis @ default)
    across /= np.linalg.norm(across)
    other = np.cross(axis, across)
    angle = 2 * np.pi * np.arange(_CIRCLE) / _CIRCLE
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * other
    tilts = (0.0, _TILT, -_TILT)
    rings = [np.cos(t) * ring + np.sin(t) * axis for t in tilts]
    if not centres:
        return np.concatenate([default[None], rings[1]])
    return np.concatenate(rings)
