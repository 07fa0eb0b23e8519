"""The global feature: PointNet++ on the cloud, with the neighbours looked up in a table."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from bidexgrasp_model.config import ModelConfig
from bidexgrasp_model.layers import gathered, pointwise
from bidexgrasp_model.tables import Tables

REACH = 0.05
"""Unit of positions within a group [m]. Ours: the group's radius on a cloud of 0.4 m."""
_INNER = (32, 64)


class Features(NamedTuple):
    """What the encoder makes of B clouds."""

    near: Float[Tensor, "B A 3"]
    """Positions of the first centres [m], world, relative to the sphere's centre."""
    far: Float[Tensor, "B C 3"]
    """Positions of the second centres."""
    tokens: Float[Tensor, "B C D"]
    """F_global: features of the second centres."""


class Encoder(nn.Module):
    """Two set abstractions.

    Source:
        BiDexGrasp, 5.1, names PointNet++ (Qi et al., 2017) without sizes; those are in
        `ModelConfig`.
    """

    def __init__(self, config: ModelConfig):
        super().__init__()
        self.first = pointwise((7, *_INNER))
        self.second = pointwise((_INNER[-1] + 3, config.width, config.width))
        self.norm = nn.LayerNorm(config.width)

    def forward(
        self,
        points: Float[Tensor, "B P 3"],
        radius: Float[Tensor, " B"],
        tables: Tables,
    ) -> Features:
        """Encode clouds.

        Args:
            points: In farthest-point order, relative to the bounding spheres' centres [m], world
                axes.
            radius: Of the spheres [m].
            tables: Of these clouds.
        """
        near = points[:, : tables.first.shape[1]]
        far = near[:, : tables.second.shape[1]]
        group = grouped(points, near, tables.first)
        where = (near / radius[:, None, None])[:, :, None].expand(-1, -1, group.shape[2], -1)
        size = radius[:, None, None, None].expand(*group.shape[:3], 1)
        inner = self.first(torch.cat([group, where, size], -1)).max(dim=2).values
        around = grouped(near, far, tables.second)
        outer = torch.cat([gathered(inner, tables.second), around], -1)
        return Features(near, far, self.norm(self.second(outer).max(dim=2).values))


def grouped(
    points: Float[Tensor, "B P 3"], centres: Float[Tensor, "B A 3"], index: Int[Tensor, "B A N"]
) -> Float[Tensor, "B A N 3"]:
    """Positions within groups, relative to their centres, in units of `REACH`."""
    return (gathered(points, index) - centres[:, :, None]) / REACH
