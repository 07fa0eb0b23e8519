"""The energy terms of the upper level with their gradients, float64 on plain arrays.

This is the readable reference: one function per term, unweighted, and the points that terms take. The kernels in
`contact_kernels.py` and `sphere_kernels.py` compute the same on whole batches and are tested
against it. Axes lead with the batch; M contact points, K spheres, P sphere pairs; object frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

_TINY = 1e-9


class Term(NamedTuple):
    """One energy and its gradient with respect to the term's positions."""

    energy: Float[np.ndarray, "*b"]
    gradient: Float[np.ndarray, "*b n 3"]


class PadTerm(NamedTuple):
    """The pad-angle energy and its gradients with respect to both normals."""

    energy: Float[np.ndarray, "*b"]
    pad_gradient: Float[np.ndarray, "*b n 3"]
    normal_gradient: Float[np.ndarray, "*b n 3"]


def region_penalty(
    d: Float[np.ndarray, "*b"], a: float
) -> tuple[Float[np.ndarray, "*b"], Float[np.ndarray, "*b"]]:
    """Give phi(d) [m] and its derivative for b = 2 a: zero up to a, d - a from b on, C1 between.

    Source:
        BiDexGrasp, section 4.3 and appendix B, region consistency term.
    """
    x = np.maximum(d - a, 0.0)
    t = np.minimum(x / a, 1.0)
    blend = (3 - 2 * t) * t * t
    return blend * x, np.where(t < 1, (9 - 8 * t) * t * t, 1.0)


def contact_points(
    centres: Float[np.ndarray, "*b n 3"],
    normals_in: Float[np.ndarray, "*b n 3"],
    radius: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "*b n 3"]:
    """Give c_iw: the point of each contact sphere that faces the surface [m].

    On it every term is taken: its distance to the surface is that of the centre less the radius.
    """
    return centres + radius[:, None] * normals_in


def beside(
    points: Float[np.ndarray, "*b n 3"],
    normals: Float[np.ndarray, "*b n 3"],
    bases: Float[np.ndarray, "*b n 3"],
    shift: float,
    turn: Float[np.ndarray, "*b n"],
) -> Float[np.ndarray, "*b n 3"]:
    """Give the points `shift` away in the tangent planes: contacts that lie a little elsewhere [m].

    Args:
        points: Surface points [m].
        normals: Unit normals there; turns are about them.
        bases: Origin of the frame of each contact's hand [m]; turns begin in its direction.
        shift: How far from the points [m].
        turn: Which way, in circles [-].

    Source:
        Ours; docs/measurements.md, 14.
    """
    u = bases - points
    u = u - np.sum(u * normals, axis=-1, keepdims=True) * normals
    u = u / np.maximum(np.linalg.norm(u, axis=-1, keepdims=True), _TINY)
    angle = 2 * np.pi * turn[..., None]
    return points + shift * (np.cos(angle) * u + np.sin(angle) * np.cross(normals, u))


def distance_energy(
    distance: Float[np.ndarray, "*b n"],
    direction: Float[np.ndarray, "*b n 3"],
    radius: Float[np.ndarray, " n"],
    target: float,
) -> Term:
    """Sum the squared deviations of pad distances from `target` [m2].

    Args:
        distance: Signed distance of each contact centre [m].
        direction: Its gradient with respect to the centre.
        radius: Radius of each contact sphere [m].
        target: Wanted distance of the pad from the surface [m].

    Source:
        BiDexGrasp, section 4.3 and appendix B, E_dis; the target is BODex's staging.
    """
    e = distance - radius - target
    return Term(np.sum(e * e, axis=-1), 2 * e[..., None] * direction)


def target_energy(
    centres: Float[np.ndarray, "*b n 3"],
    points: Float[np.ndarray, "*b n 3"],
    normals_in: Float[np.ndarray, "*b n 3"],
    radius: Float[np.ndarray, " n"],
    target: float,
) -> Term:
    """Sum the squared distances of pads from their places above frozen surface points [m2].

    Source:
        BODex, stages 2 and 3 (contact points and normals frozen at the switch).
    """
    goal = points - (radius + target)[:, None] * normals_in
    e = centres - goal
    return Term(np.sum(e * e, axis=(-1, -2)), 2 * e)


