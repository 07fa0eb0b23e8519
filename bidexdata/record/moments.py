"""Moments: count, sum and sum of squares of float32 numbers, exact whatever the order.

Floating-point sums depend on the order in which the numbers come, and so on how a release was cut
into batches. Every finite float32 is a whole multiple of 2^-149 and its square one of 2^-298, so
both sums are kept as integers in these units. Nothing is rounded before a mean is read.
"""

from __future__ import annotations

from collections.abc import Iterable
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


NOTHING = Moments()


def moments_of(values: ArrayLike) -> Moments:
    """Take the moments of float32 numbers; NaN and infinities are left out."""
    numbers = np.asarray(values, np.float32).astype(np.float64)
    numbers = numbers[np.isfinite(numbers)]
    if not len(numbers):
        return NOTHING
    # Both products are exact in float64: 24 bits scaled, and 48 bits scaled.
    total = sum(map(int, (numbers * 2.0**UNIT).tolist()))
    squares = sum(map(int, (numbers * numbers * 2.0 ** (2 * UNIT)).tolist()))
    return Moments(len(numbers), total, squares)


def merged(parts: Iterable[Moments]) -> Moments:
    """Join the moments of disjoint sets."""
    n = total = squares = 0
    for part in parts:
        n, total, squares = n + part.n, total + part.total, squares + part.squares
    return Moments(n, total, squares) if n else NOTHING
