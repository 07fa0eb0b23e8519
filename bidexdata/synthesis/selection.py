"""Selection: which attempts failed for certain, and which are kept, by analytic criteria alone.

Nothing here knows a simulator's verdict. The audit rows are drawn before any attempt is looked at.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from bidexdata.config import refuse_outside
from bidexdata.record import Status
from bidexdata.simulation.settings import HANDS_DEPTH, TABLE_DEPTH
from bidexdata.synthesis.settling import Settled, SettlingConfig

LEAST_RESIDUAL, LEAST_TURN = 1e-7, 1e-3
"""Smaller figures are as good as these [-, rad]: float32, the grid's error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectionConfig:
    """What certainly failed, and what is kept of the rest.

    "Measurements, n" is docs/measurements.md, section n.
    """

    candidates_per_grasp: int = 4
    """Attempts per grasp kept, M / N [-]. Ours: validation costs far more than synthesis."""
    start_depth: float = 0.010
    """Deeper pre-grasp penetration is a failed attempt [m]. DexGraspBench start check: 10 mm."""
    hands_depth: float = HANDS_DEPTH
    """The same within and between hands [m]. DexGraspBench, the same check."""
    table_depth: float = TABLE_DEPTH
    """Hands deeper than this in the table at any of the three stages are a failed attempt [m]. Ours;
    `simulation.settings` says why."""
    clear_depth: float = 0.001
    """Attempts with less pre-grasp penetration come first [m]. Measurements, 6."""
    largest_residual: float = 0.01
    """Attempts with a larger coupled QP residual are not selected [-]. Measurements, 6."""
    apart: float = 0.03
    """Of attempts whose two hands lie nearer to each other's than this the best comes first, the
    others behind all that differ; 0 prefers none [m]. Ours."""
    shift: float = 0.012
    """How far contacts are moved for the shifted residual, in the figure by which attempts are ordered
    [m]. Measurements, 14 and 19."""
    weight: float = 1.0
    """Share of the object's weight that moved contacts must carry along the six axes in turn, pressed
    as hard as the squeeze will press [-]; 0 leaves it out. Ours."""
    shifted_sets: int = 12
    """Moved sets of contacts per attempt [-]. Measurements, 14."""
    shifted_iterations: int = 60
    """QP iterations of each [-]. Measurements, 14: not varied there."""
    settling: SettlingConfig = field(default_factory=SettlingConfig)
    """The model of closing hands, the other part of that figure."""
    residual_iterations: int = 150
    """QP iterations of the final residual and forces [-]. Measurements, 4."""
    contact_tolerance: float = 0.010
    """A pad farther from the surface at the grasp is a lost contact [m]. Ours: the squeeze moves
    pads by about 10 mm, so what is farther stays off."""
    contacts_needed: int = 3
    """Contacts per hand within the tolerance [-], fewer is a failed attempt; all of them where a
    hand has fewer. Ours: two forces cannot hold a hand's share of an object against turning."""

    def __post_init__(self) -> None:
        refuse_outside(self, "candidates_per_grasp", 1, 1000)
        for name in (
            "start_depth",
            "hands_depth",
            "table_depth",
            "clear_depth",
            "contact_tolerance",
        ):
            refuse_outside(self, name, 0.0, 1.0)
        refuse_outside(self, "largest_residual", 0.0, 1e6)
        refuse_outside(self, "apart", 0.0, 10.0)
        refuse_outside(self, "weight", 0.0, 100.0)
        refuse_outside(self, "shift", 0.0, 0.1)
        refuse_outside(self, "shifted_sets", 1, 1000)
        for name in ("residual_iterations", "shifted_iterations"):
            refuse_outside(self, name, 1, 100_000)
        refuse_outside(self, "contacts_needed", 0, 100)


KEEP_EVERYTHING = SelectionConfig(
    candidates_per_grasp=1,
    start_depth=1.0,
    hands_depth=1.0,
    table_depth=1.0,
    clear_depth=1.0,
    largest_residual=1e6,
    apart=0.0,
    contacts_needed=0,
)
"""The selection of methods that filter nothing without a simulator, the paper's among them: one
attempt per grasp, and no limit by which one fails. Poses must be numbers."""


def judge(
    finite: Bool[np.ndarray, " K"],
    gaps: Float[np.ndarray, "K 2 C"],
    depth: Float[np.ndarray, " K"],
    config: SelectionConfig,
    *,
    among_hands: Float[np.ndarray, " K"],
    table: Float[np.ndarray, " K"],
) -> Int8[np.ndarray, " K"]:
    """Give the status of each optimised attempt.

    Args:
        finite: Whether its poses are numbers.
        gaps: Signed distances of the pads from the surface at the grasp [m]; NaN at padding.
        depth: Deepest hand-object penetration at the pre-grasp [m].
        config: Limits.
        among_hands: The same within and between hands [m].
        table: The same of hands and table, at the worst of the three stages [m]; 0 without one.
    """
    found = failures(finite, gaps, depth, config, among_hands=among_hands, table=table)
    status = np.full(len(finite), Status.OK, np.int8)
    for reason in reversed(found):  # the first reason is written last, and stays
        status[found[reason]] = reason
    return status


