"""The geometry-adaptive feature: what of the object lies near an anchor, seen from the anchor."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from bidexgrasp_model.anchors import Anchor
from bidexgrasp_model.config import ModelConfig
from bidexgrasp_model.coordination import ViewScores
from bidexgrasp_model.encoder import REACH, Features
from bidexgrasp_model.layers import gathered, pointwise, waves
from bidexgrasp_model.tables import Tables, nearest


class Frames(NamedTuple):
    """Anchors that grasps of a batch use: each cloud and view once. Leading axis F."""

    cloud: Int[Tensor, " F"]
    """Which cloud."""
    view: Int[Tensor, " F"]
    """Which view."""
    anchor: Anchor
    """The frame that poses are relative to."""
    point: Float[Tensor, "F 3"]
    """Where the view meets the bounding sphere [m], world."""


class Memory(NamedTuple):
    """Tokens that a hand attends to: F_ga-obj = Concat(F_local, F_view, F_global). F frames."""

    shared: Float[Tensor, "B C D"]
    """F_global, the same for all frames of a cloud."""
    place: Float[Tensor, "F C 27"]
    """Where these are, in the frame."""
    own: Float[Tensor, "F M D"]
    """F_local and F_view of the frame."""


class LocalFeature(nn.Module):
    """Groups of points around the K_c of the K_p points that are nearest to the anchor.

    Source:
        BiDexGrasp, 5.2, geometry-adaptive object feature. Positions are given in the anchor's
        frame (ours), so equal surroundings of equal anchors are equal inputs.
    """

    def __init__(self, config: ModelConfig):
        super().__init__()
        self.count, width = config.local, config.width
        self.points = pointwise((4, 32, 64))
        self.token = nn.Linear(64 + 27, width)
        self.norm = nn.LayerNorm(width)

    def forward(
        self, features: Features, points: Float[Tensor, "B P 3"], tables: Tables, frames: Frames
    ) -> Float[Tensor, "F N D"]:
        """F_local.

        Args:
            features: Of the clouds.
            points: The clouds [m], world, relative to the spheres' centres.
            tables: Of the clouds.
            frames: Anchors, with positions relative to the spheres' centres too.
        """
        near = features.near[frames.cloud]
        chosen = nearest(frames.point[:, None], near, self.count).squeeze(1)
        centres = near.gather(1, chosen[..., None].expand(-1, -1, 3))
        N = tables.first.shape[2]
        groups = tables.first[frames.cloud].gather(1, chosen[..., None].expand(-1, -1, N))
        around = gathered(points[frames.cloud], groups) - centres[:, :, None]
        seen = torch.einsum("fanx,fxy->fany", around, frames.anchor.rot) / REACH
        spread = seen.norm(dim=-1, keepdim=True)
        inner = self.points(torch.cat([seen, spread], -1)).max(dim=2).values
        return self.norm(self.token(torch.cat([inner, waves(placed(centres, frames.anchor))], -1)))


def placed(points: Float[Tensor, "F C 3"], anchor: Anchor) -> Float[Tensor, "F C 3"]:
    """Points in the frames of anchors [m]."""
    return torch.einsum("fcx,fxy->fcy", points - anchor.pos[:, None], anchor.rot)


def object_memory(
    features: Features,
    scores: ViewScores | None,
    local: Float[Tensor, "F N D"] | None,
    frames: Frames,
) -> Memory:
    """Put together what the model has of the three features.

    Source:
        BiDexGrasp, 5.2: F_ga-obj = Concat(F_local, F_view, F_global) along the tokens.
    """
    parts = [] if local is None else [local]
    if scores is not None:
        parts.append(scores.features[frames.cloud, frames.view][:, None])
    none = features.tokens.new_zeros(len(frames.cloud), 0, features.tokens.shape[-1])
    place = waves(placed(features.far[frames.cloud], frames.anchor))
    return Memory(features.tokens, place, torch.cat(parts, dim=1) if parts else none)
