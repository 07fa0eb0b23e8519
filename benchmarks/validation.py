"""Verdicts a second of test f under paper-1, one process, model building included."""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

from benchmarks.objects import grasps, hands, objects
from bidexdata.config import fingerprint
from bidexdata.record import Status
from bidexdata.validation import load_protocol, validate_grasps


def measure() -> dict[str, Any]:
    """Validate the audit and selected rows of every object; the rate counts grasps that ran."""
    protocol = load_protocol("paper-1")
    rates, audit, selected, pd = [], [], [], []
    for index, obj in enumerate(objects()):
        batch = grasps(index)
        start = time.perf_counter()
        columns = validate_grasps(batch, obj, hands(), protocol)
        seconds = time.perf_counter() - start
        rates.append(np.sum(columns["verdict_status"] != Status.NOT_RUN) / seconds)
        audit.append(columns["success"][batch.audit])
        selected.append(columns["success"][batch.selected])
        pd.append(columns["pd"][batch.selected])
    return {
        "verdicts_per_second": statistics.median(rates),
        "suc_f_unselected": float(np.mean(np.concatenate(audit))),
        "suc_f_selected": float(np.mean(np.concatenate(selected))),
        "pd_mm_selected_mean": 1000 * float(np.nanmean(np.concatenate(pd))),
        "protocol": fingerprint(protocol),
    }
