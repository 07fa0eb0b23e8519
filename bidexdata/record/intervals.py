"""95 % intervals over objects, for means of numbers and for success rates alike.

Grasps of one object resemble each other, so what was drawn independently are the objects: an
interval resamples them whole. Sums and counts per object are all that this needs, so it is the
interval that one would compute from the rows. How depends on how many objects there are, and every
interval names it:

- `object bootstrap`, ten objects or more: 2000 times over, as many objects as there are get drawn
  with replacement, each with all its grasps, and the pooled mean (sum of sums / sum of counts) is
  taken; the interval lies between two quantiles of these means. Plain 2.5 and 97.5 % quantiles are
  too narrow for few objects, as normal quantiles are against Student's; they are moved out by just
  that (the expanded percentile interval), which leaves large samples as they are.
- `object t`, two to nine objects: too few to resample. Student's t with objects - 1 degrees of
  freedom and the jackknife's standard error, from how the means without each object scatter about
  their own mean; wide, as it should be. With as many grasps of each it is the textbook interval of the objects' means.

Where the objects' means do not differ, or there is one object only, objects say nothing.

Source:
    T. Hesterberg 2015, "What Teachers Should Know About the Bootstrap", The American Statistician
    69(4) (expanded percentile interval). B. Efron 1982, "The Jackknife, the Bootstrap and Other
    Resampling Plans" (standard error of the jackknife).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from statistics import NormalDist
from typing import Literal, NamedTuple

import numpy as np

ObjectMethod = Literal["object bootstrap", "object t"]

Z95 = 1.959963984540054
"""Half width of the central 95 % of the normal distribution [-]."""
MIN_OBJECTS = 10
"""Objects below which a bootstrap over objects says nothing [-]. Source: our choice."""
RESAMPLES = 2000
"""Bootstrap resamples; 95 % bounds then repeat to about 0.2 percentage points. Source: ours."""
_T95 = (12.7062, 4.30265, 3.18245, 2.77645, 2.57058, 2.44691, 2.36462, 2.30600, 2.26216)
_CELLS = 1_000_000  # draws of objects held at a time


class Interval(NamedTuple):
    """From where to where, and how it was found."""

    low: float
    high: float
    method: ObjectMethod


def object_interval(
    totals: Sequence[int], counts: Sequence[int], *, unit: int = 1, seed: int = 0
) -> Interval | None:
    """Give the interval of a pooled mean over objects; None where objects say nothing.

    Args:
        totals: Sum over the grasps of each object, in whole parts of 1 / unit, so that it is exact.
        counts: Grasps of each object, none 0.
        unit: Parts of one.
        seed: Seed of the bootstrap, so that a card repeats.
    """
    n, total, objects = sum(counts), sum(totals), len(counts)
    # By how much the mean moves without an object, times n (n - its count): integers, so exact.
    off = [n * t - total * c for t, c in zip(totals, counts, strict=True)]
    if not any(off):
        return None
    if objects >= MIN_OBJECTS:
        return Interval(*_bootstrap([t / unit for t in totals], counts, seed), "object bootstrap")
    moved = [o / unit / (n - c) for o, c in zip(off, counts, strict=True)]
    centre = sum(moved) / objects  # 0 where all objects have as many grasps
    error = sqrt((objects - 1) / objects * sum((d - centre) ** 2 for d in moved)) / n
    mean, half = total / (n * unit), t95(objects - 1) * error
    return Interval(mean - half, mean + half, "object t")


def _bootstrap(totals: Sequence[float], counts: Sequence[int], seed: int) -> tuple[float, float]:
    sums, sizes, objects = np.asarray(totals), np.asarray(counts), len(counts)
    rng = np.random.default_rng(seed)
    at_once = max(1, _CELLS // objects)
    means = []
    for first in range(0, RESAMPLES, at_once):
        draws = rng.integers(0, objects, (min(at_once, RESAMPLES - first), objects))
        means.append(sums[draws].sum(axis=1) / sizes[draws].sum(axis=1))
    tail = NormalDist().cdf(-t95(objects - 1) * sqrt(objects / (objects - 1)))
    low, high = np.quantile(np.concatenate(means), [tail, 1 - tail])
    return float(low), float(high)


def t95(freedom: int) -> float:
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
