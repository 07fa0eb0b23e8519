"""Patches: sampled points of a surface drawn as small plates that lie on it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.pictures.scene import Colour, Part

FloatArray = NDArray[np.float64]

LIFT = 0.001
"""How far plates lie above their surface, so that it does not shine through them [m]."""
_CORNERS = 8


def surface_patch(points: NDArray[Any], normals: NDArray[Any], colour: Colour, label: str) -> Part:
    """Cover a region of a surface with plates, one per point, that meet.

    Args:
        points: Samples of the surface [m], (n, 3); repeated ones count once.
        normals: Outward unit normals there, (n, 3).
        colour: Of all plates.
        label: What the part is.
    """
    points, first = np.unique(np.asarray(points, np.float64), axis=0, return_index=True)
    normals = np.asarray(normals, np.float64)[first]
    angle = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    along, across = _tangents(normals)
    rim = (
        np.cos(angle)[None, :, None] * along[:, None]
        + np.sin(angle)[None, :, None] * across[:, None]
    )
    middle = points + LIFT * normals
    corners = middle[:, None] + plate_radius(points) * rim
    vertices = np.concatenate([middle[:, None], corners], axis=1)
    k = np.arange(_CORNERS)
    fan = np.stack([np.zeros_like(k), 1 + k, 1 + (k + 1) % _CORNERS], axis=1)
    faces = fan[None] + ((_CORNERS + 1) * np.arange(len(points)))[:, None, None]
    shading = np.broadcast_to(normals[:, None, None], (len(points), _CORNERS, 3, 3))
    return Part(
        vertices.reshape(-1, 3),
        shading.reshape(-1, 3, 3).copy(),
        faces.reshape(-1, 3).astype(np.int32),
        colour,
        label,
    )


def plate_radius(points: FloatArray) -> float:
    """Radius at which plates at irregular points cover a surface [m]: their usual spacing."""
    if len(points) < 2:
        return 0.005
    offset = points[:, None] - points[None]
    squared = np.sum(offset**2, axis=-1)
    np.fill_diagonal(squared, np.inf)
    return 0.85 * float(np.median(np.sqrt(squared.min(axis=1))))


def _tangents(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors across each normal and each other, (n, 3) each."""
    # The axis that leans least along the normal is never parallel to it.
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    along = np.cross(normals, axis)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return along, np.asarray(np.cross(normals, along), np.float64)
