"""A random order of n things as a function: no list of the order is kept.

A Feistel network permutes the numbers below a power of four; numbers that leave the range are sent
through again until they are inside (cycle walking), which keeps it a permutation. Evaluate it in
blocks of many thousands: the cost is that of numpy's calls, not of the arithmetic.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Int
from numpy.typing import NDArray

_ROUNDS = 6
"""Source: four rounds give a pseudo-random permutation (Luby and Rackoff); two more cost little."""


def permuted(
    position: Int[np.ndarray, " n"], length: int | Int[np.ndarray, " n"], *key: Any
) -> Int[np.ndarray, " n"]:
    """Give the things that stand at some positions of a random order.

    Args:
        position: Positions in the order, each in [0, length).
        length: Number of things; one for all positions, or one for each.
        key: What the order depends on: whole numbers, one for all positions or one for each.

    Returns:
        A number in [0, length) for each position; all positions give all numbers once.

    >>> sorted(permuted(np.arange(5), 5, 3).tolist())
    [0, 1, 2, 3, 4]
    """
    value = np.asarray(position, np.uint64).copy()
    lengths = np.broadcast_to(np.asarray(length, np.uint64), value.shape)
    keys = np.broadcast_to(hashed(*key), value.shape)
    half = _half_bits(lengths)
    left = np.arange(len(value))
    while len(left):
        value[left] = _feistel(value[left], half[left], keys[left])
        left = left[value[left] >= lengths[left]]
    return value.astype(np.int64)


def hashed(*parts: Any) -> NDArray[np.uint64]:
    """Mix whole numbers (or arrays of them) into 64 bits that look random."""
    state = np.zeros((), np.uint64)
    for part in parts:
        state = _mixed(state ^ np.asarray(part).astype(np.int64).view(np.uint64))
    return state


def uniform(*parts: Any) -> NDArray[np.float64]:
    """A number in [0, 1) that is a function of whole numbers."""
    return (hashed(*parts) >> np.uint64(11)).astype(np.float64) * 2.0**-53


def _feistel(
    value: NDArray[np.uint64], half: NDArray[np.uint64], keys: NDArray[np.uint64]
) -> NDArray[np.uint64]:
    mask = (np.uint64(1) << half) - np.uint64(1)
    high, low = value >> half, value & mask
    for number in range(_ROUNDS):
        high, low = low, high ^ (_mixed(low ^ _mixed(keys + np.uint64(number))) & mask)
    return (high << half) | low


def _half_bits(lengths: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Half the bits of the smallest power of four that holds each length; at least one."""
    top = np.maximum(lengths, np.uint64(2)) - np.uint64(1)
    bits = np.frexp(top.astype(np.float64))[1]
    return ((bits + 1) // 2).astype(np.uint64)


def _mixed(value: Any) -> NDArray[np.uint64]:
    """The finaliser of splitmix64 (Steele, Lea and Flood), after its increment."""
    # Arrays, because numpy warns where a scalar overflows, and this means to.
    z = np.atleast_1d(np.asarray(value, np.uint64)) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return (z ^ (z >> np.uint64(31))).reshape(np.shape(value))
