"""The network of the relative diffusion: both hands as two tokens that see the object."""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from bidexgrasp_model.config import ModelConfig
from bidexgrasp_model.layers import Slots, attend, pointwise
from bidexgrasp_model.local import Frames, Memory

SITUATION = 14
"""Numbers that say where a hand's anchor stands: see `situation`."""


class Keys(NamedTuple):
    """Keys and values of one block, per frame."""

    key: Float[Tensor, "F M D"]
    value: Float[Tensor, "F M D"]


class Block(nn.Module):
    """Hands look at each other, then at the object, then think; each step set by time and place."""

    def __init__(self, config: ModelConfig):
        super().__init__()
        D = config.width
        self.heads = config.heads
        self.shift = nn.Linear(D, 6 * D)
        self.both, self.both_out = nn.Linear(D, 3 * D), nn.Linear(D, D)
        self.query, self.seen_out = nn.Linear(D, D), nn.Linear(D, D)
        self.shared, self.place, self.own = (
            nn.Linear(D, 2 * D),
            nn.Linear(27, 2 * D),
            nn.Linear(D, 2 * D),
        )
        self.think = pointwise((D, 2 * D, D))

    def keys(self, memory: Memory, frames: Frames) -> Keys:
        """Keys and values of the object: they depend on neither time nor grasp."""
        far = self.shared(memory.shared)[frames.cloud] + self.place(memory.place)
        key, value = torch.cat([far, self.own(memory.own)], dim=1).chunk(2, dim=-1)
        return Keys(key, value)

    def forward(
        self,
        hands: Float[Tensor, "n 2 D"],
        setting: Float[Tensor, "n 2 D"],
        keys: Keys,
        slots: Slots,
    ) -> Float[Tensor, "n 2 D"]:
        """One step of all three."""
        scale = self.shift(setting).chunk(6, dim=-1)

        def norm(k: int) -> Tensor:
            plain = nn.functional.layer_norm(hands, hands.shape[-1:])  # hands as they are by then
            return plain * (1 + scale[2 * k]) + scale[2 * k + 1]

        query, key, value = self.both(norm(0)).chunk(3, dim=-1)
        hands = hands + self.both_out(attend(query, key, value, self.heads))
        query = slots.padded(self.query(norm(1)).flatten(0, 1))
        seen = slots.flat(attend(query, keys.key, keys.value, self.heads))
        hands = hands + self.seen_out(seen).reshape(hands.shape)
        return hands + self.think(norm(2))


class Denoiser(nn.Module):
    """Predict v of noisy states (`diffusion.py` says what v is).

    Source:
        BiDexGrasp, 5.2, relative dexterous grasp diffusion; the network is open there. Two tokens
        that attend to each other and to the object: facts, 2.
    """

    def __init__(self, config: ModelConfig, state: int, steps: int):
        super().__init__()
        D = config.width
        self.steps = steps
        self.enter = nn.Linear(state, D)
        self.hand = nn.Parameter(torch.randn(2, D) * 0.02)
        self.time = pointwise((64, D, D))
        self.situation = pointwise((SITUATION, D, D))
        self.blocks = nn.ModuleList(Block(config) for _ in range(config.layers))
        self.norm = nn.LayerNorm(D)
        self.leave = nn.Linear(D, state)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def keys(self, memory: Memory, frames: Frames) -> list[Keys]:
        """Keys and values of every block, to be computed once per batch of clouds."""
        return [cast("Block", block).keys(memory, frames) for block in self.blocks]

    def forward(
        self,
        state: Float[Tensor, "n 2 D"],
        t: Int[Tensor, " n"],
        situation: Float[Tensor, "n 2 S"],
        keys: list[Keys],
        slots: Slots,
    ) -> Float[Tensor, "n 2 D"]:
        """Predict.

        Args:
            state: Noisy, normalised.
            t: Noise level, 1 to T.
            situation: From `situation`.
            keys: From `keys`.
            slots: Which frame each hand of each grasp attends to.
        """
        time = self.time(time_waves(t / self.steps))[:, None]
        setting = nn.functional.gelu(time + self.situation(situation) + self.hand)
        hands = self.enter(state) + self.hand
        for block, one in zip(self.blocks, keys, strict=True):
            hands = block(hands, setting, one, slots)
        return self.leave(self.norm(hands))


def time_waves(t: Float[Tensor, " n"]) -> Float[Tensor, "n 64"]:
    """Sines and cosines of a time in [0, 1]."""
    rate = torch.exp(torch.linspace(0, 6.9, 32, device=t.device))
    angle = t[:, None] * rate
    return torch.cat([angle.sin(), angle.cos()], dim=-1)


def situation(
    frames: Frames,
    index: Int[Tensor, "n 2"],
    radius: Float[Tensor, " B"],
    height: Float[Tensor, " B"],
) -> Float[Tensor, "n 2 S"]:
    """Where each hand's anchor stands, and where the other hand's is from there.

    Args:
        frames: Anchors, relative to the spheres' centres.
        index: Frame of the left and the right hand of each grasp.
        radius: Of the bounding spheres [m].
        height: Of their centres over z = 0, the table where there is one [m].

    Returns:
        Radius, height of centre and anchor, elevation of the view, position and first two axes of
        the other anchor in this one, and whether both hands have the same view.
    """
    rot, pos = frames.anchor.rot[index], frames.anchor.pos[index]
    other = index.flip(1)
    back = rot.transpose(-1, -2)
    between = (back @ (frames.anchor.pos[other] - pos)[..., None]).squeeze(-1)
    turn = (back @ frames.anchor.rot[other])[..., :2].transpose(-1, -2).flatten(-2)
    cloud = frames.cloud[index]
    r, h = radius[cloud], height[cloud]
    own = torch.stack([r / 0.2, h / 0.2, (h + pos[..., 2]) / 0.2, rot[..., 2, 0]], dim=-1)
    same = (frames.view[index] == frames.view[other]).float()[..., None]
    return torch.cat([own, between / 0.2, turn, same], dim=-1)
