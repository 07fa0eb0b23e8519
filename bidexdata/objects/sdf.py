"""Signed-distance grid of a solid given by its surface and its convex pieces.

Magnitude: distance to the surface, exact in a band around it; farther out the distance to the
nearest of the closest surface points of the band's nodes, which is never too small and too large
by about a tenth of a cell at most. Searching the mesh from every node would cost up to a hundred
times more (deep queries in finely tessellated spheres degenerate).
Sign: half-space tests of the convex pieces.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from .config import SdfConfig
from .mesh_queries import distances, donated_distances, nodes_inside
from .prepared import SignedDistanceGrid, TriangleMesh
from .surface import sample_surface

_LADDER = (0.5, 0.625, 0.75, 0.875, 1.0)
"""Shares of the finest grid's cells."""
_NEAR = 0.03
"""Distance from the surface, of the diagonal, within which the error is bounded."""
_TRIED = 3000
"""Points at which the interpolation is tried."""
_STEP = 2.0**-18
"""Distances at unit diagonal are multiples of this: 2 um at a diagonal of 0.5 m, and a quarter of the file less."""
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
    room = config.margin * float(np.max(high - low))
    origin = low - room
    cell = _coarsest_cell(solid, pieces, origin, config)
    nx, ny, nz = (np.ceil((high - low + 2 * room) / cell) + 1).astype(int)
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
    step = _STEP * 2.0 ** round(float(np.log2(np.linalg.norm(high - low))))
    values = np.rint(np.where(inside, -values, values) / step) * step
    return SignedDistanceGrid(values.astype(np.float32), origin, cell)


def exact_distances(
    solid: TriangleMesh, pieces: Sequence[TriangleMesh], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Signed distances (P,) of points (P, 3) to the union of convex pieces, negative inside."""
    inside = np.zeros(len(points), bool)
    for piece in pieces:
        low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
        near = np.flatnonzero(np.all((points >= low) & (points <= high), axis=1))
        planes = face_planes(piece)
        inside[near] |= np.all(points[near] @ planes[:, :3].T <= planes[:, 3], axis=1)
    _, away = distances(solid, points)
    return np.where(inside, -away, away).astype(np.float64)


def _coarsest_cell(
    solid: TriangleMesh,
    pieces: Sequence[TriangleMesh],
    origin: NDArray[np.float64],
    config: SdfConfig,
) -> float:
    """Largest cell on the ladder with which interpolation near the surface is exact enough.

    Tried on points near the surface, from exact distances at the corners of their cells, before
    any grid is made.
    """
    diagonal = float(np.linalg.norm(np.ptp(solid.vertices, axis=0)))
    points = _near_points(solid, _NEAR * diagonal)
    exact = exact_distances(solid, pieces, points)

    def cell_of(rung: int) -> float:
        return float(np.float32(diagonal / (_LADDER[rung] * config.cells)))

    # A finer grid is taken to be more exact, so halving the ladder finds the rung.
    low, high = 0, len(_LADDER) - 1
    while low < high:
        middle = (low + high) // 2
        nodes, weights = _corners(points, origin, cell_of(middle))
        values = exact_distances(solid, pieces, nodes.reshape(-1, 3)).reshape(weights.shape)
        error = np.abs((weights * values).sum(axis=0) - exact).max()
        if error <= config.error * diagonal:
            high = middle
        else:
            low = middle + 1
    return cell_of(high)


def _near_points(solid: TriangleMesh, reach: float) -> NDArray[np.float64]:
    """Points (P, 3) on normals of the surface, at most `reach` away from where they start."""
    rng = np.random.default_rng(0)
    points, face = sample_surface(solid, _TRIED, rng)
    corners = solid.vertices[solid.faces[face]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return points + rng.uniform(-reach, reach, (_TRIED, 1)) * normal


def _corners(
    points: NDArray[np.float64], origin: NDArray[np.float64], cell: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners (8, P, 3) of the cell of each point, and their trilinear weights (8, P)."""
    at = (points - origin) / cell
    base = np.floor(at)
    corners = np.array(list(itertools.product((0, 1), repeat=3)))[:, None]
    weights = np.where(corners, at - base, 1 - at + base).prod(axis=2)
    return origin + cell * (base + corners), weights


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
