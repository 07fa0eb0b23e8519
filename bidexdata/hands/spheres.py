"""Collision spheres of a hand, fitted to its collision geometry.

A greedy cover, body by body. Candidates are the points of a regular grid inside the body's convex
shapes; a candidate's sphere is as large as its depth allows (plus `protrusion`), so it follows the
medial axis. A surface sample is covered when it lies inside a sphere or outside it by at most
`slack` of the radius. The candidate that newly covers the most area is taken until none is worth
a sphere. Parts thinner than the smallest sphere get smallest spheres, which stand out on both
sides, after everything else. The spheres of the fingertips' contact points come first, in their
order, so sphere k < hand.fingertips is contact point k; bodies that carry one get no protrusion, so
that the pad touches first. Other contact points have no spheres of their own. Nothing is random: the
same model gives the same spheres.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.hands.geometry import Shape, body_shapes, depth, surface_samples
from bidexdata.hands.model import FloatArray, Hand, IntArray
from bidexdata.hands.spec import SphereFitSpec

if TYPE_CHECKING:
    import mujoco


class Spheres(NamedTuple):
    """Spheres in their bodies' frames."""

    body: IntArray
    """(K,)."""
    pos: FloatArray
    """[m], (K, 3)."""
    radius: FloatArray
    """[m], (K,)."""


def fit_spheres(hand: Hand, model: mujoco.MjModel, settings: SphereFitSpec) -> Spheres:
    """Cover the collision geometry of a hand with spheres.

    Args:
        hand: The hand with its contact points; spheres are ignored.
        model: Its compiled model.
        settings: Radii and tolerances.
    """
    tips = slice(hand.fingertips)
    found = [Spheres(hand.contact_body[tips], hand.contact_pos[tips], hand.contact_radius[tips])]
    for body, shapes in enumerate(body_shapes(model)):
        if not shapes:
            continue
        pads = np.flatnonzero(hand.contact_body[tips] == body)
        pos, radius = cover(shapes, hand.contact_pos[pads], hand.contact_radius[pads], settings)
        found.append(Spheres(np.full(len(radius), body, np.int32), pos, radius))
    return Spheres(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def cover(
    shapes: list[Shape], pad_pos: FloatArray, pad_radius: FloatArray, settings: SphereFitSpec
) -> tuple[FloatArray, FloatArray]:
    """Cover the collision geometry of one body.

    Args:
        shapes: Of the body, in its frame.
        pad_pos: Centres of contact spheres that it carries already [m], (n, 3).
        pad_radius: Their radii [m], (n,).
        settings: Radii and tolerances.

    Returns:
        Centres in the body's frame (k, 3) and radii (k,) [m].
    """
    samples, area = surface_samples(shapes, 2.0 * settings.spacing)
    centres = _grid_inside(shapes, settings.spacing)
    apart = _gaps(samples, centres, 0.0)
    # To the surface of the union, which lies deeper than any one shape where shapes overlap.
    deep = np.maximum(depth(shapes, centres), apart.min(axis=1))
    protrusion = 0.0 if len(pad_pos) else settings.protrusion
    regular = deep + protrusion >= settings.min_radius
    radius = np.clip(deep + protrusion, settings.min_radius, settings.max_radius)
    worth = min(settings.worth, settings.worth_share * float(area.sum()))
    open_area = area.copy()
    if len(pad_pos):
        open_area[
            (_gaps(samples, pad_pos, pad_radius) <= settings.slack * pad_radius[:, None]).any(
                axis=0
            )
        ] = 0.0
    covers = (apart <= (1 + settings.slack) * radius[:, None]).astype(np.float64)
    thin = ~regular & (deep >= settings.thin)
    chosen: list[int] = []
    for candidates in (np.flatnonzero(regular), np.flatnonzero(thin)):
        gain = covers[candidates] @ open_area
        while len(candidates):
            # Rounded, so that the first of equals wins whatever the order of summation.
            best = int(np.argmax(np.round(gain, 10)))
            if gain[best] < worth:
                break
            newly = (covers[candidates[best]] > 0) & (open_area > 0)
            gain = gain - covers[np.ix_(candidates, newly)] @ open_area[newly]
            open_area[newly] = 0.0
            chosen.append(int(candidates[best]))
    return centres[chosen], radius[chosen]


def _grid_inside(shapes: list[Shape], spacing: float) -> FloatArray:
    """Grid points inside the shapes, (n, 3).

    Each shape has its own grid along its own axes through its middle, so that axes of capsules
    and middle planes of boxes, where the largest spheres sit, are always among the points.
    """
    found = []
    for shape in shapes:
        low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
        middle = 0.5 * (low + high)
        steps = np.floor(0.5 * (high - low) / spacing).astype(int)
        axes = [m + spacing * np.arange(-n, n + 1) for m, n in zip(middle, steps, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        found.append(points @ shape.R.T + shape.pos)
    points = np.concatenate(found)
    return points[depth(shapes, points) > 0]


def _gaps(samples: FloatArray, centres: FloatArray, radius: FloatArray | float) -> FloatArray:
    """Signed distance from each sphere to each sample [m], (spheres, samples)."""
    apart = centres @ (-2 * samples.T)
    apart += np.sum(centres**2, axis=1)[:, None]
    apart += np.sum(samples**2, axis=1)
    np.sqrt(np.maximum(apart, 0.0, out=apart), out=apart)
    apart -= np.reshape(radius, (-1, 1))
    return apart
