"""Surfaces that grasps are fitted to: points with outward normals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from bidexdata import Library, Release
from bidexdata.loaders import normals_on
from bidexgrasp_model.places import Place, library_clouds, release_clouds
from bidexgrasp_model.rotations import matrix_from_quat

POINTS = 2048
"""Of a surface, at most. Ours: twice what the network sees, for pads are small."""
_NEIGHBOURS = 12
"""Points that a normal is estimated from. Ours."""


class Surface(NamedTuple):
    """What of some objects is known, in the world."""

    points: Float[Tensor, "B Q 3"]
    """[m]."""
    normals: Float[Tensor, "B Q 3"]
    table: Float[Tensor, " B"]
    """Height of the table [m]; minus infinity where the object floats."""

    def of(self, index: slice | Tensor) -> Surface:
        """That of some of them."""
        return Surface(self.points[index], self.normals[index], self.table[index])


def known_surface(source: Release | Library, places: Sequence[Place]) -> Surface:
    """The surface of prepared objects, normals from their convex pieces."""
    if isinstance(source, Release):
        points = min(POINTS, source.cloud("cloud_solid").shape[1])
        clouds = release_clouds(source, places, points)
    else:
        clouds = library_clouds(source, places, POINTS)
    found = []
    for place, cloud in zip(places, clouds.double(), strict=True):
        R = matrix_from_quat(torch.tensor(place.quat_wxyz, dtype=torch.float64))
        unit = (cloud - torch.tensor(place.pos, dtype=torch.float64)) @ R / place.size
        normals = normals_on(unit.numpy(), source.load_solid(place.object_id).pieces)
        found.append(torch.from_numpy(np.asarray(normals, np.float64)) @ R.T)
    return Surface(clouds, torch.stack(found).float(), tables_under(places))


def tables_under(places: Sequence[Place]) -> Float[Tensor, " B"]:
    """Heights of the tables of scenes [m]."""
    return torch.tensor([0.0 if p.on_table else -torch.inf for p in places])


def estimated_surface(clouds: Float[Tensor, "B P 3"], table: Float[Tensor, " B"]) -> Surface:
    """The surface of measured clouds: normals across each point's neighbours, pointing outward.

    Outward is away from the middle of the cloud, which is right of most points of most objects
    and wrong inside of a bowl.

    Args:
        clouds: World [m].
        table: From `tables_under`.
    """
    count = min(_NEIGHBOURS, clouds.shape[1])
    normals = []
    for cloud in clouds:
        index = torch.cdist(cloud, cloud).topk(count, dim=-1, largest=False).indices
        off = cloud[index] - cloud[index].mean(1, keepdim=True)
        across = torch.linalg.eigh((off.transpose(1, 2) @ off).double()).eigenvectors[..., 0]
        middle = (cloud.amin(0) + cloud.amax(0)) / 2
        inward = (across * (cloud - middle)).sum(-1, keepdim=True) < 0
        normals.append(torch.where(inward, -across, across).float())
    return Surface(clouds, torch.stack(normals), table)
