"""One optimiser step as a list of small kernel launches, recorded once and replayed.

    kinematics -> surface under the contacts -> contact energies -> closure -> chain to the
    centres -> sphere energies -> J^T -> Adam

A call of the list does not wait for the device and allocates nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from bidexdata.hands.device import record_hand_backward, record_hand_forward
from bidexdata.wrench.qp import (
    ContactQP,
    QPConfig,
    contact_qp_gradient,
    solve_contact_qp,
)

if TYPE_CHECKING:
    from bidexdata.synthesis.optimise_config import (
        AdamConfig,
        EnergyConfig,
        PhaseConfig,
    )
    from bidexdata.synthesis.workspace import HandState, Workspace

Call = Callable[[], Any]


def kinematics(ws: Workspace) -> list[Call]:
    """Poses -> contact centres, pad normals, spheres."""
    views = zip(ws.hands, ws.views("centres"), ws.views("pads"), strict=True)
    return [_forward(ws, hand, centres, pads) for hand, centres, pads in views]


def surface(ws: Workspace, energy: EnergyConfig) -> list[Call]:
    """Contact centres -> distance, closest surface point, inward normal."""
    from bidexdata.synthesis import distance_field_kernels as k

    c = ws.contacts
    return [
        _record(
            k.closest_surface,
            c.centres.shape,
            [ws.field, ws.size, energy.normal_step, c.centres],
            [c.distance, c.direction, c.points, c.normals_in],
        )
    ]


def distance_term(ws: Workspace, energy: EnergyConfig, target: float) -> list[Call]:
    """Distance of the pads to the surface; starts the centre gradient."""
    from bidexdata.synthesis import contact_kernels as k

    c = ws.contacts
    return [
        _record(
            k.contact_distance,
            c.centres.shape,
            [c.radius, energy.distance, target, c.distance, c.direction],
            [c.distance_energy, c.centre_gradient],
        )
    ]


def target_term(ws: Workspace, energy: EnergyConfig, target: float) -> list[Call]:
    """Distance of the pads to their places over frozen points; starts the centre gradient."""
    from bidexdata.synthesis import contact_kernels as k

    c = ws.contacts
    return [
        _record(
            k.contact_target,
            c.centres.shape,
            [c.radius, energy.distance, target, c.centres, c.points, c.normals_in],
            [c.distance_energy, c.centre_gradient],
        )
    ]


def region_term(ws: Workspace, energy: EnergyConfig) -> list[Call]:
    """Distance of the contacts to their hand's region."""
    from bidexdata.synthesis import contact_kernels as k

    c = ws.contacts
    return [
        _record(
            k.contact_region,
            c.centres.shape,
            [c.hand, energy.region, energy.region_threshold, c.regions, c.centres],
            [c.region_energy, c.centre_gradient],
        )
    ]


def closure_term(
    ws: Workspace, qp: ContactQP, group_weight: Any, config: QPConfig, iterations: int
) -> list[Call]:
    """The lower level, then dQ/dp and dQ/dn at its forces; starts both gradients."""
    c = ws.contacts

    def solve() -> None:
        solve_contact_qp(
            c.points, c.normals_in, ws.torque_length, qp, config, iterations=iterations
        )

    def differentiate() -> None:
        contact_qp_gradient(
            c.points,
            c.normals_in,
            ws.torque_length,
            qp,
            group_weight,
            c.point_gradient,
            c.normal_gradient,
        )

    return [solve, differentiate]


def pad_term(ws: Workspace, energy: EnergyConfig) -> list[Call]:
    """Angle between pads and surface; starts the pad gradient."""
    from bidexdata.synthesis import contact_kernels as k

    c = ws.contacts
    return [
        _record(
            k.contact_pad,
            c.centres.shape,
            [energy.pad, energy.pad_cosine, c.pads, c.normals_in],
            [c.pad_energy, c.pad_gradient, c.normal_gradient],
        )
    ]


def chain_to_centres(ws: Workspace, energy: EnergyConfig) -> list[Call]:
    """Gradients at points and normals -> centres."""
    from bidexdata.synthesis import distance_field_kernels as k

    c = ws.contacts
    inputs = [ws.field, ws.size, energy.normal_step, c.points, c.normals_in]
    inputs += [c.point_gradient, c.normal_gradient]
    return [_record(k.surface_chain, c.centres.shape, inputs, [c.centre_gradient])]


