"""Which views the hands take: drawn from the scores of the coordination module."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from bidexgrasp_model.config import Coordination, DiffusionConfig
from bidexgrasp_model.coordination import ViewScores


def draw_views(
    scores: ViewScores,
    cloud: Int[Tensor, " n"],
    coordination: Coordination,
    config: DiffusionConfig,
    generator: torch.Generator | None = None,
) -> Int[Tensor, "n 2"]:
    """Draw the views of the left and the right hand of n grasps.

    Args:
        scores: Of B clouds.
        cloud: Which of them each grasp is of.
        coordination: `pair`: the right hand's view, then the left's given it (the paper); `direct`:
            both at once from the scores of pairs; `single`: each hand by itself.
        config: Number of views drawn from, and temperature.
        generator: Of the draws.

    Source:
        BiDexGrasp, appendix C, selection of grasp view; `direct` is its further ablation.
    """
    K = scores.single.shape[-1]
    if coordination == "direct":
        both = top_draw(scores.pair[cloud].flatten(1), config, generator)
        return torch.stack([both % K, both // K], dim=-1)
    right = top_draw(scores.single[cloud, 1], config, generator)
    if coordination == "single":
        return torch.stack([top_draw(scores.single[cloud, 0], config, generator), right], dim=-1)
    row = scores.pair[cloud, right]
    if config.row_share:
        row = row / row.clamp(min=0).sum(-1, keepdim=True).clamp(min=1e-6)
    return torch.stack([top_draw(row, config, generator), right], dim=-1)


def top_draw(
    score: Float[Tensor, "n M"], config: DiffusionConfig, generator: torch.Generator | None = None
) -> Int[Tensor, " n"]:
    """Draw by the softmax of the best k scores over the temperature.

    Source:
        BiDexGrasp, appendix C: k = 5, temperature 0.1.
    """
    best, number = score.float().topk(min(config.top, score.shape[-1]), dim=-1)
    chance = (best / config.temperature).softmax(dim=-1)
    pick = torch.multinomial(chance.cpu(), 1, generator=generator).to(number.device)
    return number.gather(-1, pick).squeeze(-1)
