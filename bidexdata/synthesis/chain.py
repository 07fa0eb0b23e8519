"""One optimiser step as a list of small kernel launches, recorded once and replayed.

    kinematics -> surface under the contacts -> contact energies -> closure -> chain to the
    centres -> sphere energies -> J^T -> Adam

A call of the list does not wait for the device and allocates nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from bidexdata.hands.device import backward_arguments, forward_arguments
from bidexdata.hands.kinematics_kernels import hand_backward, hand_forward
from bidexdata.objects import distance_field_kernels
from bidexdata.synthesis import contact_kernels, sphere_kernels
from bidexdata.synthesis.update_kernels import adam_step
from bidexdata.wrench.qp import ContactQP, QPConfig, gradient_arguments, solve_arguments
from bidexdata.wrench.qp_kernels import contact_qp_gradient_kernel, contact_qp_kernel

if TYPE_CHECKING:
    from bidexdata.synthesis.optimise_config import (
        AdamConfig,
        ClosureConfig,
        EnergyConfig,
        PhaseConfig,
    )
    from bidexdata.synthesis.workspace import HandWork, Workspace

Call = Callable[[], Any]


def kinematics(ws: Workspace) -> list[Call]:
    """Poses -> contact centres, pad normals, spheres."""
    calls = []
    for hand in ws.hands:
        pose = (hand.position, hand.rotation, hand.joints)
        arguments = forward_arguments(hand.model, hand.points, *pose)
        calls.append(recorded(ws, hand_forward, (ws.count,), arguments))
    return calls


def surface(ws: Workspace, energy: EnergyConfig) -> list[Call]:
    """Contact centres -> distance, closest surface point, inward normal."""
    c = ws.contacts
    arguments = [ws.field, ws.size, energy.normal_step, c.centres]
    arguments += [c.distance, c.direction, c.points, c.normals_in]
    return [recorded(ws, distance_field_kernels.closest_surface, c.centres.shape, arguments)]


def distance_term(ws: Workspace, energy: EnergyConfig, target: float) -> list[Call]:
    """Distance of the pads to the surface; starts the centre gradient."""
    c = ws.contacts
    arguments = [c.radius, energy.distance, target, c.distance, c.direction]
    arguments += [c.distance_energy, c.centre_gradient]
    return [recorded(ws, contact_kernels.contact_distance, c.centres.shape, arguments)]


def target_term(ws: Workspace, energy: EnergyConfig, target: float) -> list[Call]:
    """Distance of the pads to their places over frozen points; starts the centre gradient."""
    c = ws.contacts
    arguments = [c.radius, energy.distance, target, c.centres, c.points, c.normals_in]
    arguments += [c.distance_energy, c.centre_gradient]
    return [recorded(ws, contact_kernels.contact_target, c.centres.shape, arguments)]


def region_term(ws: Workspace, energy: EnergyConfig) -> list[Call]:
    """Distance of the contacts to their hand's region; adds to centre and normal gradient."""
    c = ws.contacts
    arguments = [c.hand, c.radius, energy.region, energy.region_threshold]
    arguments += [c.regions, c.centres, c.normals_in]
    arguments += [c.region_energy, c.centre_gradient, c.normal_gradient]
    return [recorded(ws, contact_kernels.contact_region, c.centres.shape, arguments)]


def closure_term(
    ws: Workspace, qp: ContactQP, group_weight: Any, config: QPConfig, iterations: int
) -> list[Call]:
    """The lower level, then dQ/dp and dQ/dn at its forces; starts both gradients."""
    c = ws.contacts
    problem = (c.points, c.normals_in, ws.torque_length, qp)
    solve = solve_arguments(*problem, config, iterations)
    back = gradient_arguments(*problem, group_weight, c.point_gradient, c.normal_gradient)
    return [
        recorded(ws, contact_qp_kernel, qp.residual.shape, solve),
        recorded(ws, contact_qp_gradient_kernel, c.points.shape, back),
    ]


