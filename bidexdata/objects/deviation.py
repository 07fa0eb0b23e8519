"""How far two bodies are apart."""

from __future__ import annotations

import numpy as np

from .mesh_queries import distances, winding_distances
from .prepared import TriangleMesh
from .surface import sample_surface

_INSIDE = 0.6
"""Winding number above which a point away from the surface is inside. On a flat lid over a hole of
an open mesh it is exactly one half, and its estimate falls to either side."""
_AWAY = 1e-3
"""Distance from the surface from which that counts, of the diagonal: nearer to it the number of a
closed mesh passes one half too."""


def hausdorff(a: TriangleMesh, b: TriangleMesh, samples: int) -> float:
    """Distance between two bodies, both ways, estimated from below.

    The larger of two: how far a point of the surface of `a` can be from the body `b`, and one of
    the surface of `b` from the body `a`. The distance of a point to a body is 0 inside of it and
    that to its surface outside, so this is not the Hausdorff distance of the surfaces, nor that of
    the bodies: walls that a union swallowed, and a closed cavity that only one of them has, count
    nothing. A lid over an opening of an open mesh counts.

    All vertices and `samples` seeded random points of each surface are measured; a feature between
    them can only add.
    """
    return max(_reach(a, b, samples), _reach(b, a, samples))


def _reach(a: TriangleMesh, b: TriangleMesh, samples: int) -> float:
    """Largest distance of a surface point of `a` to the body `b`."""
    drawn, _ = sample_surface(a, samples, np.random.default_rng(0))
    points = np.concatenate([a.vertices[np.unique(a.faces)], drawn])
    _, away = distances(b, points)
    # The sign costs more than the distance: ask for it from far to near until one is outside.
    order = np.argsort(-away, kind="stable")
    far = int(np.count_nonzero(away > _AWAY))
    for part, threshold in ((order[:far], _INSIDE), (order[far:], 0.5)):
        for start in range(0, len(part), _BLOCK):
            block = part[start : start + _BLOCK]
            outside = winding_distances(b, points[block], threshold=threshold) > 0
            if outside.any():
                return float(away[block[outside]].max())
    return 0.0


_BLOCK = 2000
"""Points whose sign is asked for at a time."""
