"""Raw grasps a second of the whole synthesis, and the cost of one optimiser step."""

from __future__ import annotations

import contextlib
import statistics
import time
from typing import Any

import numpy as np

from benchmarks.objects import SIZES_MM, hands, objects, scenes
from bidexdata.config import fingerprint
from bidexdata.errors import BidexError
from bidexdata.hands import load_hands
from bidexdata.record import Status
from bidexdata.runs.bench_stages import step_microseconds
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.pipeline import synthesize

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
        **_step_costs(),
        "steps": config.optimise.steps,
        "config": fingerprint(config),
    }


def _step_costs() -> dict[str, float | None]:
    """Per number of contacts: 5 and 10 a hand. The Shadow Hand's where its files are here."""
    hand = hands()
    with contextlib.suppress(BidexError):
        hand = load_hands("shadow")
    return {
        f"microseconds_per_bimanual_step_{hand[0].name}_{name}": step_microseconds(
            objects()[0], hand, SIZES_MM, 2 * ATTEMPTS, contacts=name
        )
        for name in ("fingertips", "with_palm")
    }
