"""What arms have to mind, put on a device once and asked about often: the object and open hands.

World frame; hands in their own.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.devices import start_warp
from bidexdata.objects.distance_field import device_field
from bidexdata.objects.prepared import SignedDistanceGrid

ROUNDING = 1e-5
"""What the balls round groups of spheres are larger by than they need be, for float32 [m]."""
_TOGETHER = 8
"""Spheres of a hand that a ball is put round: those of one finger or palm as a rule, which follow each
other [-]."""
_NO_FIELD = SignedDistanceGrid(np.zeros((2, 2, 2), np.float32), np.zeros(3), 1.0)


class Placed(NamedTuple):
    """The object of each row of configurations, in the world."""

    field: SignedDistanceGrid
    """Of all rows' object, at unit diagonal."""
    size: Float[np.ndarray, " N"]
    """Bounding-box diagonals [m]."""
    pos: Float[np.ndarray, "N 3"]
    """[m]."""
    rot: Float[np.ndarray, "N 3 3"]


class HeldHands(NamedTuple):
    """The spheres of one hand in the posture of each row of configurations."""

    pos: Float[np.ndarray, "N K 3"]
    """Centres in the hand frame [m]."""
    radius: Float[np.ndarray, " K"]
    """[m]."""


class Surroundings:
    """What the arms of N grasps have to mind, on a device: put there once, asked about often."""

    def __init__(
        self,
        placed: Placed | None,
        hands: tuple[HeldHands | None, HeldHands | None] = (None, None),
        *,
        rows: int,
        device: str = "cpu",
    ) -> None:
        """Copy them to the device.

        Args:
            placed: The object of each row; none for arms, table and fixtures alone.
            hands: The open hands of each row, left and right, where they count.
            rows: N.
            device: A Warp device.
        """
        start_warp()
        self.device = device
        self.held = hands
        """The hands as given."""
        self.field, self.object = _object_on_device(placed, rows, device)
        self.hands = tuple(
            nothing_held(device) if hand is None else _hands_on_device(hand, device)
            for hand in hands
        )


def _hands_on_device(hands: HeldHands, device: str) -> Any:
    import warp as wp

    from bidexdata.arms.sphere_kernels import HandArrays

    arrays, shape = HandArrays(), hands.pos.shape[:2]
    first = np.arange(0, shape[1], _TOGETHER)
    low, high = (u.reduceat(hands.pos, first, axis=1) for u in (np.minimum, np.maximum))
    middle = 0.5 * (low + high)
    whole = 0.5 * (low.min(axis=1, keepdims=True) + high.max(axis=1, keepdims=True))
    group = np.arange(shape[1]) // _TOGETHER
    apart = np.linalg.norm(hands.pos - middle[:, group], axis=-1) + hands.radius
    wide = np.maximum.reduceat(apart, first, axis=1) + ROUNDING
    widest = (np.linalg.norm(hands.pos - whole, axis=-1) + hands.radius).max(axis=1) + ROUNDING
    arrays.pos = _vectors(hands.pos, device)
    arrays.radius = wp.array(hands.radius.astype(np.float32), dtype=float, device=device)
    ends = np.append(first, shape[1]).astype(np.int32)
    arrays.group_first = wp.array(ends, dtype=int, device=device)
    arrays.ball_pos = _vectors(middle, device)
    balls = np.ascontiguousarray(wide, np.float32)
    arrays.ball_radius = wp.array(balls, dtype=float, shape=balls.shape, device=device)
    arrays.whole_pos = vectors_on_device(whole, device, len(whole))
    arrays.whole_radius = wp.array(widest.astype(np.float32), dtype=float, device=device)
    return arrays


def _vectors(values: Float[np.ndarray, "N K 3"], device: str) -> Any:
    import warp as wp

    single = np.ascontiguousarray(values, np.float32)
    return wp.array(single, dtype=wp.vec3, shape=values.shape[:2], device=device)


@lru_cache(maxsize=4)
def nothing_held(device: str) -> Any:
    """`HandArrays` of an arm whose hand does not count."""
    import warp as wp

    from bidexdata.arms.sphere_kernels import HandArrays

    arrays = HandArrays()
    arrays.pos = wp.zeros((0, 0), dtype=wp.vec3, device=device)
    arrays.radius = wp.empty(0, dtype=float, device=device)
    arrays.group_first = wp.zeros(1, dtype=int, device=device)
    arrays.ball_pos = wp.zeros((0, 0), dtype=wp.vec3, device=device)
    arrays.ball_radius = wp.empty((0, 0), dtype=float, device=device)
    arrays.whole_pos = vectors_on_device(np.zeros((0, 3)), device, 0)
    arrays.whole_radius = wp.empty(0, dtype=float, device=device)
    return arrays


def _object_on_device(placed: Placed | None, rows: int, device: str) -> tuple[Any, Any]:
    import warp as wp

    from bidexdata.arms.clearance_kernels import ObjectArrays

    around = ObjectArrays()
    around.present = 0 if placed is None else 1
    if placed is None:
        placed = Placed(_NO_FIELD, np.ones(rows), np.zeros((rows, 3)), np.zeros((rows, 3, 3)))
    low, high = _box(placed.field)
    around.low, around.high = wp.vec3(*map(float, low)), wp.vec3(*map(float, high))
    around.size = wp.array(
        np.ascontiguousarray(placed.size, np.float32), dtype=float, device=device
    )
    around.pos = vectors_on_device(placed.pos, device, rows)
    rot = np.ascontiguousarray(placed.rot, np.float32)
    around.rot = wp.array(rot, dtype=wp.mat33, shape=(rows,), device=device)
    return _field_on_device(placed.field, device), around


def vectors_on_device(values: np.ndarray, device: str, count: int) -> Any:
    """Copy `count` vectors (count, 3) to a device."""
    import warp as wp

    values = np.ascontiguousarray(values, np.float32).reshape(-1, 3)
    return wp.array(values, dtype=wp.vec3, shape=(count,), device=device)


@lru_cache(maxsize=16)
def _box(field: SignedDistanceGrid) -> tuple[np.ndarray, np.ndarray]:
    """Corners of an upright box that no point of the solid is beyond, at unit diagonal."""
    inside = field.values <= field.cell
    # Axis by axis, which is much sooner than listing the nodes.
    along = [np.flatnonzero(inside.any(axis=others)) for others in ((1, 2), (0, 2), (0, 1))]
    if not len(along[0]):
        return np.zeros(3), np.zeros(3)
    # A cell more: the surface lies between nodes.
    low, high = (np.array([nodes[end] for nodes in along]) for end in (0, -1))
    low, high = low - 1, high + 1
    return field.origin + field.cell * low, field.origin + field.cell * high


@lru_cache(maxsize=16)
def _field_on_device(field: SignedDistanceGrid, device: str) -> Any:
    return device_field(field, device)
