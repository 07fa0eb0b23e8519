"""The baseline `bodex`: BODex's three stages with one wrench closure over the contacts of both hands.

Stage 1 finds where to touch, stages 2 and 3 go to frozen contacts, at 1 cm (the pre-grasp) and at
the surface (the grasp). Kernels are those of the default method, but for the step rule. What of
BODex is not here (its convex-mesh queries, regularisers, group bounds of the QP) is listed in
`docs/baselines.md`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int

from bidexdata.synthesis import chain
from bidexdata.synthesis.attempts import Attempts, gather_starts
from bidexdata.synthesis.optimise import Optimised, found_at, read_pose
from bidexdata.synthesis.optimise_config import OptimiseConfig
from bidexdata.synthesis.staging import Press, squeeze
from bidexdata.synthesis.workspace import HandWork, Workspace, allocate
from bidexdata.wrench.qp import allocate_contact_qp
from bidexdata.wrench.qp_groups import axis_targets, qp_groups

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.synthesis.baselines.bodex_config import BodexConfig
    from bidexdata.synthesis.pose import Pose


def search(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    attempts: Sequence[Attempts],
    config: BodexConfig,
    *,
    device: str = "cpu",
) -> Optimised:
    """Optimise all starts through the three stages.

    Args:
        obj: The object.
        hands: Left and right.
        attempts: Of one or several scenes.
        config: Of the method.
        device: Warp device.
    """
    import warp as wp

    start = gather_starts(attempts)
    ws = allocate(obj, hands, start, config.torque_length * start.size, device)
    move = [_move(ws, hand, config) for hand in ws.hands]
    first, second, last = config.schedule.stage_ends
    _iterate(ws, _approach_calls(ws, config), move, range(first))
    for call in [*chain.kinematics(ws), *chain.surface(ws, config.energy_at(0.0, 1))]:
        call()
    _iterate(ws, [_settle_calls(ws, config, 1)], move, range(first, second))
    pregrasp = read_pose(ws, hands)
    _iterate(ws, [_settle_calls(ws, config, 2)], move, range(second, last))
    # The record's residuals have one torque length, whatever a method's own is.
    lengths = config.closure.torque_lengths(obj.longest_side * start.size).astype(np.float32)
    ws.torque_length.assign(wp.array(lengths, dtype=float, device=device))
    energy = config.energy_at(0.0, 1)
    return found_at(ws, hands, pregrasp, OptimiseConfig(closure=config.closure, energy=energy))


def aim(found: Optimised, press: Press, hands: Sequence[Hand], config: BodexConfig) -> Pose:
    """The squeeze: joints go on, the base stays at the grasp's."""
    target = squeeze(found.pregrasp, found.grasp, press, hands, config.staging)
    return target._replace(position=found.grasp.position, quat_wxyz=found.grasp.quat_wxyz)


def variable_groups(hand: Hand) -> Int[np.ndarray, " D"]:
    """Finger of each free variable, as a number; -1 for those of no finger.

    What carries a finger alone, as the metacarpal of the little finger, belongs to it.
    """
    of_body = {name: k for k, names in enumerate(hand.fingers.values()) for name in names}
    for k, names in enumerate(hand.fingers.values()):
        body = hand.body_names.index(names[0])
        while body > 0:
            of_body.setdefault(hand.body_names[body], k)
            body = int(hand.body_parent[body])
    group = np.full(hand.coupling.shape[1], -1, np.int32)
    for body, joint in enumerate(hand.body_joint):
        if joint >= 0:
            driver = int(np.argmax(hand.coupling[joint] != 0))
            group[driver] = max(group[driver], of_body.get(hand.body_names[body], -1))
    return group


def _approach_calls(ws: Workspace, config: BodexConfig) -> list[list[chain.Call]]:
    """Calls of the first stage: with new forces, and with those of the last solution."""
    distance = config.schedule.distances[0]
    energy = config.energy_at(distance, sum(ws.contacts_per_hand))
    groups = qp_groups(ws.contacts_per_hand, "coupled")
    targets = axis_targets()
    qp = allocate_contact_qp(ws.count, groups, targets, device=ws.device)
    weight = _array(ws, [config.energy.closure / len(targets)])

    def calls(iterations: int) -> list[chain.Call]:
        return [
            *chain.kinematics(ws),
            *chain.surface(ws, energy),
            *chain.distance_term(ws, energy, distance),
            *chain.closure_term(ws, qp, weight, config.qp, iterations),
            *chain.chain_to_centres(ws, energy),
            *chain.collision_terms(ws, energy, sphere_reach(ws, config, distance)),
            *chain.backward(ws),
        ]

    held = calls(0)
    solved = calls(config.schedule.iterations)
    return [solved, *[held] * (config.schedule.solve_every - 1)]


def _settle_calls(ws: Workspace, config: BodexConfig, stage: int) -> list[chain.Call]:
    """Calls of a stage with frozen contacts."""
    distance = config.schedule.distances[stage]
    energy = config.energy_at(distance, sum(ws.contacts_per_hand))
    return [
        *chain.kinematics(ws),
        *chain.target_term(ws, energy, distance),
        *chain.collision_terms(ws, energy, sphere_reach(ws, config, distance)),
        *chain.backward(ws),
    ]


def _iterate(
    ws: Workspace,
    cycle: Sequence[list[chain.Call]],
    moves: Sequence[Callable[[int], None]],
    steps: range,
) -> None:
    for hand in ws.hands:
        # Clearances are those of another stage's margins.
        hand.measured.zero_()
    for i, step in enumerate(steps):
        for call in cycle[i % len(cycle)]:
            call()
        for move in moves:
            move(step)


def sphere_reach(ws: Workspace, config: BodexConfig, distance: float) -> list[Any]:
    """Radius and margin of each sphere; the first ones of a hand are its contact spheres [m]."""
    own, found = config.energy, []
    for h, hand in enumerate(ws.hands):
        reach = hand.model.hand.sphere_radius + max(distance, own.other_margin)
        count = ws.contacts_per_hand[h]
        reach[:count] = hand.model.hand.sphere_radius[:count] + distance + own.contact_margin
        found.append(_array(ws, reach))
    return found


def _move(ws: Workspace, hand: HandWork, config: BodexConfig) -> Callable[[int], None]:
    import warp as wp

    from bidexdata.synthesis.baselines.bodex_kernels import normalised_step

    rule = config.schedule
    group = wp.array(variable_groups(hand.model.hand), dtype=int, device=ws.device)
    arguments = [hand.model.free_lower, hand.model.free_upper, group, rule.momentum]
    arguments += [rule.step_position, rule.step_rotation, rule.step_joints]
    at = len(arguments)
    arguments += [1.0, hand.points.gradient, hand.first_moment]
    arguments += [hand.position, hand.rotation, hand.joints]
    launch = chain.launch_of(ws, normalised_step, (ws.count,), arguments)

    def move(step: int) -> None:
        if launch:
            launch.set_param_at_index(at, rule.decay ** (step // rule.period))
            launch.launch()

    return move


def _array(ws: Workspace, values: Any) -> Any:
    import warp as wp

    return wp.array(np.asarray(values, np.float32), dtype=float, device=ws.device)
