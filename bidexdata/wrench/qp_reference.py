"""Float64 references of the contact QP: our iteration in numpy, and OSQP with cutting planes.

They certify the kernel and are far too slow for the optimiser.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.errors import MissingExtra
from bidexdata.wrench.contact_model import contact_frames, grasp_matrix, split_force
from bidexdata.wrench.qp import QPConfig

# Change of the squared residual over 100 steps at which the iteration has ended [caps^2].
_SETTLED = 1e-11

# Residuals that OSQP aims at, and those that still count as a solution [caps].
_OSQP_AIM = 1e-4
_OSQP_ENOUGH = 1e-3

# Weight of the squared forces beside the squared residual [-]: many forces give one wrench, and
# without a preference OSQP may not come to an end.
_OSQP_LEAST = 1e-5


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
    iterations: int = 5_000,
) -> ReferenceSolution:
    """Solve one contact QP with round cones by accelerated projected gradient in float64.

    Args:
        points: Contact points relative to the torque reference [m].
        normals_in: Inward unit normals.
        hand: Hand of each contact, (C,) int; each hand must press with gamma.
        target: Unit target force, and torque over `length`; multiplied by beta.
        length: Torque length [m].
        config: Friction, bounds and disturbance.
        iterations: Steps at most; momentum restarts whenever the residual grows.
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
    ahead, momentum, value, before = best, 1.0, size(best), np.inf
    for i in range(iterations):
        if i % 100 == 99:
            if before - value < _SETTLED:
                break
            before = value
        r_f, r_t = residual(ahead)
        moved = _project(ahead - step * (r_f + np.cross(r_t, q)), n, hand, config)
        new = size(moved)
        if new > value:
            ahead, momentum = best, 1.0
            continue
        following = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum * momentum))
        ahead = moved + (momentum - 1.0) / following * (moved - best)
        best, value, momentum = moved, new, following
    return ReferenceSolution(best, value)


def _project(y: np.ndarray, n: np.ndarray, hand: np.ndarray, config: QPConfig) -> np.ndarray:
    """Project onto cones and pressure bounds together, hand by hand.

    Shifting y along the normals by the bound's multiplier makes the plain projection exact. The
    pressure is piecewise linear in the shift, so the shift follows from its values at the kinks.
    """
    along, across = split_force(y, n)
    slide = np.linalg.norm(across, axis=-1)
    shift = np.zeros(len(y))
    for h in np.unique(hand):
        mine = hand == h
        a, s = along[mine], slide[mine]
        if _pressed(a, s, config).sum() >= config.gamma:
            continue
        cap, mu = config.cap, config.mu
        # Where a contact starts to press, leaves the mantle for the inside, or reaches the cap.
        kinks = [-mu * s - a, cap * (1 + mu * mu) - mu * s - a, cap - a]
        if mu > 0:
            kinks.append(s / mu - a)
        at = np.unique(np.maximum(np.concatenate([[0.0], *kinks]), 0.0))
        total = _pressed(a + at[:, None], s, config).sum(axis=1)
        shift[mine] = np.interp(config.gamma, total, at)
    pressed = _pressed(along + shift, slide, config)
    kept = np.minimum(1.0, config.mu * pressed / np.maximum(slide, 1e-300))
    return pressed[:, None] * n + kept[:, None] * across


def _pressed(along: np.ndarray, slide: np.ndarray, config: QPConfig) -> np.ndarray:
    """Normal part of the projection onto the capped cone."""
    mu = config.mu
    mantle = (along + mu * slide) / (1.0 + mu * mu)
    return np.clip(np.where(slide <= mu * along, along, mantle), 0.0, config.cap)


