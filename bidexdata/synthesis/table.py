"""What a table forbids: points under which no fingertip fits, regions from below, sunken starts.

The table is the plane z = 0 of the world. Everything here is in the object frame, where the plane
is (normal, offset): normal . x + offset is the height over the table [m].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bidexdata.frames import matrix_from_quat
from bidexdata.record.scene import Scene


class Raised(NamedTuple):
    """How starts get clear of the table."""

    shift: Float[np.ndarray, "n 3"]
    """To add to the hand's position [m]; zero where it was clear."""
    ok: Bool[np.ndarray, " n"]
    """Clear within the farthest way allowed; the others keep their place."""


def table_plane(scene: Scene) -> Float[np.ndarray, " 4"]:
    """The table of a scene as seen from its object; zeros where there is none."""
    if scene.setting == "floating":
        return np.zeros(4)
    up = matrix_from_quat(np.array(scene.object_quat_wxyz))[2]
    return np.append(up, scene.object_pos[2])


def touchable_points(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    plane: Float[np.ndarray, " 4"],
    radius: float,
) -> Bool[np.ndarray, " n"]:
    """Tell where a ball that touches the surface from outside is above the table.

    Args:
        points: Of the surface [m].
        normals: Outward unit normals there.
        plane: The table.
        radius: Of the ball: a fingertip with the distance that it keeps from the table [m].
    """
    return (points + radius * normals) @ plane[:3] + plane[3] >= radius


def reachable_regions(
    anchors: Float[np.ndarray, "n 3"],
    hull_normals: Float[np.ndarray, "n 3"],
    plane: Float[np.ndarray, " 4"],
    reach: float,
) -> Bool[np.ndarray, " n"]:
    """Tell which regions a hand can come to without passing through the table.

    A hand stands off along the hull's normal, so a palm that far out must be above the table.

    Args:
        anchors: Middles of the regions [m].
        hull_normals: Outward unit normals of the hull nearest to them.
        plane: The table.
        reach: Distance of the palm's back from the object [m].
    """
    return (anchors + reach * hull_normals) @ plane[:3] + plane[3] >= 0.0


def raise_hands(
    spheres: Float[np.ndarray, "n K 3"],
    radius: Float[np.ndarray, " K"],
    normals: Float[np.ndarray, "n 3"],
    plane: Float[np.ndarray, " 4"],
    clearance: float,
    farthest: float,
) -> Raised:
    """Move hands up along the hull's tangent plane, so that they stay clear of the hull.

    Args:
        spheres: Centres of each hand's collision spheres [m].
        radius: Their radii [m].
        normals: Outward unit normals of the hull where the hands hang.
        plane: The table.
        clearance: Least height of every sphere over the table [m].
        farthest: Longest way that a hand may be moved [m].
    """
    up = plane[:3]
    lowest = (np.sum(spheres * up, axis=-1) + plane[3] - radius).min(axis=1)
    lack = np.maximum(clearance - lowest, 0.0)
    # A sum and not a product with BLAS, so that the number of starts cannot change the rounding.
    along = up - np.sum(normals * up, axis=1, keepdims=True) * normals
    rise = np.linalg.norm(along, axis=1)
    way = lack / np.maximum(rise, 1e-9)
    ok = way <= farthest
    shift = np.where(ok, way / np.maximum(rise, 1e-9), 0.0)[:, None] * along
    return Raised(shift, ok)
