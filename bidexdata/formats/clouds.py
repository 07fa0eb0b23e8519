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
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.surface import farthest_point_order, sample_surface

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
    mesh = TriangleMesh(np.asarray(vertices, np.float64), np.asarray(faces, np.int32))
    points, _ = sample_surface(mesh, count * OVERSAMPLING, rng)
    points = points.astype(np.float32)
    return points[farthest_point_order(points, count)]


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
