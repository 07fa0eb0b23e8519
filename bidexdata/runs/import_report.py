"""What an import says of itself: files, objects, and rows per status."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bidexdata.objects.sources.item import UNKNOWN
from bidexdata.record import GraspBatch, Status
from bidexdata.runs.import_scan import FileRow
from bidexdata.runs.run import Run
from bidexdata.runs.stage import StageReport
from bidexdata.wording import counted


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportReport:
    """What became of the files."""

    run: Path
    fingerprint: str = ""
    """Of the run; empty when nothing could be imported."""
    files: tuple[FileRow, ...] = ()
    objects: tuple[Mapping[str, Any], ...] = ()
    """Index rows of the library."""
    stage: StageReport = field(default_factory=lambda: StageReport(tasks=0, before=0))
    """Of the last pass."""
    by_status: Mapping[str, int] = field(default_factory=dict)
    """Rows of the run per status; `joint_range` are grasps that our hand cannot take."""
    unknown: tuple[str, ...] = ()
    """What the files do not say, one phrase each."""
    seconds: float = 0.0

    @property
    def failed(self) -> tuple[FileRow, ...]:
        """Files of which nothing could be imported."""
        return tuple(f for f in self.files if f.failed)

    @property
    def rows(self) -> int:
        """Grasps that the files hold and the run takes."""
        return sum(f.rows for f in self.files)

    @property
    def left_out(self) -> int:
        """Grasps of readable files that could not be used."""
        return sum(f.left_out for f in self.files)


def by_status(run: Run) -> dict[str, int]:
    """Rows of a whole run per label of their status."""
    total: Counter[str] = Counter()
    for batch in run.batches():
        total.update(counted_by_status(batch))
    return dict(sorted(total.items()))


def counted_by_status(batch: GraspBatch) -> dict[str, int]:
    """Rows per label of their status."""
    found, counts = np.unique(batch["synth_status"], return_counts=True)
    return {Status(s).label: int(n) for s, n in zip(found, counts, strict=True)}


def unknown_origins(index: Sequence[Mapping[str, Any]]) -> list[str]:
    """Of how many objects nobody stated the licence."""
    made = [r for r in index if r["status"] == Status.OK]
    silent = sum(r["licence"] == UNKNOWN for r in made)
    if not silent:
        return []
    return [f"licence of {silent} of {counted(len(made), 'object')}: an INDEX.csv beside them says"]
