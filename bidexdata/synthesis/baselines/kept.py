"""The selection of methods that filter nothing without a simulator."""

from __future__ import annotations

from bidexdata.synthesis.selection import SelectionConfig


def keep_everything() -> SelectionConfig:
    """One attempt per grasp, and no limit by which one fails; poses must be numbers.

    The same as in the preset `paper`.
    """
    return SelectionConfig(
        candidates_per_grasp=1,
        start_depth=1.0,
        hands_depth=1.0,
        table_depth=1.0,
        clear_depth=1.0,
        largest_residual=1e6,
        apart=0.0,
        contacts_needed=0,
    )
