"""The annealing's device arrays and its loop: propose, evaluate, accept.

One proposal costs some 30 launches, recorded once; only step length, temperature and the number of
the proposal change between them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from bidexdata.objects import distance_field_kernels
from bidexdata.synthesis import chain, sphere_kernels
from bidexdata.synthesis.baselines import annealing_kernels, bimangrasp_kernels
from bidexdata.synthesis.baselines.bimangrasp_energies import Terms

if TYPE_CHECKING:
    from bidexdata.synthesis.baselines.bimangrasp_config import (
        AnnealingConfig,
        BimanGraspConfig,
        BimanGraspEnergyConfig,
    )
    from bidexdata.synthesis.workspace import Workspace

Call = Callable[[], Any]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class KeptHand:
    """What was last accepted of one hand, shapes as in `HandWork`."""

    position: Any
    rotation: Any
    joints: Any
    gradient: Any
    """(N, 6 + D)."""
    squares: Any
    """Running mean of squared gradients, (scenes, 6 + D)."""
    owner: Any
    """Sphere that each object point is deepest in, or -1, (N, P) int."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Annealing:
    """All arrays of one annealing; the workspace holds the proposals."""

    ws: Workspace
    """Its contacts are the candidates; then come the right hand's surface points."""
    kept: tuple[KeptHand, KeptHand]
    candidates: tuple[int, int]
    """Candidates of each hand."""
    points: Any
    """Surface points of the object [m], (N, P) vec3."""
    scene: Any
    """Scene of each grasp, (N,) int."""
    first: Any
    """First grasp of each scene, and the end, (scenes + 1,) int."""
    seed: Any
    """(N,) int."""
    terms: Any
    kept_terms: Any
    """Unweighted energies in the order of `Terms`, of proposals and of what is kept, (N, 6)."""
    energy: Any
    """Weighted sum of the kept ones, (N,)."""
    taken: Any
    """Whether the last proposal was accepted, (N,) int."""


def allocate_annealing(
    ws: Workspace,
    points: np.ndarray,
    size: np.ndarray,
    candidates: tuple[int, int],
    first: np.ndarray,
    seed: np.ndarray,
) -> Annealing:
    """Make the arrays beside a workspace.

    Args:
        ws: Holds the starts.
        points: Of the object's surface, unit diagonal, (P, 3).
        size: Diagonal of each grasp's object [m], (N,).
        candidates: Contact candidates of each hand.
        first: First grasp of each scene, and the end.
        seed: Of each grasp.
    """
    n, device = ws.count, ws.device
    placed = (size[:, None, None] * points).astype(np.float32)
    scene = np.repeat(np.arange(len(first) - 1), np.diff(first)).astype(np.int32)

    def zeros(shape: Any, dtype: Any = float) -> Any:
        return wp.zeros(shape, dtype=dtype, device=device)

    def kept(hand: Any) -> KeptHand:
        width = hand.points.gradient.shape[1]
        return KeptHand(
            position=wp.clone(hand.position),
            rotation=wp.clone(hand.rotation),
            joints=wp.clone(hand.joints),
            gradient=zeros((n, width)),
            squares=zeros((len(first) - 1, width)),
            owner=zeros((n, len(points)), int),
        )

    return Annealing(
        ws=ws,
        kept=(kept(ws.hands[0]), kept(ws.hands[1])),
        candidates=candidates,
        points=wp.array(placed, dtype=wp.vec3, device=device),
        scene=wp.array(scene, dtype=int, device=device),
        first=wp.array(first, dtype=int, device=device),
        seed=wp.array(seed, dtype=int, device=device),
        terms=zeros((n, 6)),
        kept_terms=zeros((n, 6)),
        energy=zeros(n),
        taken=zeros(n, int),
    )


