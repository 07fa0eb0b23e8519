"""Sampled grasps made to fit the surface: a few steps down the paper's physics losses.

The network puts hands within a centimetre or two of where they belong; what is left is that pads
hang in the air or in the object. The losses that training uses say which way to go. Ours: the
paper samples without.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from bidexgrasp_model.anchors import Anchor
from bidexgrasp_model.checkpoint import HandId
from bidexgrasp_model.config import RefineConfig
from bidexgrasp_model.hand_shape import HandShapes, Shape
from bidexgrasp_model.losses import bounding_point, nearest_point
from bidexgrasp_model.state import GRASP, PREGRASP, Layout, Scale, decode
from bidexgrasp_model.surfaces import Surface

_NEAR = 256
"""Points of the surface around each hand that its points are compared with. Ours."""
_SEARCH = 10
"""Steps between two searches for the nearest points. Ours."""
_FAR = 0.06
"""Points farther from all of the surface are not told inside from outside [m]. Ours."""
_PAIRS = 64
"""Pairs of key points, those closest to each other, that self-penetration is taken of. Ours."""
_METRES = 100.0
"""A centimetre off counts as one spread of the training data off. Ours."""


Choice = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Of points, a cloud and its normals: which point of the cloud each point is compared with."""


class Planes(NamedTuple):
    """Tangent planes of the surface, one for each of some points of a hand."""

    at: Float[Tensor, "n P 3"]
    normal: Float[Tensor, "n P 3"]

    def height(self, points: Float[Tensor, "n P 3"]) -> Float[Tensor, "n P"]:
        """Signed distance to them, positive outside [m]."""
        return ((points - self.at) * self.normal).sum(-1)

    def aside(self, points: Float[Tensor, "n P 3"]) -> Float[Tensor, "n P"]:
        """Distance along them from where they touch [m]."""
        off = points - self.at
        along = off - (off * self.normal).sum(-1, keepdim=True) * self.normal
        return (along.square().sum(-1) + 1e-12).sqrt()


class Close(NamedTuple):
    """What is near what, searched for every few steps."""

    keys: Planes
    """That bound the solid at the key points, of grasps, then of pre-grasps."""
    pads: Planes
    """That bound it at the pads, of grasps."""
    beside: Planes
    """Of the nearest points to the pads, of grasps."""
    pairs: Int[Tensor, "m N"]
    """Which pairs of key points."""


def refined(
    state: Float[Tensor, "n H D"],
    anchor: Anchor,
    surface: Surface,
    hands: HandShapes,
    limits: HandId,
    scale: Scale,
    config: RefineConfig,
) -> tuple[Float[Tensor, "n H D"], Float[Tensor, " n"]]:
    """Move normalised states so that pads touch and nothing overlaps.

    Args:
        state: As the diffusion left them; the squeeze's numbers stay, so it moves along.
        anchor: Of the hands.
        surface: Of the object of each, leading axis n.
        hands: Their kinematics.
        limits: Of the joints.
        scale: Statistics of the states.
        config: Steps and weights.

    Returns:
        The states, and what is left of gaps and overlaps: less is better.
    """
    layout = Layout(limits.joints)
    free = 9 + layout.joints + 6 + layout.joints  # grasp and pre-grasp
    start = state[..., :free].detach()
    reach = torch.ones(free).to(start)
    reach[9 + layout.joints :] = config.reach
    moved = torch.zeros_like(start).requires_grad_(True)
    adam = torch.optim.Adam([moved], lr=config.rate, betas=(0.9, 0.95))
    close: Close | None = None
    with torch.enable_grad():
        for step in range(config.steps):
            for group in adam.param_groups:
                group["lr"] = config.rate * (1 - 0.8 * step / config.steps)
            whole = torch.cat([start + reach * moved, state[..., free:]], dim=-1)
            shape = _shape(scale.restored(whole), anchor, layout, hands, limits)
            if step % _SEARCH == 0:
                close = _search(shape, surface, hands)
            assert close is not None
            off = moved.square().sum((-1, -2))
            physics = _physics(shape, close, surface.table, hands, config)
            loss = _METRES * physics + config.stay * off
            adam.zero_grad()
            loss.sum().backward()
            adam.step()
    with torch.no_grad():
        found = torch.cat([start + reach * moved, state[..., free:]], dim=-1)
        shape = _shape(scale.restored(found), anchor, layout, hands, limits)
        left = _physics(shape, _search(shape, surface, hands), surface.table, hands, config)
    return found, left


