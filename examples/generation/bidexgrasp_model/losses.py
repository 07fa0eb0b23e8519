"""The paper's losses, one function per equation."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from bidexgrasp_model.state import Layout

_EPS = 1e-8
_DEEP = 0.05
"""Depths beyond this are no longer told from the far side of a thin wall [m]. Ours."""


_FEW = 6
"""Nearest points whose planes say where the solid is. Ours: with the nearest alone depths are
wrong near edges, where its plane goes on and the solid does not."""


def single_view_loss(
    p: Float[Tensor, "*b K"], y: Float[Tensor, "*b K"], mask: Bool[Tensor, "*b K"]
) -> Float[Tensor, ""]:
    """L_single = sum m SmoothL1(p, y) / (sum m + eps).

    Source:
        BiDexGrasp, appendix C, single-view loss.
    """
    each = torch.nn.functional.smooth_l1_loss(p, y, reduction="none")
    return (each * mask).sum() / (mask.sum() + _EPS)


def bi_view_loss(
    p: Float[Tensor, "B K K"], y: Float[Tensor, "B K K"], mask: Bool[Tensor, "B K"]
) -> Float[Tensor, ""]:
    """L_bi = sum m_i SmoothL1(p_ij, y_ij) / (K sum m_i + eps).

    Source:
        BiDexGrasp, appendix C, bi-view loss.
    """
    each = torch.nn.functional.smooth_l1_loss(p, y, reduction="none")
    return (each * mask[..., None]).sum() / (p.shape[-1] * mask.sum() + _EPS)


def para_loss(
    found: Float[Tensor, "n 2 D"],
    true: Float[Tensor, "n 2 D"],
    layout: Layout,
    weight: Float[Tensor, " n"],
) -> dict[str, Float[Tensor, ""]]:
    """Mean squared error of normalised translation, rotation, joints and other stages, separately.

    Args:
        found: Predicted states, normalised.
        true: Those of the data.
        layout: Which numbers are what.
        weight: Of each grasp.

    Source:
        BiDexGrasp, 5.2 and appendix C, parameter loss. Means in place of sums (ours), so that 22
        joints do not count 7 times a translation.
    """
    error = (found - true).square() * weight[:, None, None]
    return {name: error[..., part].mean() for name, part in layout.groups.items()}


def chamfer_loss(a: Float[Tensor, "*b P 3"], b: Float[Tensor, "*b Q 3"]) -> Float[Tensor, "*b"]:
    """Mean squared distance to the nearest point, both ways [m2].

    Source:
        BiDexGrasp, appendix C, Chamfer loss.
    """
    squared = squared_distances(a, b)
    return squared.min(-1).values.mean(-1) + squared.min(-2).values.mean(-1)


def self_penetration_loss(
    points: Float[Tensor, "*b P 3"], pairs: Int[Tensor, "M 2"], least: Float[Tensor, " M"]
) -> Float[Tensor, "*b"]:
    """Sum of max(0, delta - distance) over pairs of key points of both hands [m].

    The paper gives no delta and no key points: these are the hands' collision spheres, and delta
    is the sum of two radii.

    Args:
        points: Key points of both hands [m].
        pairs: Which may not come close.
        least: delta of each pair [m].

    Source:
        BiDexGrasp, appendix C, self-bi-penetration loss.
    """
    between = points[..., pairs[:, 0], :] - points[..., pairs[:, 1], :]
    distance = (between.square().sum(-1) + 1e-12).sqrt()
    return (least - distance).clamp(min=0).sum(-1)


def object_penetration_loss(
    points: Float[Tensor, "n P 3"], cloud: Float[Tensor, "n Q 3"], normals: Float[Tensor, "n Q 3"]
) -> Float[Tensor, " n"]:
    """Sum of max(0, depth) over points of the hands' surface [m].

    The depth is that below the tangent planes of the nearest points of the cloud.

    Source:
        BiDexGrasp, appendix C, hand-object penetration loss.
    """
    near = bounding_point(points, cloud, normals)[..., None].expand(points.shape)
    depth = ((cloud.gather(-2, near) - points) * normals.gather(-2, near)).sum(-1)
    return depth.clamp(0, _DEEP).sum(-1)


def contact_loss(
    pads: Float[Tensor, "*b C 3"], cloud: Float[Tensor, "*b Q 3"], within: float
) -> Float[Tensor, "*b"]:
    """Mean distance to the cloud of the pads that are closer than tau [m].

    Source:
        BiDexGrasp, appendix C, contact loss.
    """
    distance = (squared_distances(pads, cloud).min(-1).values + 1e-12).sqrt()
    close = distance < within
    return (distance * close).sum(-1) / (close.sum(-1) + _EPS)


@torch.no_grad()
def bounding_point(
    points: Float[Tensor, "n P 3"], cloud: Float[Tensor, "n Q 3"], normals: Float[Tensor, "n Q 3"]
) -> Int[Tensor, "n P"]:
    """Number of the point of the cloud whose tangent plane bounds the solid at each point.

    Of the few nearest points it is the one whose plane the point is farthest above: at an edge the
    solid lies below both planes, and the plane of the nearest point alone goes on behind it.
    """
    own = cloud.square().sum(-1)[:, None]
    distance = torch.baddbmm(own, points, cloud.transpose(1, 2), alpha=-2)
    few = distance.topk(min(_FEW, cloud.shape[1]), dim=-1, largest=False, sorted=False).indices
    wide = few.flatten(1)[..., None].expand(-1, -1, 3)
    at = cloud.gather(1, wide).unflatten(1, few.shape[1:])
    normal = normals.gather(1, wide).unflatten(1, few.shape[1:])
    height = ((points[:, :, None] - at) * normal).sum(-1)
    return few.gather(-1, height.argmax(-1, keepdim=True)).squeeze(-1)


@torch.no_grad()
def nearest_point(
    points: Float[Tensor, "n P 3"], cloud: Float[Tensor, "n Q 3"]
) -> Int[Tensor, "n P"]:
    """Number of the point of the cloud that is nearest to each point.

    A point's own squared length is the same for all of the cloud, so it is left out.
    """
    own = cloud.square().sum(-1)[:, None]
    return torch.baddbmm(own, points, cloud.transpose(1, 2), alpha=-2).argmin(-1)


def squared_distances(
    a: Float[Tensor, "*b P 3"], b: Float[Tensor, "*b Q 3"]
) -> Float[Tensor, "*b P Q"]:
    """Squared distances of all pairs by one product; at least 0."""
    cross = a @ b.transpose(-1, -2)
    found = a.square().sum(-1)[..., None] + b.square().sum(-1)[..., None, :] - 2 * cross
    return found.clamp(min=0)
