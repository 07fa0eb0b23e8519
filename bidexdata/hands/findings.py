"""Finding: what one check of a hand saw, in words that a person can act on."""

from __future__ import annotations

from typing import NamedTuple


class Finding(NamedTuple):
    """One line of `bidexdata hands check`."""

    check: str
    """Name of the check."""
    passed: bool | None
    """None where it was not made, because something before it failed or it does not apply."""
    says: str
    """What was measured; where it failed also what to change."""


def worst(check: str, faults: list[str], fine: str) -> Finding:
    """Fail with the first fault and the number of the others, or pass with what was measured."""
    if not faults:
        return Finding(check, True, fine)
    others = len(faults) - 1
    more = (
        f" (and {others} more {'fault' if others == 1 else 'faults'} of this check)"
        if others
        else ""
    )
    return Finding(check, False, faults[0] + more)
