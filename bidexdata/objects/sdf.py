"""Signed-distance grid of a solid given by its surface and its convex pieces.

Magnitude: distance to the surface, exact in a band around it; farther out the distance to the
nearest of the closest surface points of the band's nodes, which is never too small and too large
by about a tenth of a cell at most. Searching the mesh from every node would cost up to a hundred
times more (deep queries in finely tessellated spheres degenerate).
Sign: half-space tests of the convex pieces.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.config import SdfConfig
from bidexdata.objects.mesh_queries import distances, donated_distances, nodes_inside
from bidexdata.objects.prepared import SignedDistanceGrid, TriangleMesh

_BAND = 2
"""Half the width of the band with exact distances, in cells."""
_STRIDES = (2, 1)
"""How far the nodes look for a better closest point, one pass each, in cells."""


def signed_distance_grid(
    solid: TriangleMesh, pieces: Sequence[TriangleMesh], config: SdfConfig
) -> SignedDistanceGrid:
    """Sample the signed distance of the union of convex pieces, negative inside.

    Args:
        solid: Surface of the union of the pieces.
        pieces: The convex pieces, faces outward.
        config: Resolution and margin.
    """
    from scipy.ndimage import distance_transform_edt

    low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
    longest = float(np.max(high - low))
    cell = float(np.float32(longest / config.cells))
    origin = low - config.margin * longest
    nx, ny, nz = (np.ceil((high - low + 2 * config.margin * longest) / cell) + 1).astype(int)
    shape = (int(nx), int(ny), int(nz))

    band = _band(solid, origin, cell, shape)
    closest, _ = distances(solid, origin + cell * np.argwhere(band))
    # Every node starts with the band node nearest to it and then asks its neighbours.
    donor = np.zeros(shape, np.int32)
    donor[band] = np.arange(len(closest), dtype=np.int32)
    nearest = distance_transform_edt(~band, return_distances=False, return_indices=True)
    donor = donor[tuple(nearest)]  # type: ignore[index]
    values = donated_distances(closest, donor, band, origin, cell, strides=_STRIDES)

    inside = nodes_inside(
        [face_planes(p) for p in pieces],
        np.array([p.vertices.min(axis=0) for p in pieces]),
        np.array([p.vertices.max(axis=0) for p in pieces]),
        origin,
        cell,
        shape,
    )
    return SignedDistanceGrid(np.where(inside, -values, values).astype(np.float32), origin, cell)


def face_planes(piece: TriangleMesh) -> NDArray[np.float64]:
    """Outward planes (F, 4) of a convex piece, (n, d) with n . x <= d inside.

    The offset is the support of all vertices, so every vertex is held exactly; faces without
    area are left out.
    """
    a, b, c = (piece.vertices[piece.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    keep = length > 1e-12
    normal = normal[keep] / length[keep, None]
    return np.column_stack([normal, np.max(normal @ piece.vertices.T, axis=1)])


def _band(
    solid: TriangleMesh, origin: NDArray[np.float64], cell: float, shape: tuple[int, int, int]
) -> NDArray[np.bool_]:
    """Nodes within about `_BAND` cells of the surface."""
    from scipy.ndimage import binary_dilation

    band = np.zeros(shape, bool)
    for points in cover(solid, cell):
        index = np.rint((points - origin) / cell).astype(int)
        band[tuple(index.T)] = True
    return np.asarray(binary_dilation(band, np.ones((3, 3, 3), bool), iterations=_BAND), bool)


def cover(mesh: TriangleMesh, spacing: float) -> Iterator[NDArray[np.float64]]:
    """Yield arrays of points (P, 3) that leave no part of the surface farther than `spacing`.

    Every triangle gets a barycentric lattice as fine as its longest edge asks for.
    """
    corners = mesh.vertices[mesh.faces]
    edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
    steps = np.maximum(np.ceil(edges / spacing).astype(int), 1)
    for n in np.unique(steps):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        held = i + j <= n
        u, v = i[held] / n, j[held] / n
        weights = np.stack([1 - u - v, u, v], axis=1)
        group = corners[steps == n]
        # Bounded memory: a few million points at a time.
        block = max(1, 2_000_000 // len(weights))
        for start in range(0, len(group), block):
            yield np.einsum("pk,fkx->fpx", weights, group[start : start + block]).reshape(-1, 3)
