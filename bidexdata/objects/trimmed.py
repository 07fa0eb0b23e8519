"""Convex pieces without what their neighbours cover anyway.

Hulls of the parts of a decomposition bulge into each other. A piece that becomes the hull of what
it alone covers is smaller, and the union stays what it was: contacts and volume count less twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .closed import as_mesh, convex_hull, union
from .prepared import TriangleMesh

if TYPE_CHECKING:
    from manifold3d import Manifold

_LEAST = 1e-9
"""Volume below which nothing is left of a piece (unit diagonal)."""


def trimmed(pieces: Sequence[TriangleMesh]) -> list[TriangleMesh]:
    """Trim convex pieces one after the other, the largest first; what is covered in full goes.

    The union is the same but for rounding. Pieces keep their order.
    """
    hulls = [convex_hull(piece.vertices) for piece in pieces]
    gone: set[int] = set()
    for i in np.argsort([-hull.volume() for hull in hulls], kind="stable").tolist():
        others = [h for k, h in enumerate(hulls) if k != i and k not in gone]
        own = _alone(hulls[i], others)
        if own is None:
            gone.add(i)
        elif own.volume() < hulls[i].volume():
            hulls[i] = own
    return [as_mesh(hull) for k, hull in enumerate(hulls) if k not in gone]


def _alone(hull: Manifold, others: Sequence[Manifold]) -> Manifold | None:
    """The hull of what no other covers; None where nothing is left."""
    touching = [other for other in others if _boxes_meet(hull, other)]
    if not touching:
        return hull
    left = hull - union(touching)
    if left.is_empty() or left.volume() < _LEAST:
        return None
    return convex_hull(as_mesh(left).vertices)


def _boxes_meet(a: Manifold, b: Manifold) -> bool:
    p, q = np.array(a.bounding_box()), np.array(b.bounding_box())
    return bool(np.all(p[:3] <= q[3:]) and np.all(q[:3] <= p[3:]))
