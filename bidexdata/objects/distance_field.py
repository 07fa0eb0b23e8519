"""The signed-distance grid on the device, and its float64 reference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from bidexdata.devices import start_warp

if TYPE_CHECKING:
    from bidexdata.objects.prepared import SignedDistanceGrid


def device_field(grid: SignedDistanceGrid, device: str = "cpu") -> Any:
    """Copy a grid to the device as the struct that kernels take."""
    import warp as wp

    from bidexdata.objects.distance_field_kernels import DistanceField

    start_warp()
    field = DistanceField()
    field.values = wp.array(np.ascontiguousarray(grid.values, np.float32), device=device)
    field.origin = wp.vec3(*map(float, grid.origin))
    field.per_cell = 1.0 / float(grid.cell)
    field.last = wp.vec3(*(float(n - 1) for n in grid.values.shape))
    return field


def signed_distance(
    grid: SignedDistanceGrid, size: float, points: Float[np.ndarray, "*b 3"]
) -> tuple[Float[np.ndarray, "*b"], Float[np.ndarray, "*b 3"]]:
    """Interpolate distances [m] and their gradients at points of an object of `size` [m].

    Outside the grid the distance is that to the surface point closest to the grid's nearest point.

    Args:
        grid: Samples at unit diagonal.
        size: Bounding-box diagonal [m].
        points: Object frame [m].
    """
    y = np.asarray(points, np.float64) / size
    last = np.array(grid.values.shape) - 1
    wanted = (y - grid.origin) / grid.cell
    g = np.clip(wanted, 0, last)
    value, slope = _trilinear(grid, g)
    beyond = (wanted - g) * grid.cell
    outside = np.any(beyond != 0, axis=-1)
    unit = slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-12)
    offset = beyond + value[..., None] * unit
    length = np.linalg.norm(offset, axis=-1)
    far = offset / np.maximum(length, 1e-9)[..., None]
    return (
        np.asarray(size * np.where(outside, length, value)),
        np.where(outside[..., None], far, slope),
    )


def surface_normal(
    grid: SignedDistanceGrid, size: float, points: Float[np.ndarray, "*b 3"], step: float
) -> Float[np.ndarray, "*b 3"]:
    """Outward unit normals from central differences of half width `step` [m]."""
    y = np.asarray(points, np.float64) / size
    last = np.array(grid.values.shape) - 1
    sides = []
    for sign in (1.0, -1.0):
        moved = y[..., None, :] + sign * (step / size) * np.eye(3)
        sides.append(_trilinear(grid, np.clip((moved - grid.origin) / grid.cell, 0, last))[0])
    n = sides[0] - sides[1]
    return n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)


def _trilinear(
    grid: SignedDistanceGrid, g: Float[np.ndarray, "*b 3"]
) -> tuple[Float[np.ndarray, "*b"], Float[np.ndarray, "*b 3"]]:
    base = np.minimum(g.astype(np.int64), np.array(grid.values.shape) - 2)
    u = g - base
    values = grid.values.astype(np.float64)
    total = np.zeros(g.shape[:-1])
    slope = np.zeros(g.shape)
    for corner in np.ndindex(2, 2, 2):
        bit = np.array(corner)
        share = np.where(bit, u, 1 - u)
        v = values[tuple(np.moveaxis(base + bit, -1, 0))]
        total += v * np.prod(share, axis=-1)
        for axis in range(3):
            others = np.prod(np.delete(share, axis, axis=-1), axis=-1)
            slope[..., axis] += np.where(bit[axis], 1.0, -1.0) * v * others
    return total, slope / grid.cell
