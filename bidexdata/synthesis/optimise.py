"""Decoupled bilevel optimisation of two-handed grasps, a whole batch at once.

Upper level: Adam on both hands' poses. Lower level: contact forces, a few warm-started iterations
per step. Three phases: the approach finds where to touch with the pads held off the surface; the
pre-grasp and the grasp then move the pads to fixed distances over those points.

Source: BiDexGrasp, sections 4.3 and 4.4; phases as in BODex; step rule and weights measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.synthesis import chain
from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.readout import Energies, read_energies, read_pose
from bidexdata.synthesis.workspace import Start, Workspace, allocate
from bidexdata.wrench.qp import ContactQP, allocate_contact_qp, solve_contact_qp
from bidexdata.wrench.qp_groups import axis_targets, qp_groups, zero_target

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.synthesis.optimise_config import ClosureConfig, OptimiseConfig, PhaseConfig


READOUT_ITERATIONS = 100
"""QP iterations, from zero, behind the recorded `energy_qp`, at least [-]. Ours: 40 rank like 1500
(docs/measurements.md, 2), and one evaluation per grasp costs little beside the steps."""


class Look(NamedTuple):
    """One look at an optimisation: the energies on the device are those of the poses on it."""

    phase: Literal["approach", "pregrasp", "grasp", "end"]
    """`end` is the evaluation of the finished grasp."""
    step: int
    """Within the phase; its move is still to come."""
    workspace: Workspace
    closure: ContactQP | None
    """Residuals of the contact groups; None in phases without closure and region terms."""


Watch = Callable[[Look], None]
"""Looks at the state of every step, between its energies and its move. Must not change it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Optimised:
    """What the optimisation found, and its device arrays, which hold the state at the grasp."""

    pregrasp: Pose
    """Joints of opened grasps may lie beyond their limits here, for the squeeze goes by them."""
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
    watch: Watch | None = None,
) -> Optimised:
    """Turn starts into pre-grasps and grasps. Draws nothing at random.

    Args:
        obj: The object; every grasp has its own size of it.
        hands: Left and right.
        start: N starts.
        config: Energies, closure, phases.
        device: Warp device.
        watch: Looks on.
    """
    lengths = config.closure.torque_lengths(obj.longest_side * start.size)
    ws = allocate(obj, hands, start, lengths, device)
    _approach(ws, config, watch)
    _settle(ws, config, "pregrasp", watch)
    pregrasp = read_pose(ws, hands)
    _settle(ws, config, "grasp", watch)
    return found_at(ws, hands, pregrasp, config, watch)


def found_at(
    ws: Workspace,
    hands: Sequence[Hand],
    pregrasp: Pose,
    config: OptimiseConfig,
    watch: Watch | None = None,
) -> Optimised:
    """Collect what stands on the device as the grasp, with its contacts and energies."""
    energies = _evaluate(ws, config, watch)
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


def _approach(ws: Workspace, config: OptimiseConfig, watch: Watch | None) -> None:
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
    look = None if watch is None else lambda i: watch(Look("approach", i, ws, qp))
    _iterate(ws, step, config, phase, look)
    for call in run:
        call()


def _settle(
    ws: Workspace,
    config: OptimiseConfig,
    name: Literal["pregrasp", "grasp"],
    watch: Watch | None,
) -> None:
    """Phases 2 and 3: pads to a distance over the surface points of the state, which stay."""
    energy = config.energy
    phase: PhaseConfig = getattr(config, name)
    ws.contacts.normal_gradient.zero_()
    step = [
        *chain.kinematics(ws),
        *chain.target_term(ws, energy, phase.distance),
        *chain.pad_term(ws, energy),
        *chain.collision_terms(ws, energy),
        *chain.backward(ws),
    ]
    look = None if watch is None else lambda i: watch(Look(name, i, ws, None))
    _iterate(ws, step, config, phase, look)


def _iterate(
    ws: Workspace,
    step: list[chain.Call],
    config: OptimiseConfig,
    phase: PhaseConfig,
    look: Callable[[int], None] | None,
) -> None:
    for hand in ws.hands:
        hand.first_moment.zero_()
        hand.second_moment.zero_()
    moves = chain.adam(ws, config.adam, phase)
    for i in range(phase.steps):
        for call in step:
            call()
        if look is not None:
            look(i)
        for move in moves:
            move(i)


def _evaluate(ws: Workspace, config: OptimiseConfig, watch: Watch | None) -> Energies:
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
        iterations=max(closure.start_iterations, READOUT_ITERATIONS),
    )
    if watch is not None:
        watch(Look("end", 0, ws, qp))
    return read_energies(ws, qp)


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
