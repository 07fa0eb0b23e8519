"""Rows a second that `BiDexDataset` gives, with and without clouds, against a plain gather.

The release is small and lies in the page cache, so the figures are those of the code, not of a
disk.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import median_seconds
from bidexdata.loaders import BiDexDataset
from bidexdata.runs.demo import run_demo
from bidexdata.runs.stage import TaskExecution

BATCH = 256
BATCHES = 50


def measure() -> dict[str, Any]:
    """Gather random batches; the raw figure copies as many floats from one array."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        execution = TaskExecution(executor="inline", quiet=True)
        run_demo(
            Path(folder), execution=execution, sources="shapes:box", sizes_mm=(300, 500), grasps=4
        )
        release = Path(folder) / "release"
        figures = {}
        for name, cloud in (("rows", None), ("rows_with_clouds", "cloud_solid")):
            data = BiDexDataset(release, split="train", cloud=cloud)
            lots = [rng.integers(0, len(data), BATCH).tolist() for _ in range(BATCHES)]

            work = partial(_gather, data.__getitems__, lots)
            figures[f"{name}_per_second"] = BATCH * BATCHES / median_seconds(work)
        width = sum(np.asarray(v).size for v in data[0].values() if not isinstance(v, str))
        raw = np.zeros((len(data), width), np.float32)
        take = partial(np.take, raw, axis=0)
        seconds = median_seconds(partial(_gather, take, lots))
        figures["raw_gather_rows_with_clouds_per_second"] = BATCH * BATCHES / seconds
    return {**figures, "floats_per_row_with_cloud": width, "stored_rows": len(data)}


def _gather(take: Callable[[list[int]], Any], lots: list[list[int]]) -> None:
    for rows in lots:
        take(rows)