def osqp_contact_qp(
    points: Float[np.ndarray, "C 3"],
    normals_in: Float[np.ndarray, "C 3"],
    hand: np.ndarray,
    target: Float[np.ndarray, "2 3"],
    length: float,
    config: QPConfig,
    *,
    rounds: int = 12,
) -> ReferenceSolution:
    """Solve one contact QP with OSQP, round cones by cutting planes.

    The cones start as pyramids around them; every round adds a side where a force leaves its cone,
    so the optimum rises towards that of the round cones. Pyramids of `config.cone_sides` stay.

    Args:
        points: As in `reference_qp`, likewise the next five.
        normals_in: Inward unit normals.
        hand: Hand of each contact, (C,) int.
        target: Unit target wrench.
        length: Torque length [m].
        config: Friction, bounds and disturbance.
        rounds: Solutions at most for round cones; 1 gives the optimum of pyramids with 8 sides, a
            lower bound.

    Raises:
        MissingExtra: OSQP is not installed.
        ArithmeticError: OSQP reports no solution (gamma exceeds what the contacts may press).
    """
    n = np.asarray(normals_in, np.float64)
    frames, count = contact_frames(n), len(n)
    G = np.concatenate(list(grasp_matrix(np.asarray(points) / length, frames)), axis=1)
    goal = config.beta * np.asarray(target, np.float64).reshape(6)
    sides = config.cone_sides or 8
    angles = [list(2.0 * np.pi * np.arange(sides) / sides) for _ in range(count)]
    local = np.zeros((count, 3))
    for _ in range(rounds):
        local = _solve_pyramids(G, goal, hand, angles, config).reshape(count, 3)
        slide = np.linalg.norm(local[:, 1:], axis=1)
        outside = slide > config.mu * local[:, 0] + 1e-6 * config.cap
        if config.cone_sides or not outside.any():
            break
        for c in np.flatnonzero(outside):
            angles[c].append(float(np.arctan2(local[c, 2], local[c, 1])))
    r = G @ local.reshape(-1) - goal
    return ReferenceSolution(np.einsum("cij,cj->ci", frames, local), float(r @ r))


def _solve_pyramids(
    G: np.ndarray,
    goal: np.ndarray,
    hand: np.ndarray,
    angles: list[list[float]],
    config: QPConfig,
) -> np.ndarray:
    """Solve with one side per contact and angle; forces in the contacts' frames, (3 C,)."""
    try:
        import osqp
        from scipy import sparse
    except ImportError as err:
        raise MissingExtra("osqp", "synth") from err
    count = len(angles)
    blocks = [np.stack([np.full(len(a), -config.mu), np.cos(a), np.sin(a)], axis=1) for a in angles]
    presses = np.zeros((0, 3 * count))
    for h in np.unique(hand):
        row = np.zeros((1, 3 * count))
        row[0, 0::3] = hand == h
        presses = np.concatenate([presses, row])
    cones = sum(len(a) for a in angles)
    rows = sparse.vstack(
        [
            sparse.block_diag([sparse.csc_matrix(block) for block in blocks]),
            sparse.kron(sparse.identity(count), [[1.0, 0.0, 0.0]]),
            sparse.csc_matrix(presses),
            sparse.csc_matrix(G),
        ]
    )
    # The residual is a variable of its own: OSQP converges faster than with G^T G as the cost.
    own = np.concatenate([np.zeros((cones + count + len(presses), 6)), -np.eye(6)])
    lower = [
        np.full(cones, -np.inf),
        np.zeros(count),
        np.full(len(presses), config.gamma),
        goal,
    ]
    upper = [
        np.zeros(cones),
        np.full(count, config.cap),
        np.full(len(presses), np.inf),
        goal,
    ]
    solver = osqp.OSQP()
    solver.setup(
        P=sparse.diags([2.0 * _OSQP_LEAST] * (3 * count) + [2.0] * 6, format="csc"),
        q=np.zeros(3 * count + 6),
        A=sparse.hstack([rows, sparse.csc_matrix(own)], format="csc"),
        l=np.concatenate(lower),
        u=np.concatenate(upper),
        eps_abs=_OSQP_AIM,
        eps_rel=_OSQP_AIM,
        max_iter=20_000,
        polishing=True,
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    # The problems are degenerate, so OSQP may stop short of its aim.
    error = max(result.info.prim_res, result.info.dual_res)
    solved = result.info.status.startswith("solved") or error < _OSQP_ENOUGH
    if result.x is None or not solved:
        raise ArithmeticError(f"OSQP found no solution of the contact QP: {result.info.status}")
    return result.x[: 3 * count]
