"""Both hands' surfaces, pads and key points from states, through the package's torch hand layer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from bidexdata import HandModel, load_hand

SIDES = ("left", "right")


class Shape(NamedTuple):
    """What two hands look like at the grasp, in the world."""

    surface: Float[Tensor, "n P 3"]
    """Points on the collision spheres of both [m]."""
    pads: Float[Tensor, "n C 3"]
    """Outermost points of the contact pads of both [m]."""
    keys: Float[Tensor, "n K 3"]
    """Centres of the collision spheres of both [m]."""


class HandShapes(torch.nn.Module):
    """Forward kinematics of two hands."""

    def __init__(self, models: Sequence[HandModel]):
        """Take the hands, left first."""
        super().__init__()
        self.models = list(models)
        hands = [model.hand for model in self.models]
        self.counts = [len(hand.joint_names) for hand in hands]
        pairs, least = _pairs(hands)
        self.pairs: Int[Tensor, "M 2"]
        self.least: Float[Tensor, " M"]
        self.radius: Float[Tensor, " K"]
        self.register_buffer("pairs", pairs)
        self.register_buffer("least", least)
        radius = np.concatenate([hand.sphere_radius for hand in hands]).astype(np.float32)
        self.register_buffer("radius", torch.from_numpy(radius))

    @classmethod
    def of_release(cls, release: str | Path, surface_points: int) -> HandShapes:
        """Open the hands of a release; neither meshes nor MuJoCo are needed.

        Args:
            release: Its folder.
            surface_points: Per hand.
        """
        return cls(
            [HandModel.from_release(release, s, surface_points=surface_points) for s in SIDES]
        )

    @classmethod
    def of_names(cls, names: Sequence[str], surface_points: int) -> HandShapes:
        """Load hands by the names that `bidexdata hands` lists, left first."""
        return cls(
            [
                HandModel(load_hand(name, side), surface_points=surface_points)
                for name, side in zip(names, SIDES, strict=True)
            ]
        )

    def forward(
        self,
        pos: Float[Tensor, "n 2 3"],
        rot: Float[Tensor, "n 2 3 3"],
        joints: Float[Tensor, "n 2 J"],
    ) -> Shape:
        """Place both hands.

        Args:
            pos: Wrists [m], world.
            rot: Their orientations.
            joints: [rad].
        """
        parts: list[tuple[Tensor, Tensor, Tensor]] = []
        for h, model in enumerate(self.models):
            origin = torch.zeros_like(pos[:, h])
            upright = origin.new_tensor([1.0, 0, 0, 0]).expand(len(origin), 4)
            # In the hand's own frame: only points are turned, and no quaternion has a gradient.
            pose = model(origin, upright, joints[:, h, : self.counts[h]])
            radius = torch.as_tensor(model.hand.contact_radius, dtype=pos.dtype, device=pos.device)
            pads = pose.contact_point + radius[:, None] * pose.contact_normal
            own = (model.surface_points(pose), pads, pose.sphere_pos)
            moved = [p @ rot[:, h].transpose(-1, -2) + pos[:, h, None] for p in own]
            parts.append((moved[0], moved[1], moved[2]))
        return Shape(*(torch.cat(both, dim=1) for both in zip(*parts, strict=True)))


def _pairs(hands: list) -> tuple[Int[Tensor, "M 2"], Float[Tensor, " M"]]:
    """Pairs of collision spheres that must not overlap, within and between the hands."""
    left, right = hands
    K = len(left.sphere_radius)
    across = np.stack(
        np.meshgrid(np.arange(K), K + np.arange(len(right.sphere_radius)), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    pairs = np.concatenate([left.self_pairs, right.self_pairs + K, across]).astype(np.int64)
    radius = np.concatenate([left.sphere_radius, right.sphere_radius])
    return torch.from_numpy(pairs), torch.from_numpy(radius[pairs].sum(1).astype(np.float32))