def _shape(
    state: Float[Tensor, "n H D"], anchor: Anchor, layout: Layout, hands: HandShapes, limits: HandId
) -> Shape:
    """Both hands of all grasps, then of all pre-grasps, joints within limits.

    A pre-grasp is relative to its grasp, but what it wants moves its own numbers alone: fingers
    that open into the object are no reason to take the grasp off it.
    """
    own = 9 + layout.joints
    behind = torch.cat([state[..., :own].detach(), state[..., own:]], dim=-1)
    both = [(decode(state, anchor, layout), GRASP), (decode(behind, anchor, layout), PREGRASP)]
    parts = [
        (p.pos[:, :, stage], p.rot[:, :, stage], limits.within(p.joints)[:, :, stage])
        for p, stage in both
    ]
    return hands(*(torch.cat(columns) for columns in zip(*parts, strict=True)))


def _physics(
    shape: Shape,
    close: Close,
    table: Float[Tensor, " n"],
    hands: HandShapes,
    config: RefineConfig,
) -> Float[Tensor, " n"]:
    """Gaps of pads, and depths in the object, in the table and of hands in hands.

    Source:
        BiDexGrasp, appendix C: contact, hand-object and self-penetration loss; depths squared
        (ours), so that one deep point counts more than many shallow ones.
    """
    n = len(close.pads.at)
    pads = shape.pads[:n]
    aside = (close.beside.aside(pads) - config.slack).clamp(min=0)
    gap = close.pads.height(pads).abs() + 0.3 * aside
    gap = torch.where(gap.detach() < config.within, gap, torch.zeros_like(gap)).mean(-1)
    clear = torch.zeros(2 * n, 1).to(gap)
    clear[n:] = config.clear
    height = close.keys.height(shape.keys) - hands.radius
    known = (shape.keys - close.keys.at).detach().square().sum(-1) < _FAR**2
    depth = torch.where(known, (clear - height).clamp(0, 0.05), torch.zeros_like(height))
    lowest = shape.keys[..., 2] - hands.radius
    below = (table.repeat(2)[:, None] + 0.2 * clear - lowest).clamp(min=0)
    both = hands.pairs[close.pairs]
    ends = [shape.keys.gather(1, both[..., k, None].expand(-1, -1, 3)) for k in (0, 1)]
    apart = ((ends[0] - ends[1]).square().sum(-1) + 1e-12).sqrt()
    within = (hands.least[close.pairs] - apart).clamp(min=0)
    overlap = (
        config.object * depth.square().mean(-1)
        + config.table * below.square().mean(-1)
        + config.self * within.square().sum(-1)
    )
    return config.contact * gap + overlap[:n] + overlap[n:]


@torch.no_grad()
def _search(shape: Shape, surface: Surface, hands: HandShapes) -> Close:
    n = len(surface.points)
    halves = [_nearby(shape.pads[:n], surface, h) for h in range(2)]
    keys = [_planes(part, halves, bounding_point) for part in (shape.keys[:n], shape.keys[n:])]
    pads = shape.pads[:n]
    return Close(
        Planes(*(torch.cat(parts) for parts in zip(*keys, strict=True))),
        _planes(pads, halves, bounding_point),
        _planes(pads, halves, lambda points, cloud, _: nearest_point(points, cloud)),
        _closest_pairs(shape.keys, hands),
    )


def _closest_pairs(keys: Float[Tensor, "n K 3"], hands: HandShapes) -> Int[Tensor, "n M"]:
    """Numbers of the pairs of key points with the smallest gaps."""
    lengths = keys.square().sum(-1)
    products = (keys @ keys.transpose(1, 2)).flatten(1)
    first, second = hands.pairs.unbind(1)
    squared = products.index_select(1, first * keys.shape[1] + second).mul_(-2)
    squared += lengths.index_select(1, first)
    squared += lengths.index_select(1, second)
    gap = squared.clamp_(min=0).sqrt_().sub_(hands.least)
    return gap.topk(min(_PAIRS, gap.shape[1]), dim=1, largest=False, sorted=False).indices


def _nearby(pads: Float[Tensor, "n C 3"], surface: Surface, hand: int) -> Surface:
    """The points of the surface around one hand."""
    middle = pads.chunk(2, dim=1)[hand].mean(1, keepdim=True)
    count = min(_NEAR, surface.points.shape[1])
    squared = (surface.points - middle).square().sum(-1)
    index = squared.topk(count, dim=1, largest=False, sorted=False).indices
    wide = index[..., None].expand(-1, -1, 3)
    return Surface(surface.points.gather(1, wide), surface.normals.gather(1, wide), surface.table)


def _planes(points: Float[Tensor, "n P 3"], halves: list[Surface], choose: Choice) -> Planes:
    """Planes for points, the first half of which is the left hand's."""
    found = []
    for part, known in zip(points.chunk(2, dim=1), halves, strict=True):
        index = choose(part, known.points, known.normals)[..., None].expand(-1, -1, 3)
        found.append((known.points.gather(1, index), known.normals.gather(1, index)))
    return Planes(*(torch.cat(parts, dim=1) for parts in zip(*found, strict=True)))
