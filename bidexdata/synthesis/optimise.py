"""Decoupled bilevel optimisation of two-handed grasps, a whole batch at once.

Upper level: Adam on both hands' poses. Lower level: contact forces, a few warm-started iterations
per step. Three phases: the approach finds where to touch with the pads held off the surface; the
pre-grasp and the grasp then move the pads to fixed distances over those points.

Source: BiDexGrasp, sections 4.3 and 4.4; phases as in BODex; step rule and weights measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.frames import quat_from_matrix
from bidexdata.synthesis import chain
from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.workspace import Start, Workspace, allocate
from bidexdata.wrench.qp import ContactQP, allocate_contact_qp, solve_contact_qp
from bidexdata.wrench.qp_groups import axis_targets, qp_groups, zero_target

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.synthesis.optimise_config import ClosureConfig, OptimiseConfig, PhaseConfig


class Energies(NamedTuple):
    """Unweighted energies of N grasps at the grasp."""

    distance: Float[np.ndarray, " N"]
    region: Float[np.ndarray, " N"]
    pad: Float[np.ndarray, " N"]
    penetration: Float[np.ndarray, " N"]
    self_penetration: Float[np.ndarray, " N"]
    closure: Float[np.ndarray, " N"]
    """Q over all groups and disturbances of the configuration."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Optimised:
    """What the optimisation found, and its device arrays, which hold the state at the grasp."""

    pregrasp: Pose
    grasp: Pose
    energies: Energies
    points: Float[np.ndarray, "N 2 C 3"]
    """Surface points closest to the contact points, at the grasp [m]."""
    normals_in: Float[np.ndarray, "N 2 C 3"]
    """Inward unit normals there."""
    gaps: Float[np.ndarray, "N 2 C"]
    """Signed distance of each pad from the surface [m]; NaN at padding."""
    workspace: Workspace


def optimise(
    obj: PreparedObject,
    hands: Sequence[Hand],
    start: Start,
    config: OptimiseConfig,
    *,
    device: str = "cpu",
) -> Optimised:
    """Turn starts into pre-grasps and grasps. Draws nothing at random.

    Args:
        obj: The object; every grasp has its own size of it.
        hands: Left and right.
        start: N starts.
        config: Energies, closure, phases.
        device: Warp device.
    """
    ws = allocate(obj, hands, start, torque_lengths(obj, start.size, config.closure), device)
    _approach(ws, config)
    _settle(ws, config, config.pregrasp)
    pregrasp = read_pose(ws, hands)
    _settle(ws, config, config.grasp)
    return found_at(ws, hands, pregrasp, config)


