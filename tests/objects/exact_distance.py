"""Signed distance to a union of convex pieces without any search structure, in float64."""

from __future__ import annotations

import numpy as np

from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.surface import sample_surface


def near_points(solid: TriangleMesh, count: int, reach: float, seed: int) -> np.ndarray:
    """Points (P, 3) at most `reach` away from where they start on the surface."""
    rng = np.random.default_rng(seed)
    points, _ = sample_surface(solid, count, rng)
    step = rng.standard_normal((count, 3))
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    return points + rng.uniform(0, reach, (count, 1)) * step


def signed_distances(solid: TriangleMesh, pieces, points: np.ndarray) -> np.ndarray:
    """Distance of every point to every triangle, negative inside a piece, (P,)."""
    away = np.concatenate([_unsigned(solid, p) for p in np.array_split(points, 40)])
    return np.where(inside(pieces, points), -away, away)


def inside(pieces, points: np.ndarray) -> np.ndarray:
    held = np.zeros(len(points), bool)
    for piece in pieces:
        a, b, c = (piece.vertices[piece.faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        real = np.linalg.norm(normal, axis=1) > 1e-12
        normal, start = normal[real], a[real]
        held |= np.all(points @ normal.T <= np.einsum("ni,ni->n", normal, start), axis=1)
    return held


def _unsigned(mesh: TriangleMesh, points: np.ndarray) -> np.ndarray:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    square = np.einsum("ni,ni->n", normal, normal)
    best = np.full((len(points), len(a)), np.inf)
    over = np.ones(best.shape, bool)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        length = np.maximum(np.einsum("ni,ni->n", edge, edge), 1e-300)
        t = np.clip((points @ edge.T - np.einsum("ni,ni->n", start, edge)) / length, 0, 1)
        to_edge = sum((points[:, k, None] - start[:, k] - t * edge[:, k]) ** 2 for k in range(3))
        best = np.minimum(best, to_edge)
        inward = np.cross(normal, edge)
        over &= points @ inward.T >= np.einsum("ni,ni->n", inward, start)
    height = points @ normal.T - np.einsum("ni,ni->n", normal, a)
    over &= square > 1e-30
    best = np.where(over, np.minimum(best, height**2 / np.maximum(square, 1e-300)), best)
    return np.sqrt(best.min(axis=1))
