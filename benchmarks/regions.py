"""What choosing the region pairs of one object at one size costs, for each score."""

from __future__ import annotations

import statistics
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.machine import median_seconds
from benchmarks.objects import objects, scenes
from bidexdata.config import fingerprint
from bidexdata.objects.prepared import PreparedObject
from bidexdata.record import Scene
from bidexdata.synthesis.regions import RegionConfig, RegionPairs, select_region_pairs


def measure() -> dict[str, Any]:
    """Median over objects and sizes of the median over repeats, per score."""
    figures: dict[str, Any] = {"config": fingerprint(RegionConfig())}
    for score in ("random", "force", "torque"):
        config = replace(RegionConfig(), score=score)
        times, pairs = [], []
        for obj in objects():
            for scene in scenes(obj):
                work = partial(_select, obj, scene, config)
                times.append(1000 * median_seconds(work, repeats=3))
                pairs.append(len(work().score))
        figures[f"{score}_ms_per_object_size"] = statistics.median(times)
        figures[f"{score}_pairs_kept_mean"] = statistics.mean(pairs)
    return figures


def _select(obj: PreparedObject, scene: Scene, config: RegionConfig) -> RegionPairs:
    return select_region_pairs(obj, scene, config, np.random.default_rng(0))
