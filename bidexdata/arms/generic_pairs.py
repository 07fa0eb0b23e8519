"""Generic pairs of palm poses on simple shapes that stand on a table: what a rig is tried on.

Boxes, ellipsoids and elliptic cylinders at a given bounding-box diagonal, turned about the vertical
at the world's origin. A pair is two points of the surface that do not face the same way, the left
hand at larger y; palms look against the surface normals, fingers forward, down and inward as the
paper's appendix B has it, up to a jitter. No grasp is synthesised, so a share of reachable pairs
compares rigs and places, and says nothing of a method.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.hands.model import FloatArray
from bidexdata.objects.prepared import SignedDistanceGrid

FAMILIES = ("box", "ellipsoid", "cylinder")
PROPORTIONS = ((1.0, 1.0, 1.0), (1.0, 0.7, 0.5), (0.6, 0.6, 1.0))
"""Edges along x, y, z, up to scale."""
PREFERRED = ((1.0, -1.0, -1.0), (1.0, 1.0, -1.0))
"""Direction of the fingers of the left and of the right hand in the world (paper, appendix B)."""
JITTER = np.radians(20.0)
"""Largest turn of the fingers away from it [rad]."""
OPPOSED = 0.3
"""Largest cosine between the two outward normals [-]."""
LOWEST = 0.06
"""Least height of a palm's middle over the table [m]: half a hand is below it."""
DOWNWARD = -0.5
"""Least vertical part of an outward normal [-]: no hand comes from below."""
GAP = 0.02
"""Palm to surface [m]."""
_NODES = 56


class GenericShape(NamedTuple):
    """A solid of unit bounding-box diagonal round the origin."""

    family: str
    half: FloatArray
    """Half edges of the bounding box, (3,)."""


class GenericPairs(NamedTuple):
    """N pairs of palm poses; sides left, right."""

    shape: Int[np.ndarray, " N"]
    """Number in `generic_shapes()`."""
    size: Float[np.ndarray, " N"]
    """Bounding-box diagonal [m]."""
    object_pos: Float[np.ndarray, "N 3"]
    """[m]."""
    object_rot: Float[np.ndarray, "N 3 3"]
    palm_pos: Float[np.ndarray, "N 2 3"]
    """Origin of the palm frame in the world [m]."""
    palm_rot: Float[np.ndarray, "N 2 3 3"]


@lru_cache(maxsize=1)
def generic_shapes() -> tuple[GenericShape, ...]:
    """The shapes: every family in every proportion."""
    found = []
    for family in FAMILIES:
        for edges in PROPORTIONS:
            half = 0.5 * np.array(edges) / np.linalg.norm(edges)
            found.append(GenericShape(family, half))
    return tuple(found)


@lru_cache(maxsize=16)
def shape_grid(number: int) -> SignedDistanceGrid:
    """The signed distance of a shape on a grid, unit diagonal."""
    shape = generic_shapes()[number]
    margin = 0.1
    cell = 2 * (float(shape.half.max()) + margin) / _NODES
    counts = np.ceil(2 * (shape.half + margin) / cell).astype(int) + 1
    origin = -0.5 * cell * (counts - 1)
    axes = [o + cell * np.arange(n) for o, n in zip(origin, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return SignedDistanceGrid(distance(shape, points).astype(np.float32), origin, cell)


def distance(shape: GenericShape, x: FloatArray) -> FloatArray:
    """Signed distance of points (..., 3) at unit diagonal; of an ellipsoid to first order."""
    half = shape.half
    if shape.family == "box":
        out = np.abs(x) - half
        return np.linalg.norm(np.maximum(out, 0), axis=-1) + np.minimum(out.max(axis=-1), 0)
    if shape.family == "ellipsoid":
        return _ellipsoid(x, half)
    round_, flat = _ellipsoid(x[..., :2], half[:2]), np.abs(x[..., 2]) - half[2]
    outside = np.hypot(np.maximum(round_, 0), np.maximum(flat, 0))
    return outside + np.minimum(np.maximum(round_, flat), 0)


def draw_pairs(size: float, count: int, rng: np.random.Generator) -> GenericPairs:
    """Draw pairs of palm poses on objects of one size.

    Args:
        size: Bounding-box diagonal [m].
        count: Pairs.
        rng: Random numbers.
    """
    rows = [_draw_one(size, rng) for _ in range(count)]
    return GenericPairs(*(np.array(column) for column in zip(*rows, strict=True)))


def join_pairs(parts: list[GenericPairs]) -> GenericPairs:
    """Pairs one after the other."""
    return GenericPairs(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _draw_one(size: float, rng: np.random.Generator) -> tuple:
    shapes = generic_shapes()
    number = int(rng.integers(len(shapes)))
    shape = shapes[number]
    yaw = rng.uniform(-np.pi, np.pi)
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    middle = np.array([0, 0, size * shape.half[2]])
    while True:
        points, normals = _surface(shape, 2, rng)
        points, normals = size * points @ R.T + middle, normals @ R.T
        good = points[:, 2].min() >= LOWEST and normals[:, 2].min() >= DOWNWARD
        if good and normals[0] @ normals[1] < OPPOSED:
            break
    order = np.argsort(-points[:, 1])
    points, normals = points[order], normals[order]
    rot = np.array([_palm(normals[h], np.array(PREFERRED[h]), rng) for h in range(2)])
    return number, size, middle, R, points + GAP * normals, rot


def _palm(normal: FloatArray, fingers: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Palm frame: z against the outward normal, x along the fingers, (3, 3)."""
    z = -normal
    x = fingers - (fingers @ z) * z
    if np.linalg.norm(x) < 1e-3:
        x = np.array([1.0, 0, 0]) - z[0] * z
    x = x / np.linalg.norm(x)
    angle = rng.uniform(-JITTER, JITTER)
    x = np.cos(angle) * x + np.sin(angle) * np.cross(z, x)
    return np.stack([x, np.cross(z, x), z], axis=1).astype(np.float64)


def _surface(
    shape: GenericShape, count: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Points on the surface at unit diagonal and outward normals, (count, 3) each."""
    half = shape.half
    if shape.family == "ellipsoid":
        unit = rng.normal(size=(count, 3))
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        normal = unit / half
        return half * unit, normal / np.linalg.norm(normal, axis=1, keepdims=True)
    if shape.family == "box":
        area = np.repeat(half.prod() / half, 2)
        face = rng.choice(6, size=count, p=area / area.sum())
        points = half * rng.uniform(-1, 1, (count, 3))
        normal = np.eye(3)[face // 2] * np.where(face % 2, 1.0, -1.0)[:, None]
        return np.where(normal != 0, half * normal, points), normal
    angle = rng.uniform(-np.pi, np.pi, count)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    cap = rng.random(count) < 0.3
    points = np.column_stack([half[:2] * circle, half[2] * rng.uniform(-1, 1, count)])
    normal = np.column_stack([circle / half[:2], np.zeros(count)])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    inner = np.column_stack(
        [half[:2] * circle * np.sqrt(rng.random(count))[:, None], np.full(count, half[2])]
    )
    up = np.array([0, 0, 1.0])
    return np.where(cap[:, None], inner, points), np.where(cap[:, None], up, normal)


def _ellipsoid(x: FloatArray, half: FloatArray) -> FloatArray:
    scaled = np.linalg.norm(x / half, axis=-1)
    slope = np.linalg.norm(x / half**2, axis=-1)
    inside = -half.min()
    return np.where(slope > 1e-9, scaled * (scaled - 1) / np.maximum(slope, 1e-9), inside)
