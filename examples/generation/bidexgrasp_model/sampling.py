"""Grasps from a trained model: clouds in, poses of both hands at all stages out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from bidexgrasp_model.anchors import Anchor, grasp_anchor
from bidexgrasp_model.checkpoint import HandId
from bidexgrasp_model.choosing import draw_views
from bidexgrasp_model.config import Config
from bidexgrasp_model.diffusion import draw
from bidexgrasp_model.hand_shape import HandShapes
from bidexgrasp_model.model import GenerationModel, Scenes
from bidexgrasp_model.refine import refined
from bidexgrasp_model.rotations import quat_from_matrix
from bidexgrasp_model.state import SQUEEZE, Poses, decode, encode
from bidexgrasp_model.surfaces import Surface
from bidexgrasp_model.tables import sphere_of, tables_of

_AT_ONCE = 16
"""Clouds that are encoded together."""


class Samples(NamedTuple):
    """n grasps."""

    cloud: Int[Tensor, " n"]
    """Which cloud each is of."""
    view: Int[Tensor, "n 2"]
    """Views that they were conditioned on."""
    poses: Poses


class Touch(NamedTuple):
    """What refinement needs besides the model."""

    surface: Surface
    """Of the same clouds, with as many points as are known."""
    shapes: HandShapes

    def of(self, some: slice) -> Touch:
        """That of some of the clouds."""
        return Touch(self.surface.of(some), self.shapes)


@torch.no_grad()
def sample(
    model: GenerationModel,
    clouds: Float[Tensor, "B P 3"],
    grasps: int,
    hands: HandId,
    generator: torch.Generator | None = None,
    touch: Touch | None = None,
) -> Samples:
    """Make grasps of some clouds.

    Args:
        model: Ready to sample, as `Checkpoint.model` gives it.
        clouds: World frame, z up, in farthest-point order [m].
        grasps: Of each cloud.
        hands: Limits of the joints.
        generator: Of views and noise.
        touch: For refinement, which is left out without it.

    Returns:
        The grasps, those of a cloud behind each other.
    """
    parts = [
        _sample_some(
            model,
            clouds[low : low + _AT_ONCE],
            grasps,
            hands,
            generator,
            touch and touch.of(slice(low, low + _AT_ONCE)),
        )
        for low in range(0, len(clouds), _AT_ONCE)
    ]
    numbers = torch.arange(len(clouds)).repeat_interleave(grasps)
    views = torch.cat([p.view for p in parts])
    poses = Poses(*(torch.cat(columns) for columns in zip(*(p.poses for p in parts), strict=True)))
    return Samples(numbers, views, poses)


def _sample_some(
    model: GenerationModel,
    clouds: Float[Tensor, "B P 3"],
    grasps: int,
    hands: HandId,
    generator: torch.Generator | None,
    touch: Touch | None,
) -> Samples:
    config = model.config
    draws = config.refine.draws if touch is not None else 1
    scenes = Scenes.of(clouds, tables_of(clouds, config.model))
    seen = model.see(scenes)
    cloud = torch.arange(len(clouds), device=clouds.device).repeat_interleave(grasps * draws)
    view = torch.zeros(len(cloud), 2, dtype=torch.long, device=clouds.device)
    if seen.scores is not None:
        view = draw_views(
            seen.scores, cloud, config.model.coordination, config.diffusion, generator
        )
    conditions = model.conditions(scenes, seen, cloud, view)
    start = torch.randn((len(cloud), 2, model.layout.width), generator=generator).to(clouds)

    def predict(state: Tensor, t: Tensor) -> Tensor:
        return model(state, t, conditions)

    state = draw(predict, start, config.diffusion, generator)
    anchor = conditions.anchor
    if touch is not None:
        surface, scale = touch.surface.of(cloud), model.scale
        state, left = refined(state, anchor, surface, touch.shapes, hands, scale, config.refine)
        best = best_of(left, draws)
        state, view, cloud = state[best], view[best], cloud[best]
        anchor = Anchor(anchor.pos[best], anchor.rot[best])
    poses = decode(model.scale.restored(state), anchor, model.layout)
    return Samples(cloud, view, within_limits(poses, hands))


def best_of(left: Float[Tensor, " n"], draws: int) -> Int[Tensor, " m"]:
    """Of every so many samples behind each other, which has the least left."""
    first = draws * torch.arange(len(left) // draws, device=left.device)
    return first + left.unflatten(0, (-1, draws)).argmin(1)


@torch.no_grad()
def fitted(
    samples: Samples,
    clouds: Float[Tensor, "B P 3"],
    model: GenerationModel,
    touch: Touch,
    hands: HandId,
    config: Config,
) -> Samples:
    """Refine grasps that something else made, in the frames and units of a model.

    Args:
        samples: Grasps, with views.
        clouds: What they are of [m].
        model: Its statistics say how far a step goes.
        touch: Surfaces of the clouds, and the hands.
        hands: Limits of the joints.
        config: Steps and weights.
    """
    centre, radius = sphere_of(clouds, tables_of(clouds, config.model))
    view = model.views[samples.view]
    middle = centre[samples.cloud][:, None].expand_as(view)
    anchor = grasp_anchor(view, middle, radius[samples.cloud][:, None].expand(view.shape[:-1]))
    state = model.scale.normalised(encode(samples.poses, anchor))
    surface = touch.surface.of(samples.cloud)
    state, _ = refined(state, anchor, surface, touch.shapes, hands, model.scale, config.refine)
    poses = decode(model.scale.restored(state), anchor, model.layout)
    return samples._replace(poses=within_limits(poses, hands))


def within_limits(poses: Poses, hands: HandId) -> Poses:
    """Set joints to their ranges; the squeeze is a command and may ask for more."""
    held = hands.within(poses.joints[..., :SQUEEZE, :])
    joints = torch.cat([held, poses.joints[..., SQUEEZE:, :]], dim=-2)
    return poses._replace(joints=joints)


def run_columns(poses: Poses, hands: HandId) -> dict[str, np.ndarray]:
    """The columns of the record that hold poses; joints that a hand lacks are NaN."""
    joints = poses.joints.clone()
    for h, names in enumerate(hands.joint_names):
        joints[:, h, :, len(names) :] = float("nan")
    return {
        "hand_pos": poses.pos.float().cpu().numpy(),
        "hand_quat_wxyz": quat_from_matrix(poses.rot.double()).float().cpu().numpy(),
        "joints": joints.float().cpu().numpy(),
    }
