"""The whole model: from clouds and views to grasps relative to anchors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from bidexgrasp_model.anchors import Anchor, grasp_anchor, object_frame
from bidexgrasp_model.config import Config
from bidexgrasp_model.coordination import Coordination, ViewScores
from bidexgrasp_model.denoiser import Denoiser, Keys, situation
from bidexgrasp_model.encoder import Encoder, Features
from bidexgrasp_model.layers import Slots
from bidexgrasp_model.local import Frames, LocalFeature, object_memory
from bidexgrasp_model.state import Layout, Scale
from bidexgrasp_model.tables import Tables, sphere_of
from bidexgrasp_model.views import candidate_views


class Scenes(NamedTuple):
    """Clouds as the network takes them."""

    points: Float[Tensor, "B P 3"]
    """Relative to the spheres' centres [m], world axes, in farthest-point order."""
    centre: Float[Tensor, "B 3"]
    """Of the minimum bounding spheres [m], world."""
    radius: Float[Tensor, " B"]
    """[m]."""
    tables: Tables

    @classmethod
    def of(cls, clouds: Float[Tensor, "B P 3"], tables: Tables) -> Scenes:
        """Find the spheres of clouds [m], world."""
        centre, radius = sphere_of(clouds, tables)
        return cls(clouds - centre[:, None], centre, radius, tables)


@dataclass(frozen=True, slots=True)
class Seen:
    """What the encoder and the coordination module make of scenes."""

    features: Features
    scores: ViewScores | None


@dataclass(frozen=True, slots=True)
class Conditions:
    """All that the denoiser needs of n grasps besides the noisy states."""

    anchor: Anchor
    """Of the hands, world, (n, 2)."""
    situation: Float[Tensor, "n 2 S"]
    keys: list[Keys]
    slots: Slots


class GenerationModel(nn.Module):
    """Encoder, coordination module, geometry-adaptive feature and relative diffusion.

    Without coordination (the plain DDPM) every grasp has one frame, the object's; views are then
    not known. State: `scale`, the statistics of the training data.
    """

    mean: Tensor
    std: Tensor
    views: Tensor

    def __init__(self, config: Config, joints: int):
        """Build it.

        Args:
            config: Sizes and modules.
            joints: J of each hand.
        """
        super().__init__()
        self.config, self.layout = config, Layout(joints)
        m = config.model
        self.encoder = Encoder(m)
        self.coordination = Coordination(m) if m.coordination != "none" else None
        self.local = LocalFeature(m) if m.geometry else None
        self.denoiser = Denoiser(m, self.layout.width, config.diffusion.steps)
        self.register_buffer("views", candidate_views(m.views))
        self.register_buffer("mean", torch.zeros(2, self.layout.width))
        self.register_buffer("std", torch.ones(2, self.layout.width))

    @property
    def scale(self) -> Scale:
        """Statistics of the states."""
        return Scale(self.mean, self.std)

    @scale.setter
    def scale(self, scale: Scale) -> None:
        self.mean.copy_(scale.mean)
        self.std.copy_(scale.std)

    def see(self, scenes: Scenes) -> Seen:
        """Encode clouds and score views."""
        features = self.encoder(scenes.points, scenes.radius, scenes.tables)
        scores = self.coordination(features, self.views) if self.coordination else None
        return Seen(features, scores)

    def conditions(
        self,
        scenes: Scenes,
        seen: Seen,
        cloud: Int[Tensor, " n"],
        view: Int[Tensor, "n 2"],
    ) -> Conditions:
        """Make what n grasps are conditioned on.

        Args:
            scenes: The clouds.
            seen: What `see` made of them.
            cloud: Which of them each grasp is of.
            view: View of the left and the right hand; of no meaning without coordination.
        """
        if self.coordination is None:
            view = torch.zeros_like(view)
        K = len(self.views)
        number, index = torch.unique(cloud[:, None] * K + view, return_inverse=True)
        frames = self.frames(scenes.radius, number // K, number % K)
        local = None
        if self.local is not None:
            local = self.local(seen.features, scenes.points, scenes.tables, frames)
        memory = object_memory(seen.features, seen.scores, local, frames)
        anchor = Anchor(
            frames.anchor.pos[index] + scenes.centre[cloud][:, None], frames.anchor.rot[index]
        )
        return Conditions(
            anchor,
            situation(frames, index, scenes.radius, scenes.centre[:, 2]),
            self.denoiser.keys(memory, frames),
            Slots(index.flatten(), len(number)),
        )

    def frames(
        self, radius: Float[Tensor, " B"], cloud: Int[Tensor, " F"], view: Int[Tensor, " F"]
    ) -> Frames:
        """Anchors of views, relative to the spheres' centres."""
        direction = self.views[view]
        zero = torch.zeros_like(direction)
        on_sphere = grasp_anchor(direction, zero, radius[cloud])
        with_anchor = self.config.model.anchor and self.coordination is not None
        frame = on_sphere if with_anchor else object_frame(direction, zero)
        return Frames(cloud, view, frame, on_sphere.pos)

    def forward(
        self, state: Float[Tensor, "n 2 D"], t: Int[Tensor, " n"], conditions: Conditions
    ) -> Float[Tensor, "n 2 D"]:
        """Predict v of noisy, normalised states."""
        c = conditions
        return self.denoiser(state, t, c.situation, c.keys, c.slots)
