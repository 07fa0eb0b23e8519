"""Selection: which attempts are kept, by analytic criteria alone."""

from __future__ import annotations

from dataclasses import dataclass

from bidexdata.synthesis.optimise_config import refuse_outside


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectionConfig:
    """What certainly failed, and what is kept of the rest."""

    candidates_per_grasp: int = 4
    """Attempts per grasp kept, M / N [-]. DESIGN 5."""
    start_depth: float = 0.010
    """Deeper pre-grasp penetration is a failed attempt [m]. DexGraspBench start check: 10 mm."""
    clear_depth: float = 0.001
    """Attempts with less pre-grasp penetration come first [m]. Prototype 5."""
    largest_residual: float = 0.01
    """Attempts with a larger coupled QP residual are not selected [-]. Prototype 7 and 9."""
    residual_iterations: int = 150
    """QP iterations of the final residual and forces [-]. Prototype 4."""
    contact_tolerance: float = 0.010
    """A pad farther from the surface at the grasp is a lost contact [m]. Ours: the squeeze moves
    pads by about 10 mm, so what is farther stays off."""
    contacts_needed: int = 3
    """Contacts per hand within the tolerance [-], fewer is a failed attempt. Ours: two forces
    cannot hold a hand's share of an object against turning."""

    def __post_init__(self) -> None:
        refuse_outside(self, "candidates_per_grasp", 1, 1000)
        for name in ("start_depth", "clear_depth", "contact_tolerance"):
            refuse_outside(self, name, 0.0, 1.0)
        refuse_outside(self, "largest_residual", 0.0, 1e6)
        refuse_outside(self, "residual_iterations", 1, 100_000)
        refuse_outside(self, "contacts_needed", 0, 100)
