"""Which contacts and which target wrenches the contact QP's problems have.

Contacts of H hands lie in one row of M = H C entries, hand h from h C on. A group is one hand or
several; the paper's decoupled energy has one group per hand, the coupled one a group of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float32

Coupling = Literal["decoupled", "coupled", "mix"]


@dataclass(frozen=True, slots=True)
class QPGroups:
    """Problems over shared contact arrays; groups of one layer share one row of forces."""

    contacts: tuple[int, ...]
    """Number of contact points of each hand; the rest of its C places are padding."""
    stride: int
    """C: places per hand."""
    first_hand: tuple[int, ...]
    """First hand of each group."""
    hands: tuple[int, ...]
    """Number of hands in each group."""
    layer: tuple[int, ...]
    """Row of the forces that each group uses."""

    @property
    def count(self) -> int:
        """Number of groups, K."""
        return len(self.layer)

    @property
    def layers(self) -> int:
        """Number of rows of forces, L."""
        return max(self.layer) + 1

    @property
    def width(self) -> int:
        """Number of contact places of all hands, M."""
        return len(self.contacts) * self.stride


def qp_groups(contacts: Sequence[int], coupling: Coupling) -> QPGroups:
    """List the problems of hands with `contacts` contact points each.

    `decoupled`: one group per hand. `coupled`: one group of all hands. `mix`: the decoupled
    groups, then the coupled one, with their own forces.
    """
    n = len(contacts)
    alone = [(h, 1, 0) for h in range(n)]
    table = {
        "decoupled": alone,
        "coupled": [(0, n, 0)],
        "mix": [*alone, (0, n, 1)],
    }[coupling]
    first, hands, layer = zip(*table, strict=True)
    return QPGroups(tuple(contacts), max(contacts), first, hands, layer)


def axis_targets() -> Float32[np.ndarray, "6 2 3"]:
    """Unit forces along +-x, +-y, +-z without torque: the paper's six disturbances.

    Entry [t, 0] is the force, [t, 1] the torque over the torque length.

    Source:
        BiDexGrasp, appendix A, QP-energy.
    """
    targets = np.zeros((6, 2, 3), np.float32)
    targets[:, 0] = np.repeat(np.eye(3), 2, axis=0) * np.tile([1.0, -1.0], 3)[:, None]
    return targets


def zero_target() -> Float32[np.ndarray, "1 2 3"]:
    """The one target "no load": the grasp shall press in balance (cheaper by six, our option)."""
    return np.zeros((1, 2, 3), np.float32)
