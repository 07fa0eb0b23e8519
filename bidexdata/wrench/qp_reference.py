"""Float64 references of the contact QP: our iteration in numpy, and OSQP on pyramids of many sides.

They certify the kernel and are far too slow for the optimiser.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.errors import MissingExtra
from bidexdata.wrench.contact_model import contact_frames, grasp_matrix, project_to_cone
from bidexdata.wrench.qp import QPConfig

# Bisections of the pressure multiplier: 2^-60 of its range is below float64's rounding.
_BISECTIONS = 60


class ReferenceSolution(NamedTuple):
    """One QP, one target."""

    forces: Float[np.ndarray, "C 3"]
    """Forces on the object [caps]."""
    residual: float
    """Squared wrench residual."""


def reference_qp(
    points: Float[np.ndarray, "C 3"],
    normals_in: Float[np.ndarray, "C 3"],
    hand: np.ndarray,
    target: Float[np.ndarray, "2 3"],
    length: float,
    config: QPConfig,
    *,
    iterations: int = 20_000,
) -> ReferenceSolution:
    """Solve one contact QP with round cones by accelerated projected gradient in float64.

    Args:
        points: Contact points relative to the torque reference [m].
        normals_in: Inward unit normals.
        hand: Hand of each contact, (C,) int; each hand must press with gamma.
        target: Unit target force, and torque over `length`; multiplied by beta.
        length: Torque length [m].
        config: Friction, bounds and disturbance.
        iterations: Steps; momentum restarts whenever the residual grows.
    """
    q = np.asarray(points, np.float64) / length
    n = np.asarray(normals_in, np.float64)
    goal = config.beta * np.asarray(target, np.float64)
    step = 1.0 / max(1.0, float((1.0 + (q * q).sum(-1)).sum()))

    def residual(f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return f.sum(0) - goal[0], np.cross(q, f).sum(0) - goal[1]

    def size(f: np.ndarray) -> float:
        r_f, r_t = residual(f)
        return float(r_f @ r_f + r_t @ r_t)

    best = _project(np.zeros_like(n), n, hand, config)
    ahead, momentum, value = best, 1.0, size(best)
    for _ in range(iterations):
        r_f, r_t = residual(ahead)
        moved = _project(ahead - step * (r_f + np.cross(r_t, q)), n, hand, config)
        new = size(moved)
        if new > value:
            if momentum == 1.0:
                break
            ahead, momentum = best, 1.0
            continue
        following = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum * momentum))
        ahead = moved + (momentum - 1.0) / following * (moved - best)
        best, value, momentum = moved, new, following
    return ReferenceSolution(best, value)


def _project(y: np.ndarray, n: np.ndarray, hand: np.ndarray, config: QPConfig) -> np.ndarray:
    """Project onto cones and pressure bounds together, hand by hand."""
    out = np.empty_like(y)
    for h in np.unique(hand):
        mine = hand == h
        low, high = 0.0, float(np.abs(y[mine]).sum()) * (2.0 + config.mu) + 2.0 * config.cap
        f = project_to_cone(y[mine], n[mine], mu=config.mu, cap=config.cap)
        if (f * n[mine]).sum() < config.gamma:
            for _ in range(_BISECTIONS):
                shift = 0.5 * (low + high)
                f = project_to_cone(
                    y[mine] + shift * n[mine], n[mine], mu=config.mu, cap=config.cap
                )
                low, high = (low, shift) if (f * n[mine]).sum() >= config.gamma else (shift, high)
        out[mine] = f
    return out


def pyramid_qp(
    points: Float[np.ndarray, "C 3"],
    normals_in: Float[np.ndarray, "C 3"],
    hand: np.ndarray,
    target: Float[np.ndarray, "2 3"],
    length: float,
    config: QPConfig,
    *,
    sides: int = 8,
    inscribed: bool = False,
) -> ReferenceSolution:
    """Solve one contact QP with OSQP, the cones replaced by pyramids.

    A pyramid around the cone (`inscribed=False`, BODex uses 8 sides) gives a lower bound of the
    round problem's residual, one inside it an upper bound; they close in with the square of the
    number of sides.

    Args:
        points: As in `reference_qp`, likewise the next five.
        normals_in: Inward unit normals.
        hand: Hand of each contact, (C,) int.
        target: Unit target wrench.
        length: Torque length [m].
        config: Friction, bounds and disturbance.
        sides: Sides of each pyramid.
        inscribed: Shrink the pyramid into the cone.

    Raises:
        MissingExtra: OSQP is not installed.
        ArithmeticError: OSQP reports no solution (gamma exceeds what the contacts may press).
    """
    try:
        import osqp
        from scipy import sparse
    except ImportError as err:
        raise MissingExtra("osqp", "synth") from err
    n = np.asarray(normals_in, np.float64)
    frames = contact_frames(n)
    count = len(n)
    G = np.concatenate(list(grasp_matrix(np.asarray(points) / length, frames)), axis=1)
    goal = config.beta * np.asarray(target, np.float64).reshape(6)
    angle = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    mu = config.mu * (np.cos(np.pi / sides) if inscribed else 1.0)
    side_rows = np.stack([np.full(sides, -mu), np.sin(angle), np.cos(angle)], axis=1)
    hands = np.unique(hand)
    presses = np.zeros((len(hands), 3 * count))
    for row, h in enumerate(hands):
        presses[row, 0::3] = hand == h
    A = sparse.vstack(
        [
            sparse.block_diag([side_rows] * count),
            sparse.kron(sparse.identity(count), [[1.0, 0.0, 0.0]]),
            sparse.csr_matrix(presses),
        ],
        format="csc",
    )
    free = np.full(sides * count, -np.inf)
    lower = np.concatenate([free, np.zeros(count), np.full(len(hands), config.gamma)])
    upper = np.concatenate(
        [np.zeros(sides * count), np.full(count, config.cap), np.full(len(hands), np.inf)]
    )
    solver = osqp.OSQP()
    solver.setup(
        P=sparse.csc_matrix(2.0 * np.triu(G.T @ G)),
        q=-2.0 * G.T @ goal,
        A=A,
        l=lower,
        u=upper,
        eps_abs=1e-7,
        eps_rel=1e-7,
        max_iter=200_000,
        polishing=True,
        verbose=False,
    )
    result = solver.solve()
    if result.x is None or "solved" not in result.info.status:
        raise ArithmeticError(f"OSQP found no solution of the contact QP: {result.info.status}")
    r = G @ result.x - goal
    return ReferenceSolution(
        np.einsum("cij,cj->ci", frames, result.x.reshape(count, 3)), float(r @ r)
    )
