"""Contact candidates: points on the palmar side of the fingers, in place of the fingertips' pads."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.hands.geometry import body_shapes, surface_samples
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.objects.surface import farthest_point_order

if TYPE_CHECKING:
    from bidexdata.hands.geometry import Shape
    from bidexdata.hands.model import Hand

LINKS = 3
"""Of each finger, from its tip, as many carry candidates: distal, middle, proximal."""
_SPACING = 0.004
"""Largest edge of the triangles that surface points are taken from [m]."""
_PALMAR = 0.5
"""A point is on the palmar side when it lies this far, of the farthest point's way, along the pad's
normal."""


class OnHand(NamedTuple):
    """Points that are fixed to bodies of a hand."""

    body: Int[np.ndarray, " n"]
    pos: Float[np.ndarray, "n 3"]
    """In the body's frame [m]."""


def contact_candidates(hand: Hand, per_link: int) -> OnHand:
    """Spread points over the palmar side of each finger's last links.

    Args:
        hand: Gives links, their shapes and the pads' normals, which say where palmar is.
        per_link: Points of each link.

    Source:
        BimanGrasp has lists of 10 a link; these are our own.
    """
    shapes = body_shapes(hand.make_spec().compile())
    turned = forward_kinematics(hand, np.zeros(len(hand.joint_names)))[1]
    found = []
    for c, finger in enumerate(hand.contact_finger[: hand.fingertips]):
        pad = turned[hand.contact_body[c]] @ hand.contact_normal[c]
        links = [hand.body_names.index(name) for name in hand.fingers[finger]]
        for body in [b for b in links if shapes[b]][-LINKS:]:
            found.append(_palmar(body, shapes[body], turned[body].T @ pad, per_link))
    return joined(found)


def surface_points(hand: Hand, count: int) -> OnHand:
    """Spread points over the whole hand, in farthest-point order at zero joint angles."""
    pos, turned = forward_kinematics(hand, np.zeros(len(hand.joint_names)))
    shapes = body_shapes(hand.make_spec().compile())
    every = joined(
        [OnHand(*_on(body, surface_samples(own, _SPACING)[0])) for body, own in enumerate(shapes)]
    )
    placed = pos[every.body] + np.einsum("nij,nj->ni", turned[every.body], every.pos)
    kept = farthest_point_order(placed.astype(np.float32), count)
    return OnHand(every.body[kept], every.pos[kept])


def with_contacts(hand: Hand, points: OnHand) -> Hand:
    """The same hand with points in place of its contact spheres."""
    n = len(points.body)
    return dataclasses.replace(
        hand,
        contact_names=tuple(f"candidate{i}" for i in range(n)),
        contact_body=points.body.astype(np.int32),
        contact_pos=points.pos,
        contact_radius=np.zeros(n),
        contact_normal=np.zeros((n, 3)),
        contact_finger=("",) * n,
        contact_part=("pad",) * n,
    )


def joined(parts: list[OnHand]) -> OnHand:
    """Points of several lists, one after the other."""
    return OnHand(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _palmar(body: int, shapes: list[Shape], normal: np.ndarray, count: int) -> OnHand:
    points = surface_samples(shapes, _SPACING)[0]
    along = (points - points.mean(axis=0)) @ normal
    side = points[along > _PALMAR * along.max()]
    kept = farthest_point_order(side.astype(np.float32), count)
    return OnHand(*_on(body, side[kept]))


def _on(body: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.full(len(points), body, np.int64), points
