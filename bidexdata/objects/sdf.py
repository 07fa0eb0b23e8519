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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .config import SdfConfig
from .mesh_queries import distances, donated_distances, nodes_inside
from .prepared import SignedDistanceGrid, TriangleMesh
from .surface import sample_surface

_COARSE = SdfConfig(cells=96)
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


def grid_of_pieces(
    pieces: Sequence[TriangleMesh], config: SdfConfig | None = None
) -> SignedDistanceGrid:
    """The grid of a solid of which only the pieces are known, as in a release.

    Args:
        pieces: The convex pieces at unit diagonal, faces outward.
        config: Resolution and margin; when omitted, those of a coarse grid for searching.
    """
    from .closed import as_manifold, as_mesh, union

    closed = [solid for solid in map(as_manifold, pieces) if solid is not None]
    return signed_distance_grid(as_mesh(union(closed)), pieces, config or _COARSE)


def grid_warnings(
    solid: TriangleMesh,
    pieces: Sequence[TriangleMesh],
    grid: SignedDistanceGrid,
    config: SdfConfig,
) -> tuple[str, ...]:
    """Warn of a grid that is the finest one and not as exact as it should be.

    Args:
        solid: As in `signed_distance_grid`, likewise the pieces.
        pieces: The convex pieces.
        grid: What that gave.
        config: What it was given.
    """
    diagonal = _diagonal(solid)
    if grid.cell > _cell_of(diagonal, _LADDER[-1], config):
        return ()
    error = _Trial.of(solid, pieces).error(grid.origin, grid.cell) / diagonal
    if error <= config.error:
        return ()
    text = f"signed distances near the surface are off by up to {error:.2%} of the diagonal"
    return (f"{text} on the finest grid, of {config.cells} cells; sdf.error is {config.error:.2%}",)


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
    any grid is made. The smallest cell is taken untried (`grid_warnings` tries it).
    """
    diagonal = _diagonal(solid)
    trial = _Trial.of(solid, pieces)
    # A finer grid is taken to be more exact, so halving the ladder finds the rung.
    low, high = 0, len(_LADDER) - 1
    while low < high:
        middle = (low + high) // 2
        cell = _cell_of(diagonal, _LADDER[middle], config)
        if trial.error(origin, cell) <= config.error * diagonal:
            high = middle
        else:
            low = middle + 1
    return _cell_of(diagonal, _LADDER[high], config)


def _cell_of(diagonal: float, share: float, config: SdfConfig) -> float:
    return float(np.float32(diagonal / (share * config.cells)))


def _diagonal(solid: TriangleMesh) -> float:
    return float(np.linalg.norm(np.ptp(solid.vertices, axis=0)))


class _Trial(NamedTuple):
    """Points near the surface of a solid, on which the interpolation in a grid is tried."""

    solid: TriangleMesh
    pieces: Sequence[TriangleMesh]
    points: NDArray[np.float64]
    exact: NDArray[np.float64]

    @classmethod
    def of(cls, solid: TriangleMesh, pieces: Sequence[TriangleMesh]) -> _Trial:
        points = _near_points(solid, _NEAR * _diagonal(solid))
        return cls(solid, pieces, points, exact_distances(solid, pieces, points))

    def error(self, origin: NDArray[np.float64], cell: float) -> float:
        """Largest error at the points."""
        nodes, weights = _corners(self.points, origin, cell)
        values = exact_distances(self.solid, self.pieces, nodes.reshape(-1, 3))
        found = (weights * values.reshape(weights.shape)).sum(axis=0)
        return float(np.abs(found - self.exact).max())


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
