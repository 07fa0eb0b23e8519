"""Plates and needles too thin to be simulated, made thicker."""

from __future__ import annotations

import numpy as np

from .closed import as_mesh, convex_hull, principal_axes
from .prepared import TriangleMesh


def thickened(mesh: TriangleMesh, least: float) -> TriangleMesh:
    """Widen a convex body, to both sides alike, along principal axes along which it is thinner.

    Args:
        mesh: The body.
        least: Extent along every principal axis afterwards, at least.
    """
    vertices = mesh.vertices
    for axis in principal_axes(vertices):
        lack = least - np.ptp(vertices @ axis)
        if lack > 0:
            half = lack / 2 * axis
            vertices = np.concatenate([vertices + half, vertices - half])
    return as_mesh(convex_hull(vertices))
