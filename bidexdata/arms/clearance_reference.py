"""Clearance of one arm alone in NumPy and float64: the reference of the kernels."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bidexdata.arms.arm_spheres import place_spheres
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.clearance import FAR, Clearances
from bidexdata.arms.placed_spheres import far_from_hand, first_moving
from bidexdata.arms.robot import Arm
from bidexdata.arms.surroundings import HeldHands, Placed
from bidexdata.objects.distance_field import signed_distance


def clearances_reference(
    arm: Arm,
    q: Float[np.ndarray, "N *c A"],
    placed: Placed | None,
    hands: HeldHands | None = None,
) -> Clearances:
    """`clearances` in NumPy and float64."""
    centre, radius = place_spheres(arm.chain, arm.spheres, q), arm.spheres.radius
    a, b = arm.spheres.against_self.T
    apart = np.linalg.norm(centre[..., a, :] - centre[..., b, :], axis=-1) - radius[a] - radius[b]
    itself = np.min(apart, axis=-1, initial=FAR)
    moving = slice(first_moving(arm), None)
    far, radius = centre[..., moving, :], radius[moving]
    if hands is not None:
        held, back = held_spheres(arm, q, hands), slice(0, far_from_hand(arm))
        apart = np.linalg.norm(centre[..., back, None, :] - held[..., None, :, :], axis=-1)
        gap = apart - arm.spheres.radius[back, None] - hands.radius
        itself = np.minimum(itself, np.min(gap, axis=(-1, -2), initial=FAR))
        far = np.concatenate([far, held], axis=-2)
        radius = np.concatenate([radius, hands.radius])
    table = np.min(far[..., 2] - radius, axis=-1, initial=FAR)
    near = np.full(table.shape, FAR)
    if placed is not None:
        for n in range(len(q)):
            x = (far[n] - placed.pos[n]) @ placed.rot[n]
            distance = signed_distance(placed.field, float(placed.size[n]), x)[0]
            near[n] = np.min(distance - radius, axis=-1, initial=FAR)
    for box in arm.fixtures:
        out = np.abs(far - np.array(box.pos)) - np.array(box.half)
        outside = np.linalg.norm(np.maximum(out, 0.0), axis=-1)
        gap = outside + np.minimum(out.max(axis=-1), 0.0) - radius
        itself = np.minimum(itself, np.min(gap, axis=-1, initial=FAR))
    return Clearances(table, near, itself)


def held_spheres(
    arm: Arm, q: Float[np.ndarray, "N *c A"], hands: HeldHands
) -> Float[np.ndarray, "N *c K 3"]:
    """Centres of the spheres of a hand in the world [m] at joint angles [rad] of its arm."""
    pos, rot = chain_forward(arm.chain, q)
    local = hands.pos.reshape(len(q), *[1] * (q.ndim - 2), *hands.pos.shape[1:])
    return pos[..., None, :] + np.einsum("...ij,...kj->...ki", rot, local)
