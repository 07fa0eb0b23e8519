"""Means with intervals.

An interval is over objects where these differ (`intervals`: `object bootstrap`, `object t`). Else:

- `grasp t`, one object: nothing is known of other objects, so the interval is that of more grasps of
  this one. Resampling grasps would need every number; Student's t from count, mean and variance is
  what their bootstrap tends to, and no narrower where grasps are few. Where objects have equal means
  of numbers that differ, it is that of all rows.
- `none`: one grasp or none has no interval.

Where all numbers are equal the interval has no width.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from math import inf, isfinite, sqrt
from typing import Any, Literal

from bidexdata.record.intervals import ObjectMethod, object_interval, t95
from bidexdata.record.moments import UNIT, Moments, merged

Method = ObjectMethod | Literal["grasp t", "none"]


@dataclass(frozen=True, slots=True)
class Mean:
    """The mean of n numbers of some objects with a 95 % interval; NaN where there is none."""

    n: int
    objects: int
    mean: float
    low: float
    high: float
    method: Method

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON: NaN becomes None."""
        return {
            k: v if isinstance(v, str) or isfinite(v) else None for k, v in asdict(self).items()
        }


def mean_interval(objects: Iterable[Moments], *, least: float = -inf, seed: int = 0) -> Mean:
    """Give the mean over all numbers of some objects with its interval.

    Args:
        objects: The moments of each object's numbers, in an order that does not depend on how they
            were read (by id); objects without numbers are left out.
        least: The smallest number there can be; intervals are cut there.
        seed: Seed of the bootstrap, so that a card repeats.
    """
    kept = [part for part in objects if part.n]
    every = merged(kept)
    mean, count = every.mean, len(kept)
    if every.n < 2:
        return Mean(every.n, count, mean, float("nan"), float("nan"), "none")
    totals, counts = [part.total for part in kept], [part.n for part in kept]
    found = object_interval(totals, counts, unit=1 << UNIT, seed=seed)
    if found is not None:
        return Mean(every.n, count, mean, max(least, found.low), found.high, found.method)
    half = t95(every.n - 1) * sqrt(every.spread / (1 << 2 * UNIT) / (every.n - 1)) / every.n
    return Mean(every.n, count, mean, max(least, mean - half), mean + half, "grasp t")
