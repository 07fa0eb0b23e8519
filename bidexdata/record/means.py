"""Means with intervals.

Grasps of one object resemble each other, so what was drawn independently are the objects: an
interval resamples them whole. Which interval a mean has depends on how many objects it is of, and
every mean names it:

- `object bootstrap`, ten objects or more: 2000 times over, as many objects as there are get drawn
  with replacement, each with all its grasps, and the pooled mean (sum of sums / sum of counts) is
  taken; the interval lies between two quantiles of these means. Sums and counts per object are all
  that this needs, so it is the bootstrap that one would do on the rows. Plain 2.5 and 97.5 %
  quantiles are too narrow for few objects, as normal quantiles are against Student's; they are
  moved out by just that (the expanded percentile interval), which leaves large samples as they are.
- `object t`, two to nine objects: too few to resample. Student's t with objects - 1 degrees of
  freedom and the jackknife's standard error, from the means without each object; wide, as it
  should be. With as many grasps of each it is the textbook interval of the objects' means.
- `grasp t`, one object: nothing is known of other objects, so the interval is that of more grasps of
  this one. Resampling grasps would need every number; Student's t from count, mean and variance is
  what their bootstrap tends to, and no narrower where grasps are few.
- `none`: one grasp or none has no interval.

Where all numbers are equal the interval has no width. Where they differ but the objects' means do
not, a bootstrap over objects says nothing and `grasp t` over all rows stands.

Source:
    T. Hesterberg 2015, "What Teachers Should Know About the Bootstrap", The American Statistician
    69(4) (expanded percentile interval). B. Efron 1982, "The Jackknife, the Bootstrap and Other
    Resampling Plans" (standard error of the jackknife).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from math import inf, isfinite, sqrt
from statistics import NormalDist
from typing import Any, Literal

import numpy as np

from bidexdata.record.moments import UNIT, Moments, merged
from bidexdata.record.rates import MIN_CLUSTERS, RESAMPLES, Z95

Method = Literal["object bootstrap", "object t", "grasp t", "none"]
_T95 = (12.7062, 4.30265, 3.18245, 2.77645, 2.57058, 2.44691, 2.36462, 2.30600, 2.26216)
_CELLS = 1_000_000  # draws of objects held at a time


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
        least: The smallest number there can be; Student's intervals are cut there.
        seed: Seed of the bootstrap, so that a card repeats.
    """
    kept = [part for part in objects if part.n]
    every = merged(kept)
    mean, count = every.mean, len(kept)
    if every.n < 2:
        return Mean(every.n, count, mean, float("nan"), float("nan"), "none")
    # By how much the mean moves without an object, times n (n - its count): integers, so exact.
    off = [every.n * part.total - every.total * part.n for part in kept]
    method: Method
    if count == 1 or not any(off):
        method = "grasp t"
        half = _t95(every.n - 1) * sqrt(_float(every.spread, 2) / (every.n - 1)) / every.n
    elif count < MIN_CLUSTERS:
        method = "object t"
        moved = [_float(o, 1) / (every.n - part.n) for o, part in zip(off, kept, strict=True)]
        error = sqrt((count - 1) / count * sum(d * d for d in moved)) / every.n
        half = _t95(count - 1) * error
    else:
        low, high = _bootstrap(kept, seed)
        return Mean(every.n, count, mean, low, high, "object bootstrap")
    return Mean(every.n, count, mean, max(least, mean - half), mean + half, method)


def _bootstrap(objects: Sequence[Moments], seed: int) -> tuple[float, float]:
    count = len(objects)
    totals = np.array([_float(part.total, 1) for part in objects])
    counts = np.array([part.n for part in objects])
    rng = np.random.default_rng(seed)
    at_once = max(1, _CELLS // count)
    means = []
    for first in range(0, RESAMPLES, at_once):
        draws = rng.integers(0, count, (min(at_once, RESAMPLES - first), count))
        means.append(totals[draws].sum(axis=1) / counts[draws].sum(axis=1))
    tail = NormalDist().cdf(-_t95(count - 1) * sqrt(count / (count - 1)))
    low, high = np.quantile(np.concatenate(means), [tail, 1 - tail])
    return float(low), float(high)


def _float(units: int, power: int) -> float:
    return units / (1 << (power * UNIT))


def _t95(freedom: int) -> float:
    """The 97.5 % quantile of Student's t: tabled below ten degrees of freedom, then a series.

    Source:
        M. Abramowitz and I. Stegun 1964, "Handbook of Mathematical Functions", 26.7.5 and table 26.10.
    """
    if freedom <= len(_T95):
        return _T95[freedom - 1]
    z, v = Z95, freedom
    return (
        z
        + (z**3 + z) / (4 * v)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * v**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * v**3)
    )
