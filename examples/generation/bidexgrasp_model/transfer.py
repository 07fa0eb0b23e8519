"""The baseline without learning: the nearest training object's grasps, carried to a new one.

The nearest is that with the smallest Chamfer distance between clouds of unit size, each as it
stands on the table and turned about the vertical in steps. Its best-ranked grasp is carried by its
anchor: directions and dr stay, dt grows with the bounding spheres.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from bidexdata.loaders import BiDexCases
from bidexgrasp_model.anchors import Anchor, grasp_anchor
from bidexgrasp_model.config import Config
from bidexgrasp_model.data import FIELDS, poses_of
from bidexgrasp_model.losses import chamfer_loss
from bidexgrasp_model.sampling import Samples
from bidexgrasp_model.state import GRASP, Layout, Poses, decode, encode
from bidexgrasp_model.tables import sphere_of, tables_of
from bidexgrasp_model.views import candidate_views, nearest_view

RANK = "qp_residual_shifted"
"""What grasps are ranked by, smaller first: selection of the synthesis goes by it."""
TURNS = 8
"""Turns about the vertical that clouds are compared at. Ours."""
_POINTS = 256


class Known(NamedTuple):
    """The training cases."""

    clouds: Float[Tensor, "M P 3"]
    """Relative to the spheres' centres, in units of their radii."""
    sizes_mm: Int[Tensor, " M"]
    centre: Float[Tensor, "M 3"]
    radius: Float[Tensor, " M"]
    poses: list[Poses]
    """Of each case, best-ranked first."""


def known_cases(release: Path, config: Config, where: str, most: int | None = None) -> Known:
    """Read the training cases, as they stand.

    Args:
        release: Its folder.
        config: Points of a cloud.
        where: Which grasps may be carried.
        most: Only about so many cases, spread over all.
    """
    cases = BiDexCases(
        release,
        where=where,
        fields=(*FIELDS, "size_mm", RANK),
        frame="world",
        points=config.model.points,
    )
    step = 1 if most is None else max(1, len(cases) // most)
    clouds, sizes, centres, radii, poses = [], [], [], [], []
    for k in range(0, len(cases), step):
        case = cases[k]
        cloud = case["cloud_solid"][None]
        centre, radius = sphere_of(cloud, tables_of(cloud, config.model))
        order = case[RANK].nan_to_num(nan=float("inf")).argsort(stable=True)
        clouds.append((cloud[0, :_POINTS] - centre) / radius)
        sizes.append(int(case["size_mm"]))
        centres.append(centre[0])
        radii.append(radius[0])
        poses.append(Poses(*(part[order] for part in poses_of(case))))
    return Known(
        torch.stack(clouds), torch.tensor(sizes), torch.stack(centres), torch.stack(radii), poses
    )


def transfer(
    known: Known,
    clouds: Float[Tensor, "B P 3"],
    sizes_mm: Sequence[int],
    grasps: int,
    config: Config,
    joints: int,
) -> Samples:
    """Carry the best-ranked grasp of the nearest training case to each cloud.

    Args:
        known: From `known_cases`.
        clouds: World frame, farthest-point order [m].
        sizes_mm: Their sizes.
        grasps: Of each, all the same: to be compared with as many samples of a model.
        config: Views.
        joints: J.
    """
    centre, radius = sphere_of(clouds, tables_of(clouds, config.model))
    found, views = [], []
    for b in range(len(clouds)):
        own = (clouds[b, :_POINTS] - centre[b]) / radius[b]
        case, R = _nearest(known, own, sizes_mm[b])
        chosen = torch.zeros(grasps, dtype=torch.long)
        poses = Poses(*(part[chosen] for part in known.poses[case]))
        found.append(
            carried(poses, known.centre[case], known.radius[case], R, centre[b], radius[b], joints)
        )
        wrists = found[-1].pos[:, :, GRASP]
        middle = centre[b].expand_as(wrists)
        views.append(nearest_view(wrists, middle, candidate_views(config.model.views)))
    numbers = torch.arange(len(clouds)).repeat_interleave(grasps)
    together = Poses(*(torch.cat(parts) for parts in zip(*found, strict=True)))
    return Samples(numbers, torch.cat(views), together)


def carried(
    poses: Poses,
    old_centre: Float[Tensor, 3],
    old_radius: Float[Tensor, ""],
    R: Float[Tensor, "3 3"],
    centre: Float[Tensor, 3],
    radius: Float[Tensor, ""],
    joints: int,
) -> Poses:
    """Carry grasps from one bounding sphere to another.

    The anchor of a hand is taken on the very line from its wrist to the centre.

    Args:
        poses: Grasps of the old object, world.
        old_centre: Of its sphere [m].
        old_radius: [m].
        R: Turn of the old object that makes it most like the new one.
        centre: Of the new sphere [m].
        radius: [m].
        joints: J.
    """
    wrists = poses.pos[:, :, GRASP]
    toward = torch.nn.functional.normalize(old_centre - wrists, dim=-1)
    old = grasp_anchor(toward, old_centre.expand_as(wrists), old_radius.expand(toward.shape[:-1]))
    state = encode(poses, old)
    state = torch.cat([state[..., :3] * (radius / old_radius), state[..., 3:]], dim=-1)
    turned = toward @ R.T
    on_new = grasp_anchor(turned, centre.expand_as(wrists), radius.expand(toward.shape[:-1]))
    # The old frame turned along: the same as a new one, but where the view is vertical.
    new = Anchor(on_new.pos, R @ old.rot)
    return decode(state, new, Layout(joints))


def _nearest(
    known: Known, cloud: Float[Tensor, "P 3"], size_mm: int
) -> tuple[int, Float[Tensor, "3 3"]]:
    """The case of the nearest size whose turned cloud is most like this one."""
    gap = (known.sizes_mm - size_mm).abs()
    candidates = (gap == gap.min()).nonzero().flatten()
    turns = torch.stack([_about_z(2 * torch.pi * k / TURNS) for k in range(TURNS)])
    best = torch.full((len(candidates),), float("inf"))
    turn = torch.zeros(len(candidates), dtype=torch.long)
    for k, R in enumerate(turns):
        for low in range(0, len(candidates), 64):
            part = slice(low, low + 64)
            moved = known.clouds[candidates[part]] @ R.T
            distance = chamfer_loss(moved, cloud.expand(len(moved), -1, -1))
            closer = distance < best[part]
            best[part] = torch.where(closer, distance, best[part])
            turn[part] = torch.where(closer, torch.full_like(turn[part], k), turn[part])
    first = int(best.argmin())
    return int(candidates[first]), turns[turn[first]]


def _about_z(angle: float) -> Float[Tensor, "3 3"]:
    a = torch.tensor(angle)
    c, s, o, i = a.cos(), a.sin(), torch.tensor(0.0), torch.tensor(1.0)
    return torch.stack([torch.stack([c, -s, o]), torch.stack([s, c, o]), torch.stack([o, o, i])])
