"""What of a cloud no motion and no size changes: groups of neighbours, and what holds its sphere.

A release stores clouds in farthest-point order, so its first n points are the sample of n points
that set abstraction wants. Neighbours of these, and the points that hold the minimum bounding
sphere, stay the same when the object is turned, mirrored or scaled: they are computed once per
object and kept in a cache beside the checkpoints.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from bidexgrasp_model.config import ModelConfig
from bidexgrasp_model.sphere import minimum_sphere


class Tables(NamedTuple):
    """Of some clouds, leading axis B; numbers of points are int16 in the cache."""

    first: Int[Tensor, "B A N"]
    """Points of the groups around the first A points."""
    second: Int[Tensor, "B C N"]
    """Among the first A points, those of the groups around the first C."""
    support: Int[Tensor, "B 4"]
    """Points that hold the bounding sphere."""
    weight: Float[Tensor, "B 4"]
    """Their weights in its centre."""

    def of(self, index: Int[Tensor, " n"]) -> Tables:
        """Those of some clouds, as the network takes them."""
        first, second, support = (t[index].long() for t in self[:3])
        return Tables(first, second, support, self.weight[index])

    def to(self, device: torch.device) -> Tables:
        """On another device."""
        return Tables(*(t.to(device) for t in self))


def nearest(
    centres: Float[Tensor, "*b A 3"], points: Float[Tensor, "*b P 3"], count: int
) -> Int[Tensor, "*b A N"]:
    """Numbers of the `count` points nearest to each centre, nearest first."""
    return torch.cdist(centres, points).topk(count, dim=-1, largest=False).indices


def tables_of(clouds: Float[Tensor, "B P 3"], model: ModelConfig) -> Tables:
    """Compute the tables of clouds in farthest-point order."""
    a, c = model.groups
    held = [minimum_sphere(cloud) for cloud in clouds.double().cpu().numpy()]
    device = clouds.device
    return Tables(
        nearest(clouds[:, :a], clouds, model.neighbours),
        nearest(clouds[:, :c], clouds[:, :a], model.neighbours),
        torch.as_tensor(np.stack([s.point for s in held]), device=device),
        torch.as_tensor(np.stack([s.weight for s in held]), dtype=torch.float32, device=device),
    )


def sphere_of(
    clouds: Float[Tensor, "B P 3"], tables: Tables
) -> tuple[Float[Tensor, "B 3"], Float[Tensor, " B"]]:
    """Centre and radius of the minimum bounding sphere of moved and scaled clouds [m]."""
    held = clouds.gather(1, tables.support[..., None].expand(-1, -1, 3))
    centre = (tables.weight[..., None] * held).sum(1)
    return centre, (held - centre[:, None]).norm(dim=-1).amax(dim=1)


def farthest_order(points: Float[np.ndarray, "P 3"], count: int) -> Int[np.ndarray, " n"]:
    """Numbers of points in farthest-point order, starting from the one farthest from their mean."""
    at = int(np.linalg.norm(points - points.mean(0), axis=1).argmax())
    order = np.empty(count, np.int64)
    distance = np.full(len(points), np.inf)
    for k in range(count):
        order[k] = at
        distance = np.minimum(distance, ((points - points[at]) ** 2).sum(1))
        at = int(distance.argmax())
    return order


def cached_tables(
    clouds: Float[np.ndarray, "K P 3"], model: ModelConfig, folder: Path, fingerprint: str
) -> Tables:
    """The tables of all objects of a release, from the cache where they are there.

    Args:
        clouds: At unit diagonal, in the order of the objects.
        model: Numbers of groups and neighbours.
        folder: Of the cache; made if need be.
        fingerprint: Of the release.
    """
    name = "-".join(map(str, (fingerprint, model.points, *model.groups, model.neighbours)))
    path = folder / f"tables-{name}.npz"
    if path.is_file():
        with np.load(path) as stored:
            return Tables(*(torch.from_numpy(stored[n]) for n in Tables._fields))
    parts = [
        tables_of(torch.from_numpy(np.array(clouds[k : k + 1, : model.points])), model)
        for k in range(len(clouds))
    ]
    joined = [torch.cat(columns) for columns in zip(*parts, strict=True)]
    small = [t.to(torch.int16) if not t.is_floating_point() else t for t in joined]
    folder.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.stem}.{os.getpid()}.npz")
    with open(partial, "wb") as stream:
        columns: dict[str, Any] = dict(zip(Tables._fields, (t.numpy() for t in small), strict=True))
        np.savez(stream, **columns)
    os.replace(partial, path)
    return Tables(*small)
