"""Poses in which a solid rests on a table, with probabilities.

The hull says exactly which poses there are: a facet carries the body when the centre of mass is
over it. Drops in MuJoCo say how often each is reached, and leave out those that never are;
put down in what is left, the body must stay. A pose
is a direction that points down, so what differs by a rotation about z alone is one pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .config import RestConfig
from .drops import Body, drop, facing_down, put_down, spread_directions
from .facets import Facets, adjacency, facets
from .physics import solid_angles
from .prepared import TriangleMesh


class RestPoses(NamedTuple):
    """Orientations (K, 4) wxyz, heights of the origin over the table (K,), probabilities (K,)."""

    quats_wxyz: NDArray[np.float64]
    heights: NDArray[np.float64]
    probabilities: NDArray[np.float64]


class CarryingFacets(NamedTuple):
    """Facets of a hull that carry the body."""

    normals: NDArray[np.float64]
    """Outward unit normals, which point down in these poses, (K, 3)."""
    heights: NDArray[np.float64]
    """Of the centre of mass over them, (K,)."""
    shares: NDArray[np.float64]
    """Probabilities without dynamics, (K,)."""


def rest_poses(
    body: Body, config: RestConfig, pieces: Sequence[TriangleMesh] | None = None
) -> RestPoses:
    """Find the poses in which a body rests, the most probable first; none for a smooth ball.

    Args:
        body: The body; its centre of mass is at the origin.
        config: Number of drops, bounds on number and probability.
        pieces: Convex pieces that it consists of; its hull when omitted.
    """
    carrying = carrying_facets(body.hull, config)
    if len(carrying.normals) == 0:
        return RestPoses(np.zeros((0, 4)), np.zeros(0), np.zeros(0))
    rng = np.random.default_rng(config.seed)
    drops = drop(
        body,
        spread_directions(config.drops, rng),
        carrying.normals,
        height=config.drop_height,
        angle=config.flat,
        seconds=config.seconds,
    )
    ended = np.argmax(drops.downs @ carrying.normals.T, axis=1)
    count = len(carrying.normals)
    probability = np.bincount(ended, minlength=count) + config.prior_drops * carrying.shares
    probability = probability / (len(ended) + config.prior_drops)
    reached = np.bincount(ended[drops.still], minlength=count) > 0

    probability, kept = _merged(carrying.normals, probability, reached, config.merge)
    kept = kept[probability[kept] >= config.min_probability][: config.max_poses]
    quats = np.array([facing_down(n) for n in carrying.normals[kept]]).reshape(-1, 4)
    heights = carrying.heights[kept]
    turned = put_down(body, pieces or (body.hull,), quats, heights, config.stand_seconds)
    stays = turned < config.flat
    return RestPoses(quats[stays], heights[stays], probability[kept][stays])


def carrying_facets(hull: TriangleMesh, config: RestConfig) -> CarryingFacets:
    """Facets that carry the body, and how probable each is without dynamics.

    The body lands on a facet with the probability of the solid angle under which it is seen from
    the centre of mass. If the centre of mass is not over it, it topples over the edge that the
    centre is beyond, until a facet carries it; every step lowers the centre, so this ends.
    """
    groups = facets(hull, config.coplanar)
    count = len(groups.normals)
    share = np.bincount(groups.of_face, weights=solid_angles(hull), minlength=count) / (4 * np.pi)
    tipping, carried_by = _topple(hull, groups, config.steady)
    total = np.zeros(count)
    np.add.at(total, carried_by, share)
    stands = np.flatnonzero((carried_by == np.arange(count)) & (tipping >= config.steady))
    return CarryingFacets(groups.normals[stands], groups.offsets[stands], total[stands])


def _merged(
    normals: NDArray[np.float64],
    probability: NDArray[np.float64],
    reached: NDArray[np.bool_],
    angle: float,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Give each pose that drops reached the probability of those near it, the most probable first.

    Returns:
        Probabilities with those of near poses added, (K,), and the poses kept, in order.
    """
    # Equal probabilities (a box) keep a fixed order by rounding before the stable sort.
    order = np.argsort(-np.round(probability, 9), kind="stable")
    total, free, kept = probability.copy(), np.ones(len(order), bool), []
    for k in order[reached[order]]:
        if free[k]:
            near = free & (normals @ normals[k] > np.cos(angle))
            near[k] = True
            total[k] = probability[near].sum()
            free &= ~near
            kept.append(k)
    index = np.array(kept, np.int64)
    return total, index[np.argsort(-np.round(total[index], 9), kind="stable")]


def _topple(
    hull: TriangleMesh, groups: Facets, steady: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """How a body leaves the facet that it lands on.

    Returns:
        For every facet the smallest tilt [rad] that tips the body over, negative where it falls by
        itself, and the facet on which it comes to rest when tilts below `steady` do.
    """
    of_face, normals, offsets = groups
    first, second, edges = adjacency(hull.faces)
    border = of_face[first] != of_face[second]
    first, second, edges = first[border], second[border], edges[border]
    own = of_face[np.concatenate([first, second])]
    other = of_face[np.concatenate([second, first])]
    edges = np.concatenate([edges, edges[:, ::-1]])
    start, end = hull.vertices[edges[:, 0]], hull.vertices[edges[:, 1]]
    along = (end - start) / np.maximum(np.linalg.norm(end - start, axis=1), 1e-300)[:, None]
    # Signed distance of the projected centre of mass (the origin) to the edge, positive over the
    # facet; the body tips when the edge is under the centre.
    inset = -np.einsum("ni,ni->n", np.cross(normals[own], along), start)
    tilt = np.arctan2(inset, np.maximum(offsets[own], 1e-300))
    tipping = np.full(len(normals), np.pi)
    np.minimum.at(tipping, own, tilt)

    least = np.full(len(normals), steady)
    into = np.arange(len(normals))
    for facet, neighbour, angle in zip(own, other, tilt, strict=True):
        if angle < least[facet] and offsets[neighbour] < offsets[facet]:
            least[facet], into[facet] = angle, neighbour
    for _ in range(len(into)):
        further = into[into]
        if np.array_equal(further, into):
            break
        into = further
    return tipping, into
