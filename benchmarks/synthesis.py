"""Raw grasps a second of the whole synthesis, and the cost of one optimiser step."""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

from benchmarks.machine import median_seconds
from benchmarks.objects import hands, objects, scenes
from bidexdata.config import fingerprint, with_overrides
from bidexdata.hands.contact_sets import contact_view
from bidexdata.record import Status
from bidexdata.synthesis.attempts import draw_attempts, gather_starts
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.optimise import optimise
from bidexdata.synthesis.pipeline import synthesize

FINGERTIPS = ["placement.contacts=[fingertips]"]
ATTEMPTS = 20
"""Per object-size, as many as the paper has per world."""


def measure() -> dict[str, Any]:
    """20 attempts per object-size, regions and placement included; then the optimiser alone."""
    config = SynthConfig()
    synthesize(objects()[0], hands(), scenes(objects()[0])[:1], config, grasps=5, candidates=5)
    rates, counts, residuals = [], [], []
    for obj in objects():
        start = time.perf_counter()
        batch = synthesize(obj, hands(), scenes(obj), config, grasps=ATTEMPTS, candidates=ATTEMPTS)
        rates.append(ATTEMPTS * len(scenes(obj)) / (time.perf_counter() - start))
        counts.append(np.mean(batch.synth_status == Status.OK))
        residuals.append(np.nanmedian(batch.qp_residual))
    return {
        "raw_grasps_per_second": statistics.median(rates),
        "attempts_with_a_grasp": float(np.mean(counts)),
        "qp_residual_median": float(np.median(residuals)),
        "microseconds_per_bimanual_step": _step_cost(config),
        "steps": config.optimise.steps,
        "config": fingerprint(config),
    }


def _step_cost(config: SynthConfig) -> float:
    """Of grasps by the fingertips."""
    obj, config = objects()[0], with_overrides(config, FINGERTIPS)
    attempts = [draw_attempts(obj, hands(), s, config, 0, 4 * ATTEMPTS) for s in scenes(obj)]
    start = gather_starts(attempts)
    touching = [contact_view(hand, "fingertips") for hand in hands()]
    seconds = median_seconds(lambda: optimise(obj, touching, start, config.optimise), repeats=3)
    return 1e6 * seconds / (len(start.size) * config.optimise.steps)
