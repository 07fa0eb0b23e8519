"""How far two bodies are apart."""

from __future__ import annotations

import numpy as np

from .mesh_queries import distances, winding_distances
from .prepared import TriangleMesh
from .surface import sample_surface


def hausdorff(a: TriangleMesh, b: TriangleMesh, samples: int) -> float:
    """Symmetric Hausdorff distance between two bodies, estimated from below.

    All vertices and `samples` seeded random points of each surface are measured against the
    other body; those inside it count nothing, so walls that a union swallowed do not matter,
    while a lid over an opening does. A feature between the samples can only add.
    """
    return max(_reach(a, b, samples), _reach(b, a, samples))


def _reach(a: TriangleMesh, b: TriangleMesh, samples: int) -> float:
    """Largest distance of a surface point of `a` to the body `b`."""
    drawn, _ = sample_surface(a, samples, np.random.default_rng(0))
    points = np.concatenate([a.vertices[np.unique(a.faces)], drawn])
    _, away = distances(b, points)
    # The sign costs more than the distance: ask for it from far to near until one is outside.
    order = np.argsort(-away, kind="stable")
    for start in range(0, len(order), _BLOCK):
        block = order[start : start + _BLOCK]
        outside = winding_distances(b, points[block]) > 0
        if outside.any():
            return float(away[block[outside]].max())
    return 0.0


_BLOCK = 2000
"""Points whose sign is asked for at a time."""
