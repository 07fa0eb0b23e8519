"""Outward normals at the points of a release's clouds, for losses that tell inside from outside."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

if TYPE_CHECKING:
    from bidexdata.formats.release import Release
    from bidexdata.objects.prepared import TriangleMesh

OF_CLOUD = "cloud_solid"
"""The cloud that normals are known of: its points lie on convex pieces, which a release holds."""


class CloudNormals:
    """Normals of the clouds of a release, computed when an object is first asked for.

    State: the normals of the objects that were asked for.
    """

    def __init__(self, release: Release, points: int):
        """Remember the release.

        Args:
            release: With shapes in it.
            points: Points per cloud, the first of the stored order.
        """
        self._release, self._points = release, points
        self._found: dict[int, np.ndarray] = {}

    def of(self, objects: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n P 3"]:
        """Normals in the object frame, which no size changes.

        Args:
            objects: Numbers in `Release.object_ids`.
        """
        for number in np.unique(objects).tolist():
            if number not in self._found:
                object_id = self._release.object_ids[number]
                points = self._release.cloud(OF_CLOUD)[number, : self._points]
                pieces = self._release.load_solid(object_id).pieces
                self._found[number] = normals_on(np.asarray(points), pieces)
        if not len(objects):
            return np.zeros((0, self._points, 3), np.float32)
        return np.stack([self._found[number] for number in objects.tolist()])


def normals_on(
    points: Float[np.ndarray, "P 3"], pieces: Sequence[TriangleMesh]
) -> Float[np.ndarray, "P 3"]:
    """Normals of the union of convex pieces at points on its surface.

    A point lies on the piece whose surface is closest, and its normal is that of the face whose
    plane it is farthest out of: in a convex body that is the face it lies on.

    Args:
        points: On the surface.
        pieces: Closed and convex, wound so that normals point out.
    """
    closest = np.full(len(points), np.inf)
    normals = np.zeros((len(points), 3), np.float32)
    for piece in pieces:
        normal, offset = _planes(piece)
        out = points.astype(np.float64) @ normal.T - offset
        face = out.argmax(axis=1)
        gap = np.abs(np.take_along_axis(out, face[:, None], axis=1)[:, 0])
        nearer = gap < closest
        closest[nearer] = gap[nearer]
        normals[nearer] = normal[face[nearer]]
    return normals


def _planes(piece: TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    """Outward unit normals (F, 3) and offsets (F,) of the faces that have an area."""
    a, b, c = (piece.vertices[piece.faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    area = np.linalg.norm(across, axis=1)
    kept = area > 1e-12 * max(float(area.max()), 1e-300)
    normal = across[kept] / area[kept, None]
    return normal, (normal * a[kept]).sum(axis=1)
