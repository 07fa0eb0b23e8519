"""Candidate views: K fixed directions from which hands may come, and which is nearest to a hand."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

GOLDEN = (1 + 5**0.5) / 2


def candidate_views(count: int) -> Float[Tensor, "K 3"]:
    """Unit vectors that point from the upper hemisphere to its centre, spread evenly by area.

    The paper draws them uniformly; a spiral is as uniform and needs no seed.

    Args:
        count: K.

    Source:
        BiDexGrasp, appendix C, grasp view.
    """
    k = torch.arange(count, dtype=torch.float64)
    z = (k + 0.5) / count  # equal areas of the sphere lie between equal heights
    angle = 2 * torch.pi * k / GOLDEN
    flat = (1 - z * z).sqrt()
    outward = torch.stack([flat * angle.cos(), flat * angle.sin(), z], dim=-1)
    return (-outward).float()


def nearest_view(
    hand_pos: Float[Tensor, "*b 3"], centre: Float[Tensor, "*b 3"], views: Float[Tensor, "K 3"]
) -> Int[Tensor, "*b"]:
    """Number of the view whose direction is nearest to that from the hand to the centre.

    Args:
        hand_pos: Wrists [m].
        centre: Centre of the object's bounding sphere [m], in the same frame.
        views: From `candidate_views`.

    Source:
        BiDexGrasp, 5.1: every grasp is assigned to the nearest candidate view.
    """
    toward = torch.nn.functional.normalize(centre - hand_pos, dim=-1)
    return (toward @ views.to(toward).T).argmax(dim=-1)


def view_labels(
    view: Int[Tensor, "G 2"], count: int
) -> tuple[Float[Tensor, "2 K"], Float[Tensor, "K K"]]:
    """How often views and pairs of views occur among the grasps of a case.

    The paper does not say which hand is primary. Here it is the right one: rows of y_bi are its
    views, columns those of the left, and y holds a distribution per hand, left first. The mirror
    image of a case gives the other order.

    Args:
        view: Nearest view of the left and the right hand of each grasp.
        count: K.

    Returns:
        y, each hand's counts over their sum; y_bi, counts of (right, left) over all pairs.

    Source:
        BiDexGrasp, 5.1.
    """
    total = max(len(view), 1)
    ones = torch.ones(len(view))
    y = torch.zeros(2, count)
    for hand in range(2):
        y[hand].index_add_(0, view[:, hand].cpu(), ones)
    pair = torch.zeros(count * count).index_add_(0, (view[:, 1] * count + view[:, 0]).cpu(), ones)
    return y / total, pair.reshape(count, count) / total
