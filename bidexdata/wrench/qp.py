"""The contact QP, batched: how well contacts balance target wrenches, and its gradient.

    Q_k = sum_t min_f | sum_i G_i f_i - beta t |^2,  0 <= f_n <= cap, |f_t| <= mu f_n,
          sum of f_n over each hand of the group k >= gamma

with torques about the origin divided by a torque length. Solved by projected gradient with the
exact projection, so every iterate is feasible and a warm start keeps its worth.

Source: BiDexGrasp, appendix A, equation (QP-energy), whose cones are discretised; here they are round
unless `QPConfig.cone_sides` makes pyramids of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from bidexdata.devices import start_warp
from bidexdata.errors import BadConfig
from bidexdata.wrench.qp_groups import Coupling, QPGroups, axis_targets, qp_groups

if TYPE_CHECKING:
    import warp as wp


@dataclass(frozen=True, slots=True, kw_only=True)
class QPConfig:
    """Constants of the contact QP; forces are in units of the cap."""

    mu: float = 0.3
    """Friction coefficient of the cones [-]. Ours: half the simulated 0.6, as a margin; measurements,
    3: 0.1, 0.3 and 0.6 differ by 3 points of success. The paper gives none, BODex uses 0.1."""
    cone_sides: int = 0
    """Sides of the pyramids around the cones that stand for them [-]; 0 leaves the cones round. BODex
    has 8; docs/measurements.md, 23: it changes nothing that shows."""
    gamma: float = 1.0
    """Least sum of normal forces of each hand [caps]. BODex's bound; the paper gives no value."""
    cap: float = 1.0
    """Largest normal force of one contact. Paper, appendix A: the friction cone ends at 1."""
    beta: float = 0.2
    """Size of the disturbances [caps]. BODex's `k_lower`; the paper gives no value."""

    def __post_init__(self) -> None:
        for name, low in (("mu", 0.0), ("gamma", 0.0), ("beta", 0.0), ("cap", 1e-6)):
            value = getattr(self, name)
            if not low <= value < float("inf"):
                raise BadConfig(f"QPConfig.{name} must be at least {low:g}, not {value!r}")
        if self.cone_sides != 0 and not 3 <= self.cone_sides <= 1000:
            raise BadConfig(
                f"QPConfig.cone_sides must be 0 (round cones) or from 3 to 1000, not {self.cone_sides}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ContactQP:
    """Device arrays of N grasps' QPs: the problems, their forces and their residuals.

    Letters: N grasps, K groups, L layers of forces, T targets, M contact places of all hands.
    """

    groups: QPGroups
    group_first_hand: wp.array
    group_hands: wp.array
    group_layer: wp.array
    hand_start: wp.array
    hand_stop: wp.array
    contact_hand: wp.array
    """Hand of each contact place, -1 for padding, (M,) int."""
    targets: wp.array
    """Target force and torque over torque length, times beta in the solver, (N or 1, T, 2) vec3;
    one row stands for all grasps."""
    forces: wp.array
    """Forces on the object in the frame of the points [caps], start and result, (N, L, T, M)
    vec3."""
    parts: wp.array
    """Scratch: parts of each force before its projection, (N, L, T, M) vec3."""
    residual: wp.array
    """Squared wrench residual, (N, K, T)."""
    residual_force: wp.array
    """sum f - beta t, (N, K, T) vec3."""
    residual_torque: wp.array
    """sum p x f / length - beta t, (N, K, T) vec3."""


def allocate_contact_qp(
    count: int,
    groups: QPGroups,
    targets: Float[np.ndarray, "*n T 2 3"] | None = None,
    *,
    device: str = "cpu",
) -> ContactQP:
    """Make the arrays of `count` grasps; forces start at zero.

    Args:
        count: N.
        groups: From `qp_groups`.
        targets: Unit target wrenches, the same for all grasps or with a leading axis N; the paper's
            six axis forces when omitted.
        device: Warp device.
    """
    import warp as wp

    start_warp()
    targets = axis_targets() if targets is None else np.asarray(targets, np.float32)
    targets = targets.reshape(-1, *targets.shape[-3:])
    starts = np.arange(len(groups.contacts), dtype=np.int32) * groups.stride
    stops = starts + np.array(groups.contacts, np.int32)
    hand = np.full(groups.width, -1, np.int32)
    for h, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        hand[start:stop] = h
    tasks = (count, groups.count, targets.shape[1])
    places = (count, groups.layers, targets.shape[1], groups.width)

    def ints(values: Any) -> wp.array:
        return wp.array(np.asarray(values, np.int32), dtype=int, device=device)

    return ContactQP(
        groups=groups,
        group_first_hand=ints(groups.first_hand),
        group_hands=ints(groups.hands),
        group_layer=ints(groups.layer),
        hand_start=ints(starts),
        hand_stop=ints(stops),
        contact_hand=ints(hand),
        targets=wp.array(targets, dtype=wp.vec3, device=device),
        forces=wp.zeros(places, dtype=wp.vec3, device=device),
        parts=wp.zeros(places, dtype=wp.vec3, device=device),
        residual=wp.zeros(tasks, dtype=float, device=device),
        residual_force=wp.zeros(tasks, dtype=wp.vec3, device=device),
        residual_torque=wp.zeros(tasks, dtype=wp.vec3, device=device),
    )


def solve_contact_qp(
    points: wp.array,
    normals_in: wp.array,
    lengths: wp.array,
    qp: ContactQP,
    config: QPConfig,
    *,
    iterations: int,
) -> None:
    """Improve `qp.forces` in place by `iterations` steps and write the residuals.

    Args:
        points: Contact points relative to the torque reference [m], (N, M) vec3.
        normals_in: Inward unit normals, (N, M) vec3.
        lengths: Torque length of each grasp [m], (N,).
        qp: Problems and buffers; `qp.forces` is the start.
        config: Friction, bounds and disturbance.
        iterations: Steps; 0 only evaluates the residual of the given forces. 4 per optimiser step
            with a warm start, 40 from zero (docs/measurements.md, 3).
    """
    import warp as wp

    from bidexdata.wrench.qp_kernels import contact_qp_kernel

    arguments = solve_arguments(points, normals_in, lengths, qp, config, iterations)
    wp.launch(contact_qp_kernel, dim=qp.residual.shape, inputs=arguments, device=qp.forces.device)


def solve_arguments(
    points: wp.array,
    normals_in: wp.array,
    lengths: wp.array,
    qp: ContactQP,
    config: QPConfig,
    iterations: int,
) -> list[Any]:
    """All arguments of `contact_qp_kernel`, in order; as in `solve_contact_qp`."""
    groups = [qp.group_first_hand, qp.group_hands, qp.group_layer, qp.hand_start, qp.hand_stop]
    cone = [config.mu, config.cone_sides]
    constants = [*cone, config.gamma, config.cap, config.beta, iterations]
    results = [qp.forces, qp.parts, qp.residual, qp.residual_force, qp.residual_torque]
    return [points, normals_in, lengths, *groups, qp.targets, *constants, *results]


def contact_qp_gradient(
    points: wp.array,
    normals_in: wp.array,
    lengths: wp.array,
    qp: ContactQP,
    group_weight: wp.array,
    grad_points_out: wp.array,
    grad_normals_out: wp.array,
) -> None:
    """Differentiate sum_k weight_k sum_t residual at the forces found, which count as optimal.

    Args:
        points: As in `solve_contact_qp`, likewise `normals_in` and `lengths`.
        normals_in: (N, M) vec3.
        lengths: (N,).
        qp: After `solve_contact_qp`.
        group_weight: Weight of each group, (K,).
        grad_points_out: Receives dQ/dp, (N, M) vec3; zero at padding.
        grad_normals_out: Receives dQ/dn, tangential to n, (N, M) vec3.

    Source:
        Envelope theorem; the forces turn with the normal, as coordinates in the contact's frame.
    """
    import warp as wp

    from bidexdata.wrench.qp_kernels import contact_qp_gradient_kernel

    out = (grad_points_out, grad_normals_out)
    arguments = gradient_arguments(points, normals_in, lengths, qp, group_weight, *out)
    wp.launch(
        contact_qp_gradient_kernel,
        dim=grad_points_out.shape,
        inputs=arguments,
        device=qp.forces.device,
    )


def gradient_arguments(
    points: wp.array,
    normals_in: wp.array,
    lengths: wp.array,
    qp: ContactQP,
    group_weight: wp.array,
    grad_points_out: wp.array,
    grad_normals_out: wp.array,
) -> list[Any]:
    """All arguments of `contact_qp_gradient_kernel`, in order; as in `contact_qp_gradient`."""
    groups = [qp.group_first_hand, qp.group_hands, qp.group_layer, group_weight, qp.contact_hand]
    found = [qp.forces, qp.residual_force, qp.residual_torque]
    return [points, normals_in, lengths, *groups, *found, grad_points_out, grad_normals_out]


class QPResult(NamedTuple):
    """Solution of `contact_qp`."""

    forces: Float32[np.ndarray, "N L T M 3"]
    """Forces on the object [caps]."""
    residual: Float32[np.ndarray, "N K T"]
    """Squared wrench residual per group and target."""


def contact_qp(
    points: Float[np.ndarray, "N M 3"],
    normals_in: Float[np.ndarray, "N M 3"],
    lengths: Float[np.ndarray, " N"],
    config: QPConfig | None = None,
    *,
    hands: int = 2,
    coupling: Coupling = "coupled",
    targets: Float[np.ndarray, "T 2 3"] | None = None,
    iterations: int = 150,
    device: str = "cpu",
) -> QPResult:
    """Solve the contact QPs of numpy arrays from a cold start.

    Args:
        points: Contact points of all hands, the same number each [m].
        normals_in: Inward unit normals.
        lengths: Torque length [m].
        config: Friction, bounds and disturbance.
        hands: Number of hands that the M contacts divide into.
        coupling: Which groups to solve.
        targets: As in `allocate_contact_qp`.
        iterations: Projected-gradient steps.
        device: Warp device.
    """
    import warp as wp

    count, width = points.shape[:2]
    groups = qp_groups([width // hands] * hands, coupling)
    qp = allocate_contact_qp(count, groups, targets, device=device)

    def vectors(values: np.ndarray) -> wp.array:
        return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3, device=device)

    scale = wp.array(np.asarray(lengths, np.float32), dtype=float, device=device)
    solve_contact_qp(
        vectors(points),
        vectors(normals_in),
        scale,
        qp,
        config or QPConfig(),
        iterations=iterations,
    )
    return QPResult(qp.forces.numpy(), qp.residual.numpy())