def failures(
    finite: Bool[np.ndarray, " K"],
    gaps: Float[np.ndarray, "K 2 C"],
    depth: Float[np.ndarray, " K"],
    config: SelectionConfig,
    *,
    among_hands: Float[np.ndarray, " K"],
    table: Float[np.ndarray, " K"],
) -> dict[Status, Bool[np.ndarray, " K"]]:
    """Tell for every reason which optimised attempts fail by it; arguments are those of `judge`.

    Returns:
        Reasons in their order: the first that holds is an attempt's status. One may fail by several.
    """
    # A hand of fewer pads than are needed must have them all on the surface.
    needed = np.minimum(config.contacts_needed, np.sum(np.isfinite(gaps), axis=2))
    with np.errstate(invalid="ignore"):
        return {
            Status.NOT_FINITE: ~finite,
            Status.PENETRATION_LEFT: depth > config.start_depth,
            Status.SELF_PENETRATION_LEFT: among_hands > config.hands_depth,
            Status.TABLE_PENETRATION: table > config.table_depth,
            Status.CONTACT_LOST: np.any(touching(gaps, config) < needed, axis=1),
        }


def touching(gaps: Float[np.ndarray, "K 2 C"], config: SelectionConfig) -> Int[np.ndarray, "K 2"]:
    """Number of each hand's pads that are near enough to the surface to count as contacts."""
    with np.errstate(invalid="ignore"):
        return np.sum(np.abs(gaps) <= config.contact_tolerance, axis=2)


def doubts(shifted: Float[np.ndarray, " M"], rest: Settled) -> Float[np.ndarray, " M"]:
    """Give the figure by which attempts are ordered, least first: odds of failure, up to a factor.

    What balance is left when every finger touches a little elsewhere, and how the object lies when
    the hands have closed: how far it has turned, how hard the weaker hand presses, and how many
    contacts do.

    Args:
        shifted: Residual of moved contacts that carry the weight [-].
        rest: From `settling.settled`.

    Source:
        Ours; exponents of a logistic fit, docs/measurements.md, 21.
    """
    uneven = np.maximum(shifted, LEAST_RESIDUAL) ** 0.3 * np.maximum(rest.turned, LEAST_TURN) ** 0.8
    return np.asarray(uneven / np.sqrt(rest.pressed) * np.exp(-0.3 * rest.touching))


def best(
    status: Int8[np.ndarray, " M"],
    depth: Float[np.ndarray, " M"],
    residual: Float[np.ndarray, " M"],
    doubt: Float[np.ndarray, " M"],
    places: Float[np.ndarray, "M 2 3"],
    count: int,
    config: SelectionConfig,
) -> Bool[np.ndarray, " M"]:
    """Mark the best `count` attempts: clear of the object first, then those with the least doubt.

    Of attempts that are alike one comes first, and the others behind all that differ.

    Args:
        status: Of all M attempts of a scene.
        depth: Pre-grasp penetration [m]; NaN where there is no grasp.
        residual: Coupled zero-load QP residual [-]; NaN where there is no grasp.
        doubt: From `doubts`; NaN where there is no grasp.
        places: Origins of the hand frames at the grasp, object frame [m]; NaN where there is none.
        count: N, grasps to keep.
        config: Limits.

    Source:
        docs/measurements.md, 6 (89 -> 99.7 % for the best 8 of 32), 14, 19 and 21.
    """
    chosen = np.zeros(len(status), bool)
    chosen[selection_order(status, depth, residual, doubt, places, config)[:count]] = True
    return chosen


def selection_order(
    status: Int8[np.ndarray, " M"],
    depth: Float[np.ndarray, " M"],
    residual: Float[np.ndarray, " M"],
    doubt: Float[np.ndarray, " M"],
    places: Float[np.ndarray, "M 2 3"],
    config: SelectionConfig,
) -> Int[np.ndarray, " U"]:
    """Number the attempts that may be kept, best first; arguments are those of `best`."""
    able = (status == Status.OK) & (residual <= config.largest_residual)
    # The attempt's number breaks ties, so that the order is always the same.
    order = np.lexsort((np.arange(len(status)), doubt, depth > config.clear_depth))
    return _unlike_first(order[able[order]], places, config.apart)


def _unlike_first(
    order: Int[np.ndarray, " U"], places: Float[np.ndarray, "M 2 3"], apart: float
) -> Int[np.ndarray, " U"]:
    """Move what is alike something before it behind all the rest; both keep their order."""
    first: list[int] = []
    for k in order.tolist():
        away = np.linalg.norm(places[first] - places[k], axis=-1).max(axis=-1)
        if not np.any(away < apart):
            first.append(k)
    return np.concatenate([np.array(first, np.int64), order[~np.isin(order, first)]])


def audit(attempts: int, count: int, rng: np.random.Generator) -> Bool[np.ndarray, " M"]:
    """Draw `count` of the attempts, whatever becomes of them."""
    drawn = np.zeros(attempts, bool)
    drawn[rng.permutation(attempts)[:count]] = True
    return drawn
