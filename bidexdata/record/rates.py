"""Success rates with intervals.

A rate without an interval says little, and grasps of one object fail together: where there are
enough objects the interval resamples objects, otherwise it is Wilson's, which is too narrow for
clustered rows. Every rate names its method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import sqrt
from typing import Any, Literal

import numpy as np

Z95 = 1.959963984540054
"""Half width of the central 95 % of the normal distribution [-]."""
MIN_CLUSTERS = 10
"""Objects below which a bootstrap over objects says nothing [-]. Source: our choice."""
RESAMPLES = 2000
"""Bootstrap resamples; 95 % bounds then repeat to about 0.2 percentage points. Source: ours."""


@dataclass(frozen=True, slots=True)
class Rate:
    """k successes of n with a 95 % interval; NaN where n = 0."""

    k: int
    n: int
    rate: float
    low: float
    high: float
    method: Literal["wilson", "object bootstrap"] = "wilson"

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON: NaN becomes None."""
        plain = asdict(self)
        return plain if self.n else {**plain, "rate": None, "low": None, "high": None}

    def __str__(self) -> str:
        """Percentages for a person: `91.2 % (88.0-93.6, 456 of 500)`."""
        if self.n == 0:
            return "not available (0 of 0)"
        return (
            f"{100 * self.rate:.1f} % ({100 * self.low:.1f}-{100 * self.high:.1f}, "
            f"{self.k} of {self.n})"
        )


def rate_interval(k: int, n: int) -> Rate:
    """Give the rate k / n with Wilson's 95 % score interval.

    Source:
        Wilson 1927, "Probable inference, the law of succession, and statistical inference".
    """
    k, n = int(k), int(n)
    if not 0 <= k <= n:
        raise ValueError(f"{k} successes of {n} is no rate")
    if n == 0:
        return Rate(0, 0, float("nan"), float("nan"), float("nan"))
    p, zz = k / n, Z95**2
    centre = (p + zz / (2 * n)) / (1 + zz / n)
    half = Z95 * sqrt(p * (1 - p) / n + zz / (4 * n * n)) / (1 + zz / n)
    low = 0.0 if k == 0 else max(0.0, centre - half)
    high = 1.0 if k == n else min(1.0, centre + half)
    return Rate(k, n, p, low, high)


def clustered_interval(k: Sequence[int], n: Sequence[int], seed: int = 0) -> Rate:
    """Give the pooled rate of clusters with an interval that resamples whole clusters.

    Args:
        k: Successes per cluster (object).
        n: Trials per cluster; clusters without trials are left out.
        seed: Seed of the bootstrap, so that a card repeats.

    Returns:
        A percentile bootstrap over clusters, or Wilson's interval below `MIN_CLUSTERS` of them or
        where all clusters agree (a bootstrap of equal clusters has no width).
    """
    ks, ns = np.asarray(k, np.int64), np.asarray(n, np.int64)
    ks, ns = ks[ns > 0], ns[ns > 0]
    pooled = rate_interval(int(ks.sum()), int(ns.sum()))
    if len(ns) < MIN_CLUSTERS or pooled.k in (0, pooled.n):
        return pooled
    rng = np.random.default_rng(seed)
    draws = np.empty(RESAMPLES)
    for r in range(RESAMPLES):
        chosen = rng.integers(0, len(ns), len(ns))
        draws[r] = ks[chosen].sum() / ns[chosen].sum()
    low, high = (float(v) for v in np.quantile(draws, [0.025, 0.975]))
    return Rate(pooled.k, pooled.n, pooled.rate, low, high, "object bootstrap")
