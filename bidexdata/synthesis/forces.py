"""Contact forces of finished grasps: how balanced they are, and what joint torques they need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.simulation.settings import GRAVITY
from bidexdata.synthesis import chain
from bidexdata.wrench.qp import allocate_contact_qp, solve_contact_qp
from bidexdata.wrench.qp_groups import axis_targets, qp_groups, zero_target

if TYPE_CHECKING:
    from bidexdata.simulation.compliance import WeldStiffness
    from bidexdata.synthesis.optimise_config import ClosureConfig
    from bidexdata.synthesis.workspace import Workspace


class ContactForces(NamedTuple):
    """Zero-load QPs at the grasp."""

    residual: Float[np.ndarray, " N"]
    """Squared wrench residual of all contacts together, each hand pressing with gamma [-]."""
    residual_hand: Float[np.ndarray, "N 2"]
    """The same of each hand alone [-]."""
    forces: Float[np.ndarray, "N 2 C 3"]
    """Forces on the object of the coupled QP, object frame [caps]."""


def contact_forces(ws: Workspace, closure: ClosureConfig, iterations: int) -> ContactForces:
    """Solve the zero-load QPs of the contacts that the workspace holds.

    Source:
        docs/measurements.md, 6: the coupled residual predicts failure (AUC 0.87), per-hand ones do
        not.
    """
    c = ws.contacts
    qp = allocate_contact_qp(
        ws.count, qp_groups(ws.contacts_per_hand, "mix"), zero_target(), device=ws.device
    )
    solve_contact_qp(
        c.points, c.normals_in, ws.torque_length, qp, closure.qp, iterations=iterations
    )
    residual = qp.residual.numpy()[:, :, 0].astype(np.float64)
    forces = qp.forces.numpy()[:, 1, 0].astype(np.float64)
    return ContactForces(
        residual=residual[:, 2],
        residual_hand=residual[:, :2],
        forces=forces.reshape(ws.count, 2, forces.shape[1] // 2, 3),
    )


def shifted_residual(
    ws: Workspace,
    closure: ClosureConfig,
    normal_step: float,
    load: Float[np.ndarray, " N"],
    *,
    shift: float,
    sets: int,
    iterations: int,
) -> Float[np.ndarray, " N"]:
    """Mean coupled residual of contacts that lie a little elsewhere, under a load [-].

    Fingers touch where they happen to, about a centimetre from where they were meant to; a grasp
    whose balance needs exact places is a bad one. And they must carry the object, whichever way it
    is turned: the sets take a load along +-x, +-y, +-z in turn.

    Args:
        ws: Holds the contacts.
        closure: Constants of the QP.
        normal_step: Half width of the differences that give normals [m].
        load: Force on the object that must be balanced, in units of what a hand presses with.
        shift: How far each contact is moved along the surface [m].
        sets: Number of moved sets per grasp, each with directions of its own.
        iterations: QP iterations from zero.

    Source:
        Ours; docs/measurements.md, 14: area under the curve for failure 0.82, 0.74 without the
        shift.
    """
    import warp as wp

    from bidexdata.objects.distance_field_kernels import closest_surface
    from bidexdata.synthesis.contact_kernels import shifted_centres

    c, device = ws.contacts, ws.device
    rows = (ws.count * sets, c.points.shape[1])
    if not ws.count:
        return np.zeros(0)
    size, length = (wp.empty(rows[0], dtype=float, device=device) for _ in range(2))
    centres, slope, points, normals = (
        wp.zeros(rows, dtype=wp.vec3, device=device) for _ in range(4)
    )
    distance = wp.empty(rows, dtype=float, device=device)
    wp.launch(
        shifted_centres,
        dim=rows,
        inputs=[
            *(c.hand, sets, shift, *(hand.position for hand in ws.hands)),
            *(c.points, c.normals_in, ws.size, ws.torque_length),
        ],
        outputs=[centres, size, length],
        device=device,
    )
    wp.launch(
        closest_surface,
        dim=rows,
        inputs=[ws.field, size, normal_step, centres],
        outputs=[distance, slope, points, normals],
        device=device,
    )
    groups = qp_groups(ws.contacts_per_hand, "coupled")
    carried = np.zeros((ws.count, sets, 1, 2, 3))
    along = axis_targets()[np.arange(sets) % len(axis_targets()), 0]
    carried[:, :, 0, 0] = closure.qp.gamma * load[:, None, None] * along
    targets = carried.reshape(rows[0], 1, 2, 3)
    qp = allocate_contact_qp(rows[0], groups, targets, device=device)
    unscaled = replace(closure.qp, beta=1.0)  # the targets are the loads themselves
    solve_contact_qp(points, normals, length, qp, unscaled, iterations=iterations)
    return qp.residual.numpy().reshape(ws.count, sets).astype(np.float64).mean(axis=1)


def wanted_press(
    mass: Float[np.ndarray, " N"], floor: float, per_weight: float
) -> Float[np.ndarray, " N"]:
    """Sum of the normal forces that each hand is to press with [N].

    Args:
        mass: Of the object [kg].
        floor: Least sum of a hand's normal forces [N].
        per_weight: The same per newton of weight [-].
    """
    return np.asarray(np.maximum(floor, per_weight * GRAVITY * mass))


def weight_share(
    mass: Float[np.ndarray, " N"], wanted: Float[np.ndarray, " N"]
) -> Float[np.ndarray, " N"]:
    """The object's weight over what each hand presses with [-]; 0 where that is nothing."""
    return np.asarray(np.where(wanted > 0, GRAVITY * mass / np.maximum(wanted, 1e-9), 0.0))


