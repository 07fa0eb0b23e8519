"""Success rates with intervals.

A rate without an interval says little, and grasps of one object fail together: the interval is over
objects (`intervals`: `object bootstrap`, `object t`), as that of a mean. Where objects do not differ,
or there is one only, it is Wilson's, `wilson`, which takes grasps for independent. Every rate names
its method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import sqrt
from typing import Any, Literal

from bidexdata.record.intervals import Z95, ObjectMethod, object_interval


@dataclass(frozen=True, slots=True)
class Rate:
    """k successes of n with a 95 % interval; NaN where n = 0."""

    k: int
    n: int
    rate: float
    low: float
    high: float
    method: ObjectMethod | Literal["wilson"] = "wilson"

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
    """Give the pooled rate of clusters with an interval over clusters.

    Args:
        k: Successes per cluster (object).
        n: Trials per cluster; clusters without trials are left out.
        seed: Seed of the bootstrap, so that a card repeats.

    Returns:
        The interval over clusters, cut to what a rate can be, or Wilson's where all clusters agree
        (an interval over equal clusters has no width) or there is one only.
    """
    pairs = [(int(a), int(b)) for a, b in zip(k, n, strict=True) if b > 0]
    ks, ns = [a for a, _ in pairs], [b for _, b in pairs]
    pooled = rate_interval(sum(ks), sum(ns))
    found = object_interval(ks, ns, seed=seed)
    if found is None:
        return pooled
    low, high = max(0.0, found.low), min(1.0, found.high)
    return Rate(pooled.k, pooled.n, pooled.rate, low, high, found.method)
