"""How a metric's mean is printed for a person: name, unit, digits, interval."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any, NamedTuple

from bidexdata.record.fields import HEADLINE, METRICS, MOTION


class Shown(NamedTuple):
    """How a metric is printed."""

    head: str
    unit: str = ""
    scale: float = 1.0
    """Units printed per SI unit."""
    digits: int = 2


SHOWN = {
    "pd": Shown("PD", "mm", 1000),
    "spd": Shown("SPD", "mm", 1000),
    "cdc": Shown("CDC", "mm", 1000),
    "contact_number": Shown("contacts", digits=1),
    "contact_distance": Shown("contact distance", "mm", 1000),
    "q1": Shown("Q1", digits=4),
    "qp_certificate": Shown("QP certificate", digits=4),
    "load_margin": Shown("load margin"),
    "drift_pos": Shown("drift seen", "mm", 1000, 1),
    "drift_rot": Shown("drift seen", "deg", 180 / pi, 1),
    "time": Shown("time", "s"),
}
BLOCKS = (HEADLINE, tuple(m for m in METRICS if m not in (*HEADLINE, *MOTION)), MOTION)
"""Metrics that stand side by side: all in one table would be wider than a terminal."""


def metric_head(name: str) -> str:
    """Name and unit of a metric: `PD mm`."""
    return f"{SHOWN[name].head} {SHOWN[name].unit}".rstrip()


def metric_text(name: str, mean: Mapping[str, Any] | None, *, unit: bool = False) -> str:
    """A mean with its interval: `0.90 (0.81-1.02)`, or `0.90 mm (0.81-1.02)`; `-` without one."""
    shown = SHOWN[name]
    if not mean or mean["mean"] is None:
        return "-"

    def number(key: str) -> str:
        return f"{mean[key] * shown.scale:.{shown.digits}f}"

    text = f"{number('mean')} {shown.unit}".rstrip() if unit else number("mean")
    known = mean.get("low") is not None
    return f"{text} ({number('low')}-{number('high')})" if known else text
