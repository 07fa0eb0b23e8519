"""The scale-adaptive grasp anchor, and grasp poses relative to it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class Anchor(NamedTuple):
    """A frame on the bounding sphere, or at its centre where the model has no anchors."""

    pos: Float[Tensor, "*b 3"]
    """Origin [m], world."""
    rot: Float[Tensor, "*b 3 3"]
    """Axes as columns, world."""


def grasp_anchor(
    view: Float[Tensor, "*b 3"], centre: Float[Tensor, "*b 3"], radius: Float[Tensor, "*b"]
) -> Anchor:
    """Put a frame where a view meets the bounding sphere.

    Args:
        view: Unit vector towards the centre.
        centre: Of the minimum bounding sphere [m].
        radius: Of it [m].

    Source:
        BiDexGrasp, appendix C, scale-adaptive grasp anchor.
    """
    return Anchor(centre - radius[..., None] * view, anchor_axes(view))


def anchor_axes(view: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3 3"]:
    """X to the centre, z the world's z across x, y = z cross x.

    Where the view is vertical the world's x takes the place of its z: the paper leaves that open.

    Source:
        BiDexGrasp, appendix C.
    """
    up = torch.zeros_like(view)
    up[..., 2] = 1
    side = torch.zeros_like(view)
    side[..., 0] = 1
    vertical = view[..., 2:].abs() > 1 - 1e-6
    across = torch.where(vertical, side, up)
    z = across - (across * view).sum(-1, keepdim=True) * view
    z = torch.nn.functional.normalize(z, dim=-1)
    return torch.stack([view, torch.linalg.cross(z, view), z], dim=-1)


def object_frame(view: Float[Tensor, "*b 3"], centre: Float[Tensor, "*b 3"]) -> Anchor:
    """The frame of a model without anchors: the sphere's centre and the world's axes."""
    eye = torch.eye(3, dtype=view.dtype, device=view.device)
    return Anchor(centre.expand_as(view), eye.expand(*view.shape[:-1], 3, 3))


def to_relative(
    anchor: Anchor, pos: Float[Tensor, "*b 3"], rot: Float[Tensor, "*b 3 3"]
) -> tuple[Float[Tensor, "*b 3"], Float[Tensor, "*b 3 3"]]:
    """Express world poses in the anchor's frame: dt and dr.

    Source:
        BiDexGrasp, 5.2: the inverse of t = t_anchor + dt, r = r_anchor (+) dr, both in the
        anchor's frame.
    """
    back = anchor.rot.transpose(-1, -2)
    return (back @ (pos - anchor.pos)[..., None]).squeeze(-1), back @ rot


def to_world(
    anchor: Anchor, dt: Float[Tensor, "*b 3"], dr: Float[Tensor, "*b 3 3"]
) -> tuple[Float[Tensor, "*b 3"], Float[Tensor, "*b 3 3"]]:
    """Give the world poses of relative ones; the inverse of `to_relative`."""
    return anchor.pos + (anchor.rot @ dt[..., None]).squeeze(-1), anchor.rot @ dr
