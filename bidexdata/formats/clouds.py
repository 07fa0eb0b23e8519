"""Point clouds of a release: N surface points per object and surface, unit diagonal.

`cloud_solid` lies on what was simulated, `cloud_mesh` on the repaired mesh. Points are drawn by
area and put in farthest-point order, so that the first n of them are a good cloud too. One float32
array (objects, N, 3) per kind, in the order of the objects table, that `numpy` maps from disk.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction

CLOUDS = ("cloud_solid", "cloud_mesh")
OVERSAMPLING = 4
"""Points drawn per point kept. Source: our choice; farthest-point order needs a reserve."""


def surface_cloud(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], count: int, key: str
) -> NDArray[np.float32]:
    """Draw `count` points on a triangle surface, farthest-point ordered, (count, 3).

    Args:
        vertices: (V, 3), object frame, unit diagonal.
        faces: (F, 3).
        count: Points to return.
        key: Seeds the draw (object and kind), so that the same object gives the same cloud.
    """
    rng = np.random.default_rng(int(hashlib.sha256(key.encode()).hexdigest()[:16], 16))
    corners = np.asarray(vertices, np.float64)[np.asarray(faces)]
    edge_a, edge_b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(edge_a, edge_b), axis=1)
    total = np.cumsum(area)
    drawn = count * OVERSAMPLING
    face = np.searchsorted(total, rng.random(drawn) * total[-1], side="right").clip(
        0, len(area) - 1
    )
    # The square root makes the draw uniform over the triangle.
    u, v = np.sqrt(rng.random(drawn)), rng.random(drawn)
    points = corners[face, 0] + (u * (1 - v))[:, None] * edge_a[face]
    points += (u * v)[:, None] * edge_b[face]
    return points[_farthest_first(points, count)].astype(np.float32)


def open_cloud(path: Path) -> NDArray[np.float32]:
    """Map a cloud file, (K, N, 3) float32, read only.

    Raises:
        Contradiction: The file is not such an array.
    """
    try:
        cloud = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as err:
        raise Contradiction(f"{path}: unreadable cloud file ({err})") from err
    if cloud.ndim != 3 or cloud.shape[2] != 3 or cloud.dtype != np.dtype("<f4"):
        raise Contradiction(f"{path}: expected float32 (K, N, 3), not {cloud.dtype} {cloud.shape}")
    return cloud


def _farthest_first(points: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    # Separate float32 axes: one pass over the points costs a third of the (n, 3) form.
    x, y, z = (np.ascontiguousarray(points[:, a], np.float32) for a in range(3))
    order = np.empty(count, np.intp)
    gap = np.full(len(points), np.inf, np.float32)
    at = 0
    for i in range(count):
        order[i] = at
        dx, dy, dz = x - x[at], y - y[at], z - z[at]
        np.minimum(gap, dx * dx + dy * dy + dz * dz, out=gap)
        at = int(np.argmax(gap))
    return order
