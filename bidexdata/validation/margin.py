"""Load margin: the largest multiple of the protocol's load under which a grasp passes the test.

A grid of doublings finds the octave, bisection of the logarithm narrows it. Both take for granted
that a grasp which holds a load holds a lighter one.
"""

from __future__ import annotations

from collections.abc import Callable

SMALLEST, LARGEST = 1 / 16, 64.0
"""Multiples between which the margin is sought; below the first it is 0 [-]."""
BISECTIONS = 3
"""Halvings of the last octave: the margin is known to a factor 2^(1/8), 9 %."""


def largest_multiple(holds: Callable[[float], bool], *, holds_one: bool) -> float:
    """Find the largest multiple that holds, to 9 % below, at most `LARGEST`.

    Args:
        holds: Tries a multiple.
        holds_one: Whether the load itself holds; it is not tried again, so that a margin of at
            least 1 and success are the same statement.
    """
    low = high = 1.0
    if holds_one:
        while True:
            if low >= LARGEST:
                return LARGEST
            high = 2 * low
            if not holds(high):
                break
            low = high
    else:
        while True:
            low = high / 2
            if low < SMALLEST:
                return 0.0
            if holds(low):
                break
            high = low
    for _ in range(BISECTIONS):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if holds(middle) else (low, middle)
    return float(low)