def found_at(
    ws: Workspace, hands: Sequence[Hand], pregrasp: Pose, config: OptimiseConfig
) -> Optimised:
    """Collect what stands on the device as the grasp, with its contacts and energies."""
    energies = _evaluate(ws, config)
    grasp = read_pose(ws, hands)
    contacts = ws.contacts
    shape = (ws.count, 2, contacts.centres.shape[1] // 2)
    gaps = (contacts.distance.numpy() - contacts.radius.numpy()).reshape(shape).copy()
    for h, count in enumerate(ws.contacts_per_hand):
        gaps[:, h, count:] = np.nan
    return Optimised(
        pregrasp=pregrasp,
        grasp=grasp,
        energies=energies,
        points=contacts.points.numpy().reshape(*shape, 3).copy(),
        normals_in=contacts.normals_in.numpy().reshape(*shape, 3).copy(),
        gaps=gaps,
        workspace=ws,
    )


def torque_lengths(
    obj: PreparedObject, size: Float[np.ndarray, " N"], closure: ClosureConfig
) -> Float[np.ndarray, " N"]:
    """Length that divides torques in the closure energy [m]."""
    longest = float(np.max(np.ptp(obj.hull.vertices, axis=0)))
    return np.maximum(closure.torque_length * longest * size, closure.least_torque_length)


def read_pose(ws: Workspace, hands: Sequence[Hand]) -> Pose:
    """Copy the hands' poses from the device."""
    joints = []
    for hand, state in zip(hands, ws.hands, strict=True):
        u = state.joints.numpy().astype(np.float64)
        # One product per joint, so that the batch's size cannot change the rounding.
        q = np.sum(u[:, None, :] * hand.coupling[None], axis=2)
        joints.append(np.clip(q, hand.joint_lower, hand.joint_upper))
    rotations = np.stack([s.rotation.numpy() for s in ws.hands], axis=1).astype(np.float64)
    finite = np.all(np.isfinite(rotations), axis=(-1, -2))
    quats = quat_from_matrix(np.where(finite[..., None, None], rotations, np.eye(3)))
    position = np.stack([s.position.numpy() for s in ws.hands], axis=1).astype(np.float64)
    position[~finite] = np.nan
    return Pose(position, quats, (joints[0], joints[1]))


def _approach(ws: Workspace, config: OptimiseConfig) -> None:
    """Phase 1: closure, distance, region; where to touch."""
    energy, closure, phase = config.energy, config.closure, config.approach
    qp, weights = closure_problem(ws, closure)
    run = [*chain.kinematics(ws), *chain.surface(ws, energy)]
    for call in run:
        call()
    constants = closure.qp
    c = ws.contacts
    solve_contact_qp(
        c.points,
        c.normals_in,
        ws.torque_length,
        qp,
        constants,
        iterations=closure.start_iterations,
    )
    if closure.shift > 0:
        closing = chain.circling_closure_term(ws, qp, weights, closure, energy, phase.steps)
    else:
        closing = chain.closure_term(ws, qp, weights, constants, closure.iterations)
    step = [
        *run,
        *chain.distance_term(ws, energy, phase.distance),
        *closing,
        *chain.region_term(ws, energy),
        *chain.pad_term(ws, energy),
        *chain.chain_to_centres(ws, energy),
        *chain.collision_terms(ws, energy),
        *chain.backward(ws),
    ]
    _iterate(ws, step, config, phase)
    for call in run:
        call()


def _settle(ws: Workspace, config: OptimiseConfig, phase: PhaseConfig) -> None:
    """Phases 2 and 3: pads to a distance over the surface points of the state, which stay."""
    energy = config.energy
    ws.contacts.normal_gradient.zero_()
    step = [
        *chain.kinematics(ws),
        *chain.target_term(ws, energy, phase.distance),
        *chain.pad_term(ws, energy),
        *chain.collision_terms(ws, energy),
        *chain.backward(ws),
    ]
    _iterate(ws, step, config, phase)


def _iterate(
    ws: Workspace, step: list[chain.Call], config: OptimiseConfig, phase: PhaseConfig
) -> None:
    for hand in ws.hands:
        hand.first_moment.zero_()
        hand.second_moment.zero_()
    moves = chain.adam(ws, config.adam, phase)
    for i in range(phase.steps):
        for call in step:
            call()
        for move in moves:
            move(i)


def _evaluate(ws: Workspace, config: OptimiseConfig) -> Energies:
    """Surface under the pads and all energies of the state."""
    energy, closure = config.energy, config.closure
    qp, _ = closure_problem(ws, closure)
    for call in [
        *chain.kinematics(ws),
        *chain.surface(ws, energy),
        *chain.distance_term(ws, energy, 0.0),
        *chain.region_term(ws, energy),
        *chain.pad_term(ws, energy),
        *chain.collision_terms(ws, energy),
    ]:
        call()
    c = ws.contacts
    solve_contact_qp(
        c.points,
        c.normals_in,
        ws.torque_length,
        qp,
        closure.qp,
        iterations=max(closure.start_iterations, 100),
    )
    real = np.zeros((2, c.centres.shape[1] // 2), bool)
    for h, count in enumerate(ws.contacts_per_hand):
        real[h, :count] = True

    def per_grasp(values: Any, columns: slice | np.ndarray = slice(None)) -> np.ndarray:
        # Contiguous rows are summed alike whatever their number.
        rows = np.ascontiguousarray(values.numpy()[:, columns])
        return np.asarray(np.sum(rows, axis=tuple(range(1, rows.ndim)), dtype=np.float64))

    depth = [per_grasp(s.sphere_energy) for s in ws.hands]
    other = [per_grasp(s.other_energy) for s in ws.hands]
    own = [s.self_energy.numpy().astype(np.float64) for s in ws.hands]
    places = real.ravel()
    return Energies(
        distance=per_grasp(c.distance_energy, places),
        region=per_grasp(c.region_energy, places),
        pad=per_grasp(c.pad_energy, places),
        penetration=depth[0] + depth[1],
        self_penetration=own[0] + own[1] + other[0] + other[1],
        closure=per_grasp(qp.residual),
    )


def closure_problem(ws: Workspace, closure: ClosureConfig) -> tuple[ContactQP, Any]:
    """QPs of the configured contact groups, and the weight of each group."""
    import warp as wp

    groups = qp_groups(ws.contacts_per_hand, closure.groups)
    targets = axis_targets() if closure.disturbances == "forces" else zero_target()
    # A group of one hand is decoupled, a group of several is coupled.
    by_size = {1: closure.weight_decoupled}
    weights = [by_size.get(h, closure.weight_coupled) for h in groups.hands]
    qp = allocate_contact_qp(ws.count, groups, targets, device=ws.device)
    return qp, wp.array(np.asarray(weights, np.float32), dtype=float, device=ws.device)
