"""Moments: count, sum and sum of squares of float32 numbers, exact whatever the order.

Floating-point sums depend on the order in which the numbers come, and so on how a release was cut
into batches. Every finite float32 is a whole multiple of 2^-149 and its square one of 2^-298, so
both sums are kept as integers in these units. Nothing is rounded before a mean is read.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

UNIT = 149
"""Numbers are whole multiples of 2^-UNIT [-]. Source: the smallest subnormal float32."""


class Moments(NamedTuple):
    """What is kept of a set of numbers."""

    n: int = 0
    total: int = 0
    """Sum in units of 2^-UNIT."""
    squares: int = 0
    """Sum of squares in units of 2^-(2 UNIT)."""

    @property
    def mean(self) -> float:
        """The mean, rounded once; NaN where there is nothing."""
        return self.total / (self.n << UNIT) if self.n else float("nan")

    @property
    def spread(self) -> int:
        """n^2 times the variance over n, in the units of `squares`: 0 exactly where all are equal."""
        return self.n * self.squares - self.total**2

    def plus(self, other: Moments) -> Moments:
        """Join with the moments of a disjoint set."""
        if not self.n or not other.n:
            return other if not self.n else self
        return Moments(self.n + other.n, self.total + other.total, self.squares + other.squares)


NOTHING = Moments()


def moments_of(values: ArrayLike) -> Moments:
    """Take the moments of float32 numbers; NaN and infinities are left out."""
    return moments_of_runs(values, [0])[0]


def moments_of_runs(values: ArrayLike, starts: Sequence[int]) -> list[Moments]:
    """Take the moments of runs of float32 numbers that stand one after the other.

    Args:
        values: The numbers; NaN and infinities are left out.
        starts: Where each run begins, the first at 0.
    """
    with np.errstate(invalid="ignore"):  # some bit patterns of NaN complain when they are widened
        numbers = np.asarray(values, np.float32).astype(np.float64)
    finite = np.isfinite(numbers)
    numbers = np.where(finite, numbers, 0.0)
    # Both products are exact in float64: 24 bits scaled, and 48 bits scaled.
    units = [int(v) for v in (numbers * 2.0**UNIT).tolist()]
    squares = [int(v) for v in (numbers * numbers * 2.0 ** (2 * UNIT)).tolist()]
    counts = finite.tolist()
    found = []
    for first, last in zip(starts, [*starts[1:], len(units)], strict=True):
        n = sum(counts[first:last])
        run = Moments(n, sum(units[first:last]), sum(squares[first:last]))
        found.append(run if n else NOTHING)
    return found


def merged(parts: Iterable[Moments]) -> Moments:
    """Join the moments of disjoint sets."""
    return reduce(Moments.plus, parts, NOTHING)
