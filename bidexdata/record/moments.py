"""Moments: count, sum and sum of squares of float32 numbers, exact whatever the order.

Floating-point sums depend on the order in which the numbers come, and so on how a release was cut
into batches. Every finite float32 is a whole multiple of 2^-149 and its square one of 2^-298, so
both sums are kept as integers in these units. Nothing is rounded before a mean is read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

UNIT = 149
"""Numbers are whole multiples of 2^-UNIT [-]. Source: the smallest subnormal float32."""
_BITS = 24
"""Of a float32's mantissa."""
_LOWEST = _BITS - UNIT
"""Exponent below which mantissas have fewer bits."""


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
    ends = [*starts[1:], len(numbers)]
    of_run = np.repeat(np.arange(len(ends)), np.diff([*starts, len(numbers)]))
    finite = np.isfinite(numbers)
    counts = np.bincount(of_run[finite], minlength=len(ends)).tolist()
    totals, squares = [0] * len(ends), [0] * len(ends)
    for run, power, total, square in _sums(numbers[finite], of_run[finite]):
        totals[run] += total << power
        squares[run] += square << (2 * power)
    return [Moments(n, totals[i], squares[i]) if n else NOTHING for i, n in enumerate(counts)]


def _sums(
    numbers: NDArray[np.float64], of_run: NDArray[np.integer]
) -> Iterator[tuple[int, int, int, int]]:
    """Sums of the numbers of each run that have one exponent.

    Yields:
        Run, power of two, and the sums of the mantissas, whole numbers of 24 bits in units of
        2^(power - UNIT), and of their squares.
    """
    if not len(numbers):
        return
    exponent = np.maximum(np.frexp(numbers)[1], _LOWEST)
    mantissa = np.ldexp(numbers, _BITS - exponent).astype(np.int64)
    order = np.lexsort([exponent, of_run])
    run, exponent, mantissa = of_run[order], exponent[order], mantissa[order]
    new = (np.diff(run) != 0) | (np.diff(exponent) != 0)
    first = np.concatenate([[0], np.flatnonzero(new) + 1])
    square = mantissa * mantissa  # 48 bits: summed in halves, so that 63 are enough
    sums = [
        np.add.reduceat(part, first).tolist()
        for part in (mantissa, square >> _BITS, square & ((1 << _BITS) - 1))
    ]
    powers = (exponent[first] - _BITS + UNIT).tolist()
    for r, power, total, high, low in zip(run[first].tolist(), powers, *sums, strict=True):
        yield r, power, total, (high << _BITS) + low


def merged(parts: Iterable[Moments]) -> Moments:
    """Join the moments of disjoint sets."""
    return reduce(Moments.plus, parts, NOTHING)