def collision_terms(ws: Workspace, energy: EnergyConfig) -> list[Call]:
    """Spheres against object, table, their own hand and the other hand."""
    return [call for h in range(len(ws.hands)) for call in _collisions_of(ws, h, energy)]


def backward(ws: Workspace) -> list[Call]:
    """Gradients at contacts, pads and spheres -> gradient of each hand's variables (J^T)."""
    views = zip(ws.hands, ws.views("centre_gradient"), ws.views("pad_gradient"), strict=True)
    return [
        record_hand_backward(
            hand.model,
            body_position=hand.body_position,
            body_rotation=hand.body_rotation,
            contact_gradient=centres,
            normal_gradient=pads,
            sphere_gradient=hand.sphere_gradient,
            gradient=hand.gradient,
        )
        for hand, centres, pads in views
    ]


def adam(ws: Workspace, rule: AdamConfig, phase: PhaseConfig) -> list[Callable[[int], None]]:
    """The step rule; each call takes the number of the step within the phase."""
    return [_adam_of(ws, hand, rule, phase) for hand in ws.hands]


def _forward(ws: Workspace, hand: HandState, centres: Any, pads: Any) -> Call:
    return record_hand_forward(
        hand.model,
        hand.position,
        hand.rotation,
        hand.joints,
        body_position=hand.body_position,
        body_rotation=hand.body_rotation,
        contact=centres,
        normal=pads,
        sphere=hand.spheres,
    )


def _collisions_of(ws: Workspace, h: int, energy: EnergyConfig) -> list[Call]:
    from bidexdata.synthesis import sphere_kernels as k

    hand, other = ws.hands[h], ws.hands[1 - h]
    radius, grid = hand.model.sphere_radius, hand.spheres.shape
    weight, pairs = energy.self_penetration, hand.model.self_pairs
    push = hand.sphere_gradient
    calls = [
        _record(
            k.sphere_object,
            grid,
            [radius, ws.field, ws.size, energy.penetration, energy.object_margin, hand.spheres],
            [hand.sphere_energy, push],
        )
    ]
    if ws.has_table:
        inputs = [radius, ws.plane, energy.penetration, energy.table_margin, hand.spheres]
        calls.append(_record(k.sphere_plane, grid, inputs, [hand.sphere_energy, push]))
    inputs = [radius, pairs, weight, energy.self_margin, hand.spheres]
    calls.append(_record(k.sphere_self, (ws.count,), inputs, [hand.self_energy, push]))
    inputs = [other.model.sphere_radius, other.spheres]
    calls.append(_record(k.hand_ball, (ws.count,), inputs, [other.ball]))
    inputs = [radius, other.model.sphere_radius, weight, energy.inter_margin]
    inputs += [hand.spheres, other.spheres, other.ball]
    calls.append(_record(k.sphere_other, grid, inputs, [hand.other_energy, push]))
    return calls


def _adam_of(
    ws: Workspace, hand: HandState, rule: AdamConfig, phase: PhaseConfig
) -> Callable[[int], None]:
    from bidexdata.synthesis.update_kernels import adam_step

    inputs = [hand.lower, hand.upper, rule.beta1, rule.beta2]
    inputs += [phase.step_position, phase.step_rotation, phase.step_joints]
    changing = len(inputs)
    inputs += [1.0, 1.0, 1.0, hand.gradient]
    outputs = [hand.first_moment, hand.second_moment]
    outputs += [hand.position, hand.rotation, hand.joints]
    launch = _launch(adam_step, (ws.count,), inputs, outputs)

    def step(i: int) -> None:
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


def _record(kernel: Any, dim: tuple[int, ...], inputs: list[Any], outputs: list[Any]) -> Call:
    return _launch(kernel, dim, inputs, outputs).launch


def _launch(kernel: Any, dim: tuple[int, ...], inputs: list[Any], outputs: list[Any]) -> Any:
    import warp as wp

    device = outputs[0].device
    return wp.launch(
        kernel, dim=dim, inputs=inputs, outputs=outputs, device=device, record_cmd=True
    )
