"""What became of attempts: how many ended at which stage, and the energies of those kept, per size."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Any

import numpy as np

from bidexdata.record import GraspBatch, Status
from bidexdata.record.moments import NOTHING, Moments, moments_of
from bidexdata.record.scene import scene_parts
from bidexdata.record.status import by_synth_stage

ENERGIES = (
    "energy_qp",
    "energy_distance",
    "energy_region",
    "energy_pad",
    "energy_penetration",
    "energy_self",
    "qp_residual",
    "qp_residual_shifted",
)
"""Columns whose means are told: the terms at the grasp, unweighted, and what selection goes by."""


class AttemptTally:
    """Add batches in any order; sums are exact, so the order does not show."""

    def __init__(self) -> None:
        self._status: dict[int, Counter[str]] = defaultdict(Counter)
        self._moments: dict[int, dict[str, Moments]] = defaultdict(dict)

    def add(self, batch: GraspBatch, selected: np.ndarray) -> None:
        """Count all attempts that a batch's header tells of, and the energies of selected rows.

        Args:
            batch: Rows of whole scenes.
            selected: Which of them count, (N,).
        """
        for scene_id, counts in batch.header.counts.items():
            self._status[scene_parts(scene_id).size_mm].update(
                {k: int(v) for k, v in counts.items()}
            )
        good = selected & (batch["synth_status"] == Status.OK)
        for size in np.unique(batch["size_mm"][good]).tolist():
            rows, known = good & (batch["size_mm"] == size), self._moments[size]
            for name in ENERGIES:
                if name in batch:
                    known[name] = known.get(name, NOTHING).plus(moments_of(batch[name][rows]))

    def figures(self, size_mm: int | None = None) -> dict[str, Any]:
        """`by_status`, `by_stage` and `energies` of one size, or of all.

        Energies are means over the rows that were counted; None where there is none.
        """
        sizes = [*self._status, *self._moments] if size_mm is None else [size_mm]
        status: Counter[str] = Counter()
        moments: dict[str, Moments] = dict.fromkeys(ENERGIES, NOTHING)
        for size in sorted(set(sizes)):
            status.update(self._status.get(size, {}))
            for name, found in self._moments.get(size, {}).items():
                moments[name] = moments[name].plus(found)
        by_status = dict(sorted(status.items()))
        return {
            "by_status": by_status,
            "by_stage": by_synth_stage(by_status),
            "energies": {name: m.mean if m.n else None for name, m in moments.items()},
        }


def sized_attempts(counts: Mapping[int, Mapping[str, int]]) -> dict[str, dict[str, Any]]:
    """`by_status` and `by_stage` of every size, by its `size_mm` as text.

    Args:
        counts: Attempts per status label for each `size_mm`.
    """
    return {
        str(size): {
            "by_status": dict(sorted(counts[size].items())),
            "by_stage": by_synth_stage(counts[size]),
        }
        for size in sorted(counts)
    }
