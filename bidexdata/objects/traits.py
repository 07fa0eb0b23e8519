"""What a selection of objects looks at: proportions, walls, parts, holes, and the shape itself."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .components import components
from .physics import mass_properties, thickness
from .prepared import TriangleMesh

DESCRIPTOR_POINTS = 1000
"""Points whose distances make the descriptor: 499,500 pairs."""
QUANTILES = 48
"""Numbers of the descriptor that tell of distances; three more are of the inertia."""
_HASH_GRID = 1e-4
"""Spacing of the grid to which vertices are rounded for the hash, as a share of the diagonal."""


class Traits(NamedTuple):
    """Of a closed mesh of unit diagonal."""

    aspect: float
    """Longest over shortest extent along the principal axes of inertia [-]."""
    thickness: float
    """Mean thickness of the walls, 2 volume / area, as a share of the diagonal [-]."""
    components: int
    """Bodies that do not touch; cavities are none."""
    genus: int
    """Handles and through holes, of all bodies together."""


def traits(mesh: TriangleMesh) -> Traits:
    """Measure a closed, oriented mesh."""
    axes = np.linalg.eigh(mass_properties(mesh).inertia)[1]
    extent = np.ptp(mesh.vertices @ axes, axis=0)
    volumes = np.array([mass_properties(part).volume for part in components(mesh)])
    # Euler: V - E + F = 2 (surfaces) - 2 (handles), and a closed mesh has 3 edges per 2 faces.
    euler = len(np.unique(mesh.faces)) - len(mesh.faces) // 2
    return Traits(
        aspect=float(extent.max() / max(extent.min(), 1e-12)),
        thickness=thickness(mesh),
        components=int((volumes > 0).sum()),
        genus=len(volumes) - euler // 2,
    )


def descriptor(points: NDArray[np.floating], mesh: TriangleMesh) -> NDArray[np.float64]:
    """Describe a shape, whatever its place, size, rotation and triangles, (QUANTILES + 3,).

    Quantiles of the distances between points of the surface in units of their root mean square
    (the shape distribution D2 of Osada et al., 2002), then the principal moments of inertia as
    shares of their sum. A mirror image has the same.

    Args:
        points: Points on the surface in farthest-point order, (P, 3).
        mesh: The closed surface.
    """
    few = np.asarray(points[:DESCRIPTOR_POINTS], np.float64)
    first, second = np.triu_indices(len(few), 1)
    distances = np.linalg.norm(few[first] - few[second], axis=1)
    distances /= np.sqrt(np.mean(distances**2))
    levels = (np.arange(QUANTILES) + 0.5) / QUANTILES
    moments = np.linalg.eigvalsh(mass_properties(mesh).inertia)
    return np.concatenate([np.quantile(distances, levels), moments / moments.sum()])


def unlikeness(one: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean difference of descriptors (D,) and (N, D), (N,): 0 for the same shape."""
    return np.abs(others - one).mean(axis=1)


def mesh_hash(mesh: TriangleMesh) -> str:
    """Hash a mesh whatever its file type, place, size and order of vertices and faces."""
    used = mesh.vertices[np.unique(mesh.faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    scaled = (used - low) / max(float(np.linalg.norm(high - low)), 1e-300)
    grid = np.unique(np.round(scaled / _HASH_GRID).astype(np.int64), axis=0)
    digest = hashlib.sha256(f"{len(grid)} {len(mesh.faces)}\n".encode())
    digest.update(grid.astype("<i8").tobytes())
    return digest.hexdigest()
