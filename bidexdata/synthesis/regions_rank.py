"""Rank region pairs: by lot, by the paper's force score, or by balance with torques; then spread.

Every ranking returns pairs of anchor numbers (a < b), best first, with their scores.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from bidexdata.synthesis.regions_build import Regions
from bidexdata.synthesis.regions_gap import PairFilter
from bidexdata.wrench.qp import contact_qp
from bidexdata.wrench.qp_groups import axis_targets, zero_target
from bidexdata.wrench.support import AXES, force_support

if TYPE_CHECKING:
    from bidexdata.synthesis.regions import RegionConfig

Ranking = tuple[Int[np.ndarray, "n 2"], Float[np.ndarray, " n"]]


def random_order(allowed: PairFilter, need: int, rng: np.random.Generator) -> Ranking:
    """Draw allowed pairs by lot; their score is zero."""
    chosen = allowed.first(rng.permutation(len(allowed.pairs)), need)
    return allowed.pairs[chosen], np.zeros(len(chosen))


def force_order(regions: Regions, allowed: PairFilter, need: int, friction: float) -> Ranking:
    """Rank by the paper's score s, the force that the pair resists in the worst of six directions.

    Source:
        BiDexGrasp 4.2, step 2.
    """
    score = force_scores(regions, allowed.pairs, friction)
    chosen = allowed.first(np.argsort(-score, kind="stable"), need)
    return allowed.pairs[chosen], score[chosen]


def torque_order(
    regions: Regions,
    allowed: PairFilter,
    config: RegionConfig,
    torque_length: float,
    rng: np.random.Generator,
    *,
    device: str = "cpu",
) -> Ranking:
    """Rank the best pairs by force, and as many random ones, by minus the coupled QP residual.

    The best by one draw of contacts are ranked again by all draws, and come before the others.

    Args:
        regions: All regions.
        allowed: The pairs to choose from.
        config: Numbers of pairs, QP and friction.
        torque_length: Length that makes torques comparable with forces [m].
        rng: Draws the random pairs.
        device: Warp device of the QPs.
    """
    force = force_scores(regions, allowed.pairs, config.force_friction)
    best = allowed.first(np.argsort(-force, kind="stable"), config.reranked)
    lot = rng.permutation(len(allowed.pairs))
    rest = allowed.first(lot[~np.isin(lot, best)], config.reranked)
    pairs = allowed.pairs[np.concatenate([best, rest])]
    first = balance_residuals(regions, pairs, config, torque_length, slice(1), device=device)
    order = np.argsort(first, kind="stable")
    pairs, residual = pairs[order], first[order]
    refined = np.arange(len(pairs)) < config.refined
    if config.sets > 1:
        others = slice(1, None)
        more = balance_residuals(
            regions, pairs[refined], config, torque_length, others, device=device
        )
        residual[refined] += (config.sets - 1) * more
        residual[refined] /= config.sets
    order = np.lexsort((residual, ~refined))
    return pairs[order], -residual[order]


def force_scores(
    regions: Regions, pairs: Int[np.ndarray, "n 2"], friction: float
) -> Float[np.ndarray, " n"]:
    """Give the paper's score of pairs: support functions of the two regions add [caps].

    They are means over the sets of contacts.
    """
    support = force_support(-regions.contact_normals.astype(np.float64), AXES, mu=friction)
    support = support.mean(axis=1)
    return (support[pairs[:, 0]] + support[pairs[:, 1]]).min(axis=1)


def balance_residuals(
    regions: Regions,
    pairs: Int[np.ndarray, "n 2"],
    config: RegionConfig,
    torque_length: float,
    which: slice = slice(None),
    *,
    device: str = "cpu",
) -> Float[np.ndarray, " n"]:
    """Give the coupled QP's residual, both hands pressing: squared, mean over sets of contacts.

    Args:
        regions: Give the contacts.
        pairs: Of regions.
        config: QP, iterations and disturbances.
        torque_length: Length that makes torques comparable with forces [m].
        which: Sets of contacts to take.
        device: Warp device.
    """
    sets = len(range(regions.contact_points.shape[1])[which])
    if not len(pairs) or not sets:
        return np.zeros(len(pairs))

    def both_hands(contacts: Float[np.ndarray, "A S C 3"]) -> Float[np.ndarray, "nS M 3"]:
        of_sets = np.swapaxes(contacts[pairs][:, :, which], 1, 2)
        return np.ascontiguousarray(of_sets).reshape(len(pairs) * sets, -1, 3)

    solution = contact_qp(
        both_hands(regions.contact_points),
        -both_hands(regions.contact_normals),
        np.full(len(pairs) * sets, torque_length, np.float32),
        config.qp,
        coupling="coupled",
        targets=axis_targets() if config.disturbances == "forces" else zero_target(),
        iterations=config.iterations,
        device=device,
    )
    residual = solution.residual.astype(np.float64).sum(axis=(1, 2))
    return residual.reshape(len(pairs), sets).mean(axis=1)


def diverse(
    anchors: Float[np.ndarray, "A 3"], pairs: Int[np.ndarray, "n 2"], distance: float, keep: int
) -> Int[np.ndarray, " m"]:
    """Pick pairs in order that differ from all picked ones by more than `distance` in one anchor.

    Args:
        anchors: [m].
        pairs: Best first.
        distance: [m]; both ways of matching the anchors of two pairs are compared.
        keep: Number of pairs at most.

    Returns:
        Indices of `pairs`, ascending.
    """
    a, b = pairs.T
    free = np.ones(len(pairs), bool)
    picked: list[int] = []
    while len(picked) < keep and free.any():
        i = int(np.argmax(free))
        picked.append(i)
        from_a, from_b = (_norm(anchors - anchors[end]) for end in pairs[i])
        straight = np.maximum(from_a[a], from_b[b])
        crossed = np.maximum(from_b[a], from_a[b])
        free &= np.minimum(straight, crossed) > distance
        free[i] = False
    return np.array(picked, np.int64)


def _norm(v: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    return np.sqrt(np.einsum("ni,ni->n", v, v))