def force_scales(
    forces: Float[np.ndarray, "N 2 C 3"],
    normals_in: Float[np.ndarray, "N 2 C 3"],
    wanted: Float[np.ndarray, " N"],
) -> Float[np.ndarray, "N 2"]:
    """Newtons per unit of force, so that each hand presses as `wanted_press` says.

    Args:
        forces: Of the coupled QP [caps].
        normals_in: Inward unit normals.
        wanted: [N].
    """
    pressed = np.sum(np.sum(forces * normals_in, axis=-1), axis=-1)
    return np.where(pressed > 1e-6, wanted[:, None] / np.maximum(pressed, 1e-6), 0.0)


class BaseGive(NamedTuple):
    """How far the hands' bases give way while the fingers press, object frame."""

    shift: Float[np.ndarray, "N 2 3"]
    """[m]."""
    turn: Float[np.ndarray, "N 2 3"]
    """Rotation vectors about the hand frames' origins [rad]."""


def base_give(
    points: Float[np.ndarray, "N 2 C 3"],
    forces: Float[np.ndarray, "N 2 C 3"],
    position: Float[np.ndarray, "N 2 3"],
    stiffness: Sequence[WeldStiffness],
) -> BaseGive:
    """Give what a base's target must lead by, so that its weld holds against the fingers' forces.

    Args:
        points: Where they act, object frame [m].
        forces: On the object [N].
        position: Origins of the hand frames [m].
        stiffness: Of each hand's weld.

    Source:
        Ours; docs/measurements.md, 17: a weld turns by 5 degrees under 1 N m.
    """
    arm = points - position[:, :, None]
    force, torque = forces.sum(axis=2), np.cross(arm, forces).sum(axis=2)
    shift, turn = np.array(stiffness).T[..., None]
    return BaseGive(force / shift, torque / turn)


def joint_torques(
    ws: Workspace, forces: Float[np.ndarray, "N 2 C 3"]
) -> list[Float[np.ndarray, "N D"]]:
    """Generalised torques J^T f [N m] on each hand's free variables that exert forces [N].

    Args:
        ws: Holds the state at the grasp; its contact centres and gradients are overwritten.
        forces: On the object at its surface points under the pads, object frame [N].
    """
    import warp as wp

    c = ws.contacts
    flat = np.ascontiguousarray(forces.reshape((*c.centres.shape, 3)), np.float32)
    c.centre_gradient.assign(wp.array(flat, dtype=wp.vec3, device=ws.device))
    c.pad_gradient.zero_()
    for hand in ws.hands:
        hand.points.sphere_grad.zero_()
    for place in chain.kinematics(ws):
        place()
    # The fingers feel the forces where they touch, not at the middle of their contact spheres.
    wp.copy(c.centres, c.points)
    for pull in chain.backward(ws):
        pull()
    return [hand.points.gradient.numpy()[:, 6:].astype(np.float64) for hand in ws.hands]
