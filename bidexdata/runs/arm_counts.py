"""What the arms came to, counted over the rows of a run or a part of it: per size, and whose rows."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection
from typing import Any

import numpy as np

from bidexdata.record import GraspBatch, Status
from bidexdata.runs.run import Run

ROWS = ("all", "selected", "audit")
"""Whose rows are counted; a row may be a selected and an audit row."""


class ArmCounts:
    """Rows per size and label of their arm status, those without a grasp included."""

    def __init__(self) -> None:
        self._counts: dict[str, dict[int, Counter[str]]] = {
            kind: defaultdict(Counter) for kind in ROWS
        }

    @classmethod
    def of_run(cls, run: Run, tasks: Collection[str]) -> ArmCounts:
        """Count the rows of some tasks of a run, by the solutions of the rig that is meant.

        Args:
            run: The run.
            tasks: Ids of tasks with solutions.
        """
        counts = cls()
        for task in run.tasks:
            if task.task_id in tasks:
                counts.add(run.task_arms(task, run.task_batch(task)))
        return counts

    def add(self, batch: GraspBatch) -> None:
        """Count rows with their arm solutions."""
        flags = {"all": np.ones(len(batch), bool)}
        flags |= {kind: batch[kind] for kind in ROWS[1:] if kind in batch}
        labels = np.array([Status(int(s)).label for s in batch["arm_status"]])
        for kind, chosen in flags.items():
            for mm in np.unique(batch["size_mm"]).tolist():
                found = labels[chosen & (batch["size_mm"] == mm)]
                if len(found):
                    self._counts[kind][mm].update(found.tolist())

    def by_status(self, kind: str = "all") -> dict[str, int]:
        """Rows of a kind per label, over all sizes."""
        return dict(sum(self._counts[kind].values(), Counter[str]()))

    def by_size(self, kind: str = "all") -> dict[str, dict[str, int]]:
        """The same per `size_mm`, as text."""
        return {str(mm): dict(found) for mm, found in sorted(self._counts[kind].items())}

    def figures(self, kind: str = "all") -> dict[str, Any]:
        """Plain data: `n` (rows with a grasp), `reachable` (of those), `by_status`, `by_size`."""
        return {**shares(self.by_status(kind)), "by_size": self.by_size(kind)}


def shares(by_status: dict[str, int]) -> dict[str, Any]:
    """`n` (rows with a grasp), `reachable` (of those) and `by_status` of some counts."""
    asked = sum(by_status.values()) - by_status.get(Status.NO_GRASP.label, 0)
    return {"n": asked, "reachable": by_status.get(Status.OK.label, 0), "by_status": by_status}