def anneal(state: Annealing, config: BimanGraspConfig) -> None:
    """Run the whole schedule; afterwards the workspace's poses are those that are kept."""
    ws, rule = state.ws, config.annealing
    if not ws.count:
        return
    contacts = first_contacts(state, config.energy)
    proposed = wp.clone(contacts)
    evaluate = energy_calls(state, config.energy, proposed)
    judge = _judging(state, config.energy, proposed, contacts)
    propose = _proposals(state, rule, contacts, proposed)
    for call in [*evaluate, lambda: judge(0, rule.temperature)]:
        call()
    for number in range(1, rule.steps + 1):
        step = rule.step * rule.step_decay ** (number // rule.step_period)
        temperature = temperature_at(rule, number)
        propose(number, step, temperature)
        for call in evaluate:
            call()
        judge(number, temperature)
    for hand, kept in zip(ws.hands, state.kept, strict=True):
        wp.copy(hand.position, kept.position)
        wp.copy(hand.rotation, kept.rotation)
        wp.copy(hand.joints, kept.joints)


def temperature_at(rule: AnnealingConfig, number: int) -> float:
    """Temperature of a proposal [-]; single precision needs it above zero."""
    return max(
        rule.temperature * rule.temperature_decay ** (number // rule.temperature_period), 1e-30
    )


def kept_terms(state: Annealing) -> Terms:
    """Unweighted energies of what is kept."""
    return Terms(*state.kept_terms.numpy().astype(np.float64).T)


def first_contacts(state: Annealing, energy: BimanGraspEnergyConfig) -> Any:
    """Draw the first contacts of each grasp among its hands' candidates, (N, 2 c) int."""
    drawn = []
    for seed in state.seed.numpy():
        rng = np.random.default_rng(int(seed))
        drawn.append([rng.integers(0, n, energy.contacts) for n in state.candidates])
    index = np.reshape(np.array(drawn, np.int32), (state.ws.count, 2 * energy.contacts))
    return wp.array(index, dtype=int, device=state.ws.device)


def energy_calls(state: Annealing, energy: BimanGraspEnergyConfig, index: Any) -> list[Call]:
    """Poses and contacts of the workspace -> terms, and the gradient of each hand's variables."""
    ws = state.ws
    return [
        *chain.kinematics(ws),
        state.terms.zero_,
        ws.contacts.centre_gradient.zero_,
        *(hand.points.sphere_grad.zero_ for hand in ws.hands),
        *_contact_calls(state, energy, index),
        *_collision_calls(state, energy),
        *chain.backward(ws),
        *_limit_calls(state, energy),
    ]


def _contact_calls(state: Annealing, energy: BimanGraspEnergyConfig, index: Any) -> list[Call]:
    ws, k = state.ws, bimangrasp_kernels
    c, each = ws.contacts, (ws.count, 2 * energy.contacts)
    chosen, slope, nearest, normals, gradient = (
        wp.zeros(each, dtype=wp.vec3, device=ws.device) for _ in range(5)
    )
    distance = wp.zeros(each, dtype=float, device=ws.device)
    surface = [ws.field, ws.size, energy.normal_step, chosen, distance, slope, nearest, normals]
    terms = [energy.fc, energy.vew, energy.dis, chosen, normals, distance, slope]
    one = (ws.count,)
    return [
        chain.recorded(ws, k.gather_contacts, each, [index, c.centres, chosen]),
        chain.recorded(ws, distance_field_kernels.closest_surface, each, surface),
        chain.recorded(ws, k.wrench_terms, one, [*terms, state.terms, gradient]),
        chain.recorded(ws, k.scatter_contacts, one, [index, gradient, c.centre_gradient]),
    ]


def _collision_calls(state: Annealing, energy: BimanGraspEnergyConfig) -> list[Call]:
    ws, k, one = state.ws, bimangrasp_kernels, (state.ws.count,)
    calls = []
    for hand, kept in zip(ws.hands, state.kept, strict=True):
        radius, spheres = hand.model.sphere_radius, hand.points.sphere
        push, owner = hand.points.sphere_grad, kept.owner
        box = [radius, spheres, hand.low, hand.high]
        near = wp.zeros(spheres.shape, dtype=int, device=ws.device)
        count = wp.zeros(one, dtype=int, device=ws.device)
        listed = [radius, ws.field, ws.size, spheres, near, count]
        inside = [radius, near, count, state.points, spheres, hand.low, hand.high, owner]
        depth = [radius, energy.pen, int(k.PEN), owner, state.points, spheres, state.terms, push]
        keypoints = [hand.model.self_pairs, energy.spen, energy.keypoint_reach, spheres]
        calls += [
            chain.recorded(ws, sphere_kernels.hand_box, one, box),
            chain.recorded(ws, k.spheres_at_surface, one, listed),
            chain.recorded(ws, k.points_in_hand, state.points.shape, inside),
            chain.recorded(ws, k.push_hand, one, depth),
            chain.recorded(ws, k.near_keypoints, one, [*keypoints, state.terms, push]),
        ]
    return [*calls, *_between_hands(state, energy)]


def _between_hands(state: Annealing, energy: BimanGraspEnergyConfig) -> list[Call]:
    """Surface points of the right hand in the left one."""
    ws, k = state.ws, bimangrasp_kernels
    left, right = ws.hands
    start = state.candidates[1]
    if right.points.contact.shape[1] == start:
        return []
    points, pull = right.points.contact[:, start:], right.points.contact_grad[:, start:]
    owner = wp.zeros(points.shape, dtype=int, device=ws.device)
    radius, spheres, push = left.model.sphere_radius, left.points.sphere, left.points.sphere_grad
    every = np.tile(np.arange(spheres.shape[1], dtype=np.int32), (ws.count, 1))
    near = wp.array(every, dtype=int, device=ws.device)
    count = wp.full(ws.count, spheres.shape[1], dtype=int, device=ws.device)
    inside = [radius, near, count, points, spheres, left.low, left.high, owner]
    depth = [radius, energy.spen, int(k.SPEN), owner, points, spheres, state.terms, push]
    return [
        chain.recorded(ws, k.points_in_hand, points.shape, inside),
        chain.recorded(ws, k.push_hand, (ws.count,), depth),
        chain.recorded(
            ws, k.push_points, points.shape, [energy.spen, owner, points, spheres, pull]
        ),
    ]


def _limit_calls(state: Annealing, energy: BimanGraspEnergyConfig) -> list[Call]:
    ws = state.ws
    calls = []
    for hand in ws.hands:
        limits = [hand.model.free_lower, hand.model.free_upper, energy.joints, hand.joints]
        arguments = [*limits, state.terms, hand.points.gradient]
        calls.append(chain.recorded(ws, bimangrasp_kernels.beyond_limits, (ws.count,), arguments))
    return calls


def _proposals(
    state: Annealing, rule: AnnealingConfig, contacts: Any, proposed: Any
) -> Callable[[int, float, float], None]:
    """Poses and contacts that are kept -> proposals; takes number, step length, temperature."""
    ws, k, one = state.ws, annealing_kernels, (state.ws.count,)
    squares, moves = [], []
    for side, (hand, kept) in enumerate(zip(ws.hands, state.kept, strict=True)):
        arguments = [state.first, rule.keep, kept.gradient, kept.squares]
        squares.append(chain.recorded(ws, k.running_squares, kept.squares.shape, arguments))
        limits = [side, hand.model.free_lower, hand.model.free_upper]
        arguments = [*limits, int(rule.clamp), rule.noise, 0.0, 0.0, 0]
        arguments += [state.scene, state.seed, kept.squares, kept.gradient]
        arguments += [kept.position, kept.rotation, kept.joints]
        arguments += [hand.position, hand.rotation, hand.joints]
        moves.append(chain.launch_of(ws, k.propose, one, arguments))
    candidates = wp.array(np.array(state.candidates, np.int32), dtype=int, device=ws.device)
    arguments = [candidates, 0.0, 0, state.seed, contacts, proposed]
    switch = chain.launch_of(ws, k.switch_contacts, one, arguments)

    def propose(number: int, step: float, temperature: float) -> None:
        for call in squares:
            call()
        for move in moves:
            for at, value in enumerate((step, temperature, number), start=5):
                move.set_param_at_index(at, value)
            move.launch()
        switch.set_param_at_index(1, rule.switch * (temperature / rule.temperature) ** 0.5)
        switch.set_param_at_index(2, number)
        switch.launch()

    return propose


def _judging(
    state: Annealing, energy: BimanGraspEnergyConfig, proposed: Any, contacts: Any
) -> Callable[[int, float], None]:
    """Accept or refuse the proposals; takes number (0 accepts all) and temperature."""
    ws, k, one = state.ws, annealing_kernels, (state.ws.count,)
    ordered = [getattr(energy, name) for name in Terms._fields]
    weights = wp.array(np.array(ordered, np.float32), dtype=float, device=ws.device)
    arguments = [weights, 1.0, 0, state.seed, state.terms, proposed]
    arguments += [state.energy, state.kept_terms, contacts, state.taken]
    judge = chain.launch_of(ws, k.judge_proposals, one, arguments)
    keep = []
    for hand, kept in zip(ws.hands, state.kept, strict=True):
        arguments = [state.taken, hand.position, hand.rotation, hand.joints, hand.points.gradient]
        arguments += [kept.position, kept.rotation, kept.joints, kept.gradient]
        keep.append(chain.recorded(ws, k.keep_taken, one, arguments))

    def decide(number: int, temperature: float) -> None:
        judge.set_param_at_index(1, temperature)
        judge.set_param_at_index(2, number)
        judge.launch()
        for call in keep:
            call()

    return decide
