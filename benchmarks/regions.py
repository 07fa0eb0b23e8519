"""What choosing the region pairs of one object at one size costs for each score, and what they are worth.

Their worth is Q1 of contacts that are drawn in the best five pairs, before there is any hand.
"""

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
from bidexdata.runs.bench_regions import pair_q1
from bidexdata.synthesis.regions import RegionConfig, RegionPairs, select_region_pairs


def measure() -> dict[str, Any]:
    """Median and largest time over objects and sizes of the median over repeats, per score."""
    figures: dict[str, Any] = {"config": fingerprint(RegionConfig())}
    for score in ("random", "force", "torque"):
        config = replace(RegionConfig(), score=score)
        times, kept, worth = [], [], []
        for obj in objects():
            for scene in scenes(obj):
                work = partial(_select, obj, scene, config)
                times.append(1000 * median_seconds(work, repeats=3))
                pairs = work()
                kept.append(len(pairs.score))
                worth += pair_q1(pairs, np.random.default_rng(0))
        figures[f"{score}_ms_per_object_size"] = statistics.median(times)
        figures[f"{score}_ms_of_the_slowest"] = max(times)
        figures[f"{score}_pairs_kept_mean"] = statistics.mean(kept)
        figures[f"{score}_q1_mean"] = statistics.mean(worth)
        figures[f"{score}_q1_positive"] = statistics.mean(q > 0 for q in worth)
    return figures


def _select(obj: PreparedObject, scene: Scene, config: RegionConfig) -> RegionPairs:
    return select_region_pairs(obj, scene, config, np.random.default_rng(0))
