"""Verdicts of a release's rows, streamed: what figures need, and no poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.errors import Contradiction
from bidexdata.formats.tables import VERDICT_COLUMNS
from bidexdata.record import GraspBatch, Status

if TYPE_CHECKING:
    from bidexdata.formats.release import Release


class VerdictRows(NamedTuple):
    """Tested rows of one row group."""

    object_id: np.ndarray
    size_mm: np.ndarray
    setting: np.ndarray
    passed: np.ndarray
    """Rows that count as successes."""
    verdict: Mapping[str, np.ndarray]
    """Columns that `validate` writes; an older release lacks some."""


def verdict_rows(
    release: Release, protocol: str, test: str, configuration: str = "selected"
) -> Iterator[VerdictRows]:
    """Yield the rows that a test was run on, one row group at a time.

    Args:
        release: Where.
        protocol: Whose verdicts.
        test: Of it.
        configuration: `selected`, or `audit` for the audit rows that are not selected too.

    Raises:
        Contradiction: The verdict table has other rows than the grasps table.
    """
    names = ["grasp_id", "object_id", "size_mm", "setting", "synth_status", "selected"]
    table = f"verdicts/{protocol}-{test}"
    streams = (
        release.row_groups("grasps", configuration, columns=names),
        release.row_groups(table, configuration),
    )
    for grasps, judged in zip(*streams, strict=True):
        if not judged.column("grasp_id").equals(grasps.column("grasp_id")):
            raise Contradiction(f"{release.path}: rows of {table} are not those of grasps")
        tested = judged.column("success").is_valid()
        batch = GraspBatch.from_arrow(grasps.filter(tested))
        found = GraspBatch.from_arrow(judged.filter(tested))
        if configuration == "audit":
            others = ~batch["selected"]
            batch, found = batch.select(others), found.select(others)
        verdict = {name: found[name] for name in VERDICT_COLUMNS if name in found}
        passed = verdict["success"] & (batch["synth_status"] == Status.OK)
        place = batch["object_id"], batch["size_mm"], batch["setting"]
        yield VerdictRows(*place, passed, verdict)