def region_energy(
    contacts: Float[np.ndarray, "*b n 3"], region: Float[np.ndarray, "*b k 3"], a: float
) -> Term:
    """Sum phi of each contact point's distance to the nearest point of one hand's region [m].

    Args:
        contacts: From `contact_points`; the gradient is with respect to them.
        region: Points of the hand's region [m].
        a: Threshold of phi [m].

    Source:
        BiDexGrasp, section 4.3 and appendix B, E_region.
    """
    offsets = contacts[..., :, None, :] - region[..., None, :, :]
    squared = np.sum(offsets**2, axis=-1)
    best = np.argmin(squared, axis=-1)[..., None]
    d = np.sqrt(np.take_along_axis(squared, best, axis=-1))[..., 0]
    nearest = np.take_along_axis(offsets, best[..., None], axis=-2)[..., 0, :]
    phi, slope = region_penalty(d, a)
    scale = slope / np.maximum(d, _TINY)
    return Term(np.sum(phi, axis=-1), scale[..., None] * nearest)


def pad_energy(
    pads: Float[np.ndarray, "*b n 3"], normals_in: Float[np.ndarray, "*b n 3"], cosine: float
) -> PadTerm:
    """Sum the squared hinges max(0, cosine - pad . inward normal)^2 [-].

    Source:
        Ours; the normal term of BimanBODex as a hinge.
    """
    h = np.maximum(cosine - np.sum(pads * normals_in, axis=-1), 0.0)
    scale = -2 * h[..., None]
    return PadTerm(np.sum(h * h, axis=-1), scale * normals_in, scale * pads)


def sphere_object_energy(
    distance: Float[np.ndarray, "*b n"],
    direction: Float[np.ndarray, "*b n 3"],
    radius: Float[np.ndarray, " n"],
    margin: float,
) -> Term:
    """Sum the squared depths of spheres in the object's margin [m2].

    Args:
        distance: Signed distance of each sphere centre [m].
        direction: Its gradient.
        radius: Sphere radii [m].
        margin: Spheres nearer than this cost [m].
    """
    h = np.maximum(radius + margin - distance, 0.0)
    return Term(np.sum(h * h, axis=-1), -2 * h[..., None] * direction)


def sphere_plane_energy(
    centres: Float[np.ndarray, "*b n 3"],
    plane: Float[np.ndarray, "*b 4"],
    radius: Float[np.ndarray, " n"],
    margin: float,
) -> Term:
    """Sum the squared depths of spheres below the plane normal . x + offset = 0 [m2]."""
    normal = plane[..., None, :3]
    distance = np.sum(centres * normal, axis=-1) + plane[..., 3:]
    return sphere_object_energy(distance, np.broadcast_to(normal, centres.shape), radius, margin)


def pair_energy(
    centres: Float[np.ndarray, "*b n 3"],
    pairs: Int[np.ndarray, "P 2"],
    radius: Float[np.ndarray, " n"],
    margin: float,
) -> Term:
    """Sum the squared overlaps of listed sphere pairs [m2]; for one hand or for both at once."""
    a, b = pairs[:, 0], pairs[:, 1]
    offset = centres[..., a, :] - centres[..., b, :]
    d = np.linalg.norm(offset, axis=-1)
    h = np.maximum(radius[a] + radius[b] + margin - d, 0.0)
    push = (-2 * h / np.maximum(d, _TINY))[..., None] * offset
    gradient = np.zeros_like(centres)
    for p in range(len(pairs)):
        gradient[..., a[p], :] += push[..., p, :]
        gradient[..., b[p], :] -= push[..., p, :]
    return Term(np.sum(h * h, axis=-1), gradient)
