"""How far two surfaces are apart."""

from __future__ import annotations

import numpy as np

from bidexdata.objects.mesh_queries import distances
from bidexdata.objects.prepared import TriangleMesh
from bidexdata.objects.surface import sample_surface


def hausdorff(a: TriangleMesh, b: TriangleMesh, samples: int) -> float:
    """Symmetric Hausdorff distance between two surfaces, estimated from below.

    All vertices and `samples` seeded random points of each surface are measured against the
    triangles of the other; a feature between the samples can only make the true value larger.
    """
    return max(_one_way(a, b, samples), _one_way(b, a, samples))


def _one_way(a: TriangleMesh, b: TriangleMesh, samples: int) -> float:
    drawn, _ = sample_surface(a, samples, np.random.default_rng(0))
    used = a.vertices[np.unique(a.faces)]
    _, away = distances(b, np.concatenate([used, drawn]))
    return float(away.max())
