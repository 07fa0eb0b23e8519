"""The bimanual coordination module: scores of views, and of pairs of views."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from bidexgrasp_model.anchors import anchor_axes
from bidexgrasp_model.config import ModelConfig
from bidexgrasp_model.encoder import Features
from bidexgrasp_model.layers import attend, pointwise, waves


class ViewScores(NamedTuple):
    """What the module says of B clouds."""

    single: Float[Tensor, "B 2 K"]
    """p_i, of the left and of the right hand."""
    pair: Float[Tensor, "B K K"]
    """p_bi: rows are views of the right hand, which is primary, columns those of the left."""
    features: Float[Tensor, "B K D"]
    """f_i."""


class Coordination(nn.Module):
    """View features by cross-attention, and what is read from them.

    The features that a view attends to carry their positions in the view's own frame, so that the
    same object seen from a turned view looks the same (ours: it takes the place of learning every
    direction from data of its own).

    Source:
        BiDexGrasp, 5.1.
    """

    def __init__(self, config: ModelConfig):
        super().__init__()
        D = config.width
        self.heads = config.heads
        self.embedding = nn.Parameter(torch.randn(config.views, D) * 0.5)
        self.query = nn.Linear(D, D)
        self.key, self.value = nn.Linear(D, D), nn.Linear(D, D)
        self.key_place, self.value_place = nn.Linear(27, D), nn.Linear(27, D)
        self.out = pointwise((D, 2 * D, D))
        self.norm = nn.LayerNorm(D)
        self.single = pointwise((D, D // 2, 2))
        self.pair = pointwise((4 * D, D // 2, 1))

    def forward(self, features: Features, views: Float[Tensor, "K 3"]) -> ViewScores:
        """Score the views of each cloud."""
        f = self.view_features(features, views)
        return ViewScores(self.single(f).transpose(1, 2), self.pair_scores(f), f)

    def view_features(
        self, features: Features, views: Float[Tensor, "K 3"]
    ) -> Float[Tensor, "B K D"]:
        """f_i = Attn(v_emb_i, F_global, F_global)."""
        B, C, D = features.tokens.shape
        K = len(views)
        axes = anchor_axes(views.to(features.far))
        place = waves(torch.einsum("bcx,kxy->bkcy", features.far, axes))
        key = self.key(features.tokens)[:, None] + self.key_place(place)
        value = self.value(features.tokens)[:, None] + self.value_place(place)
        query = self.query(self.embedding).expand(B, K, D).reshape(B * K, 1, D)
        found = attend(query, key.reshape(B * K, C, D), value.reshape(B * K, C, D), self.heads)
        # With its own embedding: in its own frame a view does not know where the others are.
        found = found.reshape(B, K, D) + self.embedding
        return self.norm(found + self.out(found))

    def pair_scores(self, f: Float[Tensor, "B K D"]) -> Float[Tensor, "B K K"]:
        """f_bi(i, j) = MLP(cat(f_i, f_j, f_i - f_j, f_i * f_j)), and the score read from it."""
        K = f.shape[1]
        a = f[:, :, None].expand(-1, -1, K, -1)
        b = f[:, None].expand(-1, K, -1, -1)
        return self.pair(torch.cat([a, b, a - b, a * b], -1)).squeeze(-1)