def circling_closure_term(
    ws: Workspace,
    qp: ContactQP,
    group_weight: Any,
    closure: ClosureConfig,
    energy: EnergyConfig,
    steps: int,
) -> list[Call]:
    """The closure term of contacts that circle about their places, once per call of the list.

    The gradient is that at the moved contact, whose direction from the pad's place is held. It goes
    straight to the centres: the gradients at the unmoved points start at zero.
    """
    c, shape = ws.contacts, ws.contacts.centres.shape
    centres, slope, points, normals, point_gradient, normal_gradient = (
        wp.zeros(shape, dtype=wp.vec3, device=ws.device) for _ in range(6)
    )
    distance = wp.zeros(shape, dtype=float, device=ws.device)
    bases = [hand.position for hand in ws.hands]
    arguments = [c.hand, closure.shift, 0.0, *bases, c.points, c.normals_in, centres]
    circle = launch_of(ws, contact_kernels.circling_centres, shape, arguments)
    done = itertools.count()

    def move() -> None:
        if circle:
            circle.set_param_at_index(2, closure.turns * next(done) / steps)
            circle.launch()

    def start() -> None:
        c.point_gradient.zero_()
        c.normal_gradient.zero_()

    problem = (points, normals, ws.torque_length, qp)
    solve = solve_arguments(*problem, closure.qp, closure.iterations)
    differentiate = gradient_arguments(*problem, group_weight, point_gradient, normal_gradient)
    field = [ws.field, ws.size, energy.normal_step]
    to_surface = [*field, centres, distance, slope, points, normals]
    back = [*field, points, normals, point_gradient, normal_gradient, c.centre_gradient]
    return [
        move,
        recorded(ws, distance_field_kernels.closest_surface, shape, to_surface),
        recorded(ws, contact_qp_kernel, qp.residual.shape, solve),
        recorded(ws, contact_qp_gradient_kernel, shape, differentiate),
        start,
        recorded(ws, distance_field_kernels.surface_chain, shape, back),
    ]


def pad_term(ws: Workspace, energy: EnergyConfig) -> list[Call]:
    """Angle between pads and surface; starts the pad gradient."""
    c = ws.contacts
    arguments = [energy.pad, energy.pad_cosine, c.pads, c.normals_in]
    arguments += [c.pad_energy, c.pad_gradient, c.normal_gradient]
    return [recorded(ws, contact_kernels.contact_pad, c.centres.shape, arguments)]


def chain_to_centres(ws: Workspace, energy: EnergyConfig) -> list[Call]:
    """Gradients at points and normals -> centres."""
    c = ws.contacts
    arguments = [ws.field, ws.size, energy.normal_step, c.points, c.normals_in]
    arguments += [c.point_gradient, c.normal_gradient, c.centre_gradient]
    return [recorded(ws, distance_field_kernels.surface_chain, c.centres.shape, arguments)]


def collision_terms(
    ws: Workspace, energy: EnergyConfig, reach: Sequence[Any] | None = None
) -> list[Call]:
    """Spheres against object, table, their own hand and the other hand.

    Args:
        ws: The grasps.
        energy: Weights and margins.
        reach: How far each sphere of each hand reaches towards the object before its margin [m],
            (K,) each; their radii when omitted, with contact spheres at their own margin.
    """
    reach = reach or [_reach(ws, hand, energy) for hand in ws.hands]
    calls = [call for h in range(len(ws.hands)) for call in _collisions_of(ws, h, energy, reach[h])]
    return [*calls, _between_hands(ws, energy)]


def _reach(ws: Workspace, hand: HandWork, energy: EnergyConfig) -> Any:
    """Radii, such that the margin of all spheres is that of contact spheres for these."""
    own = hand.model.hand
    reach = own.sphere_radius.copy()
    reach[: own.fingertips] += energy.contact_margin - energy.object_margin
    return wp.array(reach.astype(np.float32), dtype=float, device=ws.device)


