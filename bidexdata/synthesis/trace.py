"""Trace: what one attempt looked like, and cost, at every step of its optimisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.synthesis.optimise import Look
from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.readout import read_energies, read_pose

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.synthesis.optimise_config import OptimiseConfig

CLOSURES = ("closure_left", "closure_right", "closure_coupled")
TERMS = (*CLOSURES, "distance", "region", "pad", "penetration", "self_penetration")
"""Energy terms in the order of a trace's columns. `closure_left` is Q of the left hand alone,
`closure_coupled` that of both together; the configuration may leave some out."""
_ONLY_WITH_CLOSURE = (*CLOSURES, "region")


class Trace(NamedTuple):
    """One attempt's way through the optimiser: T steps, and the finished grasp as the last."""

    phase: tuple[str, ...]
    """`approach`, `pregrasp`, `grasp`, or `end` for the finished grasp, (T,)."""
    step: Int[np.ndarray, " T"]
    """Number of the step within its phase; energies and poses are those before its move."""
    energy: Float[np.ndarray, "T 8"]
    """Unweighted terms, in the order of `TERMS`; NaN where a phase does not have the term."""
    weight: Float[np.ndarray, " 8"]
    """Weight of each term: the optimiser follows the gradient of the sum of weight x energy."""
    poses: Mapping[str, Pose]
    """Both hands at the start (`start`), within the approach (`quarter`), and at the end of each
    phase (`approach`, `pregrasp`, `grasp`), one row each, object frame."""

    def total(self) -> Float[np.ndarray, " T"]:
        """Weighted sum of the terms that each step has."""
        return np.nansum(self.energy * self.weight, axis=1)


class Recorder:
    """A watch of `optimise` that keeps the trace of one attempt."""

    def __init__(self, row: int, hands: Sequence[Hand], config: OptimiseConfig):
        """Look at one of the starts.

        Args:
            row: Number of the start.
            hands: Left and right.
            config: Gives the weights.
        """
        self._row, self._hands, self._weight = row, hands, term_weights(config)
        self._quarter = config.approach.steps // 4
        self._phase: list[str] = []
        self._step: list[int] = []
        self._energy: list[np.ndarray] = []
        self._poses: dict[str, Pose] = {}

    def __call__(self, look: Look) -> None:
        """Keep what a look sees."""
        before = self._phase[-1] if self._phase else "start"
        if look.phase != before:
            # The state before a phase's first move is that after the last move of the one before.
            self._keep_pose(before, look)
        elif look.phase == "approach" and look.step == self._quarter:
            self._keep_pose("quarter", look)
        self._phase.append(look.phase)
        self._step.append(look.step)
        self._energy.append(self._energies(look))

    def trace(self) -> Trace:
        """Everything seen so far."""
        energy = np.array(self._energy).reshape(-1, len(TERMS))
        steps = np.array(self._step, np.int64)
        return Trace(tuple(self._phase), steps, energy, self._weight, dict(self._poses))

    def _keep_pose(self, name: str, look: Look) -> None:
        row = slice(self._row, self._row + 1)
        self._poses[name] = read_pose(look.workspace, self._hands).rows(row)

    def _energies(self, look: Look) -> np.ndarray:
        found = dict.fromkeys(TERMS, np.nan)
        energies = read_energies(look.workspace, look.closure)
        for name in TERMS[len(CLOSURES) :]:
            found[name] = getattr(energies, name)[self._row]
        if look.closure is None:
            found.update(dict.fromkeys(_ONLY_WITH_CLOSURE, np.nan))
            return np.array(list(found.values()))
        groups = look.closure.groups
        residual = look.closure.residual.numpy()[self._row].astype(np.float64).sum(axis=1)
        for first, hands, value in zip(groups.first_hand, groups.hands, residual, strict=True):
            found[CLOSURES[first] if hands == 1 else CLOSURES[2]] = value
        return np.array(list(found.values()))


def term_weights(config: OptimiseConfig) -> Float[np.ndarray, " 8"]:
    """Weights of the terms, in the order of `TERMS`."""
    energy, closure = config.energy, config.closure
    alone = closure.weight_decoupled
    closures = (alone, alone, closure.weight_coupled)
    contacts = (energy.distance, energy.region, energy.pad)
    return np.array([*closures, *contacts, energy.penetration, energy.self_penetration])
