"""One training step's loss: the paper's sum of view, parameter, Chamfer and physics losses."""

from __future__ import annotations

from functools import partial

import torch
from jaxtyping import Float, Int
from torch import Tensor

from bidexgrasp_model.anchors import Anchor
from bidexgrasp_model.config import LossConfig
from bidexgrasp_model.data import CaseBatch
from bidexgrasp_model.diffusion import clean, draw_levels, noisy, shares
from bidexgrasp_model.hand_shape import HandShapes, Shape
from bidexgrasp_model.losses import (
    bi_view_loss,
    chamfer_loss,
    contact_loss,
    object_penetration_loss,
    para_loss,
    self_penetration_loss,
    single_view_loss,
)
from bidexgrasp_model.model import GenerationModel, Scenes, Seen
from bidexgrasp_model.state import GRASP, Layout, Poses, encode, grasp_pose

Terms = dict[str, Float[Tensor, ""]]


def total_loss(
    model: GenerationModel,
    hands: HandShapes | None,
    batch: CaseBatch,
    generator: torch.Generator | None = None,
    *,
    levels: Int[Tensor, " n"] | None = None,
    mixed: bool = False,
) -> tuple[Float[Tensor, ""], Terms]:
    """L = 10 L_single + 1 L_bi + 15 L_para + 0.25 L_chamfer + 1 L_physic.

    Anchors are those of the true views (teacher forcing).

    Args:
        model: In training mode or not.
        hands: For the geometric losses; they are left out without it.
        batch: Cases.
        generator: Of noise and noise levels.
        levels: Noise levels, 0 to T, of every grasp and repeat; drawn from 1 to T when omitted.
        mixed: Run the network in bfloat16. Frames, states and losses stay in float32: of a
            position of half a metre bfloat16 keeps 2 mm, and less of squared distances.

    Returns:
        The loss, and its parts before their weights.

    Source:
        BiDexGrasp, 5.2 and appendix C.
    """
    config = model.config
    loss, diffusion = config.loss, config.diffusion
    device = batch.clouds.device
    network = partial(torch.autocast, device.type, torch.bfloat16, enabled=mixed)
    scenes = Scenes.of(batch.clouds, batch.tables)
    again = torch.arange(len(batch.case), device=device).repeat(config.train.repeats)
    case, poses = batch.case[again], Poses(*(part[again] for part in batch.poses))
    with network():
        seen = model.see(scenes)
        conditions = model.conditions(scenes, seen, case, batch.view[again])
    terms = _view_terms(seen, batch)
    true = model.scale.normalised(encode(poses, conditions.anchor))
    noise = torch.randn(true.shape, generator=generator).to(device)
    if levels is None:
        levels = draw_levels(len(true), diffusion, generator)
    levels = levels.to(device)
    shares_left = shares(diffusion).to(device)
    share = shares_left[levels]
    xt = noisy(true, noise, share)
    with network():
        v = model(xt, levels, conditions)
    x0 = clean(xt, v.float(), share)
    weight = torch.ones_like(share)
    if loss.snr:  # level 0, which training does not draw, weighs as much as level 1
        weight = 1 / (1 - share.clamp(max=float(shares_left[1])))
    para = para_loss(x0, true, model.layout, weight)
    terms |= {f"para_{name}": value for name, value in para.items()}
    total = _weighted(terms, loss)
    if hands is not None:
        kept = levels <= loss.geometric_below * diffusion.steps
        if bool(kept.any()):
            anchor = Anchor(*(part[kept] for part in conditions.anchor))
            shape = _shape(model.scale.restored(x0[kept]), anchor, model.layout, hands)
            with torch.no_grad():
                goal = hands(*(part[kept][:, :, GRASP] for part in poses))
            geometric = _geometric_terms(shape, goal, hands, batch, case[kept], loss)
            terms |= geometric
            times = loss.geometric_every * kept.float().mean()
            total = total + _weighted_geometric(geometric, loss) * times
    return total, terms


def _shape(
    state: Float[Tensor, "n 2 D"], anchor: Anchor, layout: Layout, hands: HandShapes
) -> Shape:
    """The hands at the grasp of restored states."""
    pos, rot = grasp_pose(state, anchor)
    return hands(pos, rot, state[..., layout.groups["joints"]])


def _view_terms(seen: Seen, batch: CaseBatch) -> Terms:
    """Both view losses; a case has supervision for every view, rows only where a grasp is."""
    if seen.scores is None:
        return {}
    every = torch.ones_like(batch.y, dtype=torch.bool)
    rows = batch.y[:, 1] > 0
    return {
        "single_view": single_view_loss(seen.scores.single.float(), batch.y, every),
        "bi_view": bi_view_loss(seen.scores.pair.float(), batch.y_bi, rows),
    }


def _weighted(terms: Terms, loss: LossConfig) -> Float[Tensor, ""]:
    para = torch.stack([v for n, v in terms.items() if n.startswith("para_")]).sum()
    total = loss.para * para
    if "single_view" in terms:
        total = total + loss.single_view * terms["single_view"] + loss.bi_view * terms["bi_view"]
    return total


def _geometric_terms(
    shape: Shape,
    goal: Shape,
    hands: HandShapes,
    batch: CaseBatch,
    case: Int[Tensor, " m"],
    loss: LossConfig,
) -> Terms:
    cloud = batch.solid[case, : loss.cloud_points]
    normals = batch.normals[case, : loss.cloud_points]
    return {
        "chamfer": chamfer_loss(shape.surface, goal.surface).mean(),
        "self_pen": self_penetration_loss(shape.keys, hands.pairs, hands.least).mean(),
        "obj_pen": object_penetration_loss(shape.surface, cloud, normals).mean(),
        "spf": contact_loss(shape.pads, cloud, loss.contact_within).mean(),
    }


def _weighted_geometric(terms: Terms, loss: LossConfig) -> Float[Tensor, ""]:
    """0.25 L_chamfer + 1 (50 L_self-pen + 100 L_obj-pen + 50 L_spf)."""
    physic = (
        loss.self_pen * terms["self_pen"]
        + loss.obj_pen * terms["obj_pen"]
        + loss.spf * terms["spf"]
    )
    return loss.chamfer * terms["chamfer"] + loss.physic * physic