def backward(ws: Workspace) -> list[Call]:
    """Gradients at contacts, pads and spheres -> gradient of each hand's variables (J^T)."""
    return [
        recorded(ws, hand_backward, (ws.count,), backward_arguments(hand.model, hand.points))
        for hand in ws.hands
    ]


def adam(ws: Workspace, rule: AdamConfig, phase: PhaseConfig) -> list[Callable[[int], None]]:
    """The step rule; each call takes the number of the step within the phase."""
    return [_adam_of(ws, hand, rule, phase) for hand in ws.hands]


def _collisions_of(ws: Workspace, h: int, energy: EnergyConfig, reach: Any) -> list[Call]:
    k, hand = sphere_kernels, ws.hands[h]
    model, centres, push = hand.model, hand.points.sphere, hand.points.sphere_grad
    radius, depth = model.sphere_radius, energy.penetration
    one = (ws.count,)

    arguments = [reach, ws.field, ws.size, depth, energy.object_margin, centres]
    arguments += [hand.measured, hand.sphere_energy, push]
    calls = [recorded(ws, k.sphere_object, one, arguments)]
    if ws.has_table:
        arguments = [radius, ws.plane, depth, energy.table_margin, centres]
        calls.append(recorded(ws, k.sphere_plane, one, [*arguments, hand.sphere_energy, push]))
    arguments = [radius, model.self_pairs, model.pair_groups, model.group_reach]
    arguments += [energy.self_penetration, energy.self_margin, centres, hand.self_energy, push]
    calls.append(recorded(ws, k.sphere_self, one, arguments))
    return calls


def _between_hands(ws: Workspace, energy: EnergyConfig) -> Call:
    """Spheres of one hand against those of the other; adds to both sphere gradients."""
    models = [hand.model for hand in ws.hands]
    arguments = [model.sphere_radius for model in models]
    arguments += [ball for model in models for ball in (model.ball_hub, model.ball_radius)]
    arguments += [energy.self_penetration, energy.inter_margin]
    arguments += [hand.points.sphere for hand in ws.hands]
    arguments += [ws.between_energy, *(hand.points.sphere_grad for hand in ws.hands)]
    return recorded(ws, sphere_kernels.hands_between, (ws.count,), arguments)


def _adam_of(
    ws: Workspace, hand: HandWork, rule: AdamConfig, phase: PhaseConfig
) -> Callable[[int], None]:
    arguments = [hand.model.free_lower, hand.model.free_upper, rule.beta1, rule.beta2]
    arguments += [phase.step_position, phase.step_rotation, phase.step_joints]
    changing = len(arguments)
    arguments += [1.0, 1.0, 1.0, hand.points.gradient, hand.first_moment, hand.second_moment]
    arguments += [hand.position, hand.rotation, hand.joints]
    launch = launch_of(ws, adam_step, (ws.count,), arguments)

    def step(i: int) -> None:
        if not launch:
            return
        done = i / max(phase.steps - 1, 1)
        values = (
            1.0 - (1.0 - rule.final_fraction) * done,
            1.0 / (1.0 - rule.beta1 ** (i + 1)),
            1.0 / (1.0 - rule.beta2 ** (i + 1)),
        )
        for k, value in enumerate(values):
            launch.set_param_at_index(changing + k, value)
        launch.launch()

    return step


def recorded(ws: Workspace, kernel: Any, dim: tuple[int, ...], arguments: list[Any]) -> Call:
    """A launch with fixed arguments, as a call."""
    launch = launch_of(ws, kernel, dim, arguments)
    # Warp records nothing for a batch without grasps.
    return launch.launch if launch else lambda: None


def launch_of(ws: Workspace, kernel: Any, dim: tuple[int, ...], arguments: list[Any]) -> Any:
    """A recorded launch, whose arguments can be changed; None for a batch without grasps."""
    return wp.launch(kernel, dim=dim, inputs=arguments, device=ws.device, record_cmd=True)
