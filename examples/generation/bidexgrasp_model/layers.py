"""Small parts that several modules share: point-wise networks, grouping, attention by frame."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn


def pointwise(widths: Sequence[int]) -> nn.Sequential:
    """A network applied to each point: linear layers with GELU between them."""
    layers: list[nn.Module] = []
    for k, (a, b) in enumerate(itertools.pairwise(widths)):
        if k:
            layers.append(nn.GELU())
        layers.append(nn.Linear(a, b))
    return nn.Sequential(*layers)


def gathered(
    values: Float[Tensor, "B P C"], index: Int[Tensor, "B A N"]
) -> Float[Tensor, "B A N C"]:
    """Values of the points of groups."""
    B, A, N = index.shape
    flat = index.reshape(B, A * N, 1).expand(-1, -1, values.shape[-1])
    return values.gather(1, flat).reshape(B, A, N, values.shape[-1])


def waves(points: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 27"]:
    """Positions [m] and their sines and cosines of wave lengths 1.6, 0.8, 0.4 and 0.2 m."""
    angles = [points * (2 * torch.pi / length) for length in (1.6, 0.8, 0.4, 0.2)]
    return torch.cat([points / 0.2, *(f(a) for a in angles for f in (torch.sin, torch.cos))], -1)


def attend(
    query: Float[Tensor, "B Q D"],
    key: Float[Tensor, "B M D"],
    value: Float[Tensor, "B M D"],
    heads: int,
) -> Float[Tensor, "B Q D"]:
    """Scaled dot-product attention of several heads."""
    q, k, v = (t.unflatten(-1, (heads, -1)).transpose(1, 2) for t in (query, key, value))
    out = nn.functional.scaled_dot_product_attention(q, k, v)
    return out.transpose(1, 2).flatten(2)


class Slots:
    """Queries sorted by the memory that they attend to, in padded rows.

    Many hands share a frame, so keys and values are there once per frame, and the queries of a
    frame lie side by side.
    """

    def __init__(self, frame: Int[Tensor, " n"], frames: int):
        """Deal out places.

        Args:
            frame: Which frame each query belongs to.
            frames: Number of frames.
        """
        order = frame.argsort(stable=True)
        counts = torch.bincount(frame, minlength=frames)
        starts = counts.cumsum(0) - counts
        rank = torch.empty_like(frame)
        rank[order] = torch.arange(len(frame), device=frame.device) - starts[frame[order]]
        self.width = int(counts.max()) if len(frame) else 0
        self.frames, self.place = frames, frame * self.width + rank

    def padded(self, query: Float[Tensor, "n D"]) -> Float[Tensor, "F Q D"]:
        """Put queries in their rows; places without one are zero."""
        rows = query.new_zeros(self.frames * self.width, query.shape[-1])
        return rows.index_copy(0, self.place, query).unflatten(0, (self.frames, self.width))

    def flat(self, rows: Float[Tensor, "F Q D"]) -> Float[Tensor, "n D"]:
        """Take them out again."""
        return rows.flatten(0, 1)[self.place]
