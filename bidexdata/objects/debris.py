"""Debris: small components away from everything else, which would set the scale of the object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .components import components, joined
from .config import LoadConfig, RepairConfig
from .loading import LoadedMesh, unit_mesh
from .mesh_queries import distances
from .physics import surface_area
from .prepared import TriangleMesh
from .weld import weld

_SMALL = 1e-3
"""Share of the largest component's area that a piece of debris has at most."""
_TOGETHER = 0.05
"""Share of all area that debris may have; more of it is part of the object."""


def without_debris(
    loaded: LoadedMesh, config: RepairConfig, bounds: LoadConfig
) -> tuple[LoadedMesh, int]:
    """Drop debris and scale the rest to unit diagonal; also the number of components dropped.

    Debris is a component with little area that is smaller than `config.debris`, and farther than
    `config.detached` from all that is not, both as shares of the diagonal of the component with the
    largest area. A small part that is attached, or that lies close, is a detail.
    """
    parts = components(weld(loaded.mesh, config.weld))
    area = np.array([surface_area(p) for p in parts])
    if len(parts) < 2:
        return loaded, 0
    extent = np.array([float(np.linalg.norm(np.ptp(p.vertices, axis=0))) for p in parts])
    main = int(np.argmax(area))
    small = (extent < config.debris * extent[main]) & (area < _SMALL * area[main])
    if not small.any():
        return loaded, 0
    candidates = np.flatnonzero(small)
    rest = joined([p for p, s in zip(parts, small, strict=True) if not s])
    away = _nearest(rest, [parts[k] for k in candidates])
    dropped = candidates[away > config.detached * extent[main]]
    if not len(dropped) or area[dropped].sum() > _TOGETHER * area.sum():
        return loaded, 0
    gone = set(dropped.tolist())
    kept = unit_mesh(joined([p for k, p in enumerate(parts) if k not in gone]), bounds)
    return (
        loaded._replace(
            mesh=kept.mesh,
            centre=loaded.centre + loaded.diagonal * kept.centre,
            diagonal=loaded.diagonal * kept.diagonal,
        ),
        len(dropped),
    )


def _nearest(rest: TriangleMesh, parts: list[TriangleMesh]) -> NDArray[np.float32]:
    """Distance of the nearest vertex of each part to the rest."""
    _, away = distances(rest, np.concatenate([p.vertices for p in parts]))
    start = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
    return np.minimum.reduceat(away, start)
