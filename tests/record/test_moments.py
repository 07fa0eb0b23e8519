"""Exact sums: nothing depends on the order of the numbers or on how they are cut."""

from fractions import Fraction

import numpy as np
import pytest

from bidexdata.record.moments import NOTHING, UNIT, merged, moments_of

TINY, HUGE = np.finfo(np.float32).smallest_subnormal, np.finfo(np.float32).max
EDGES = [0.0, -0.0, TINY, -TINY, HUGE, 0.1, -0.1, 1e-30, 3.0, np.nan, np.inf, -np.inf]


def numbers(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=300) * 10.0 ** rng.integers(-20, 20, 300)
    return rng.permutation(np.concatenate([spread, EDGES])).astype(np.float32)


@pytest.mark.parametrize("seed", range(3))
def test_sums_are_those_of_rational_arithmetic(seed):
    every = numbers(seed)
    finite = [Fraction(float(v)) for v in every if np.isfinite(v)]
    found = moments_of(every)
    assert found.n == len(finite)
    assert Fraction(found.total, 1 << UNIT) == sum(finite)
    # A square that float64 cannot hold, of numbers below 1e-30, is the only thing cut off.
    assert float(Fraction(found.squares, 1 << 2 * UNIT)) == float(sum(v * v for v in finite))


@pytest.mark.parametrize("seed", range(3))
def test_order_and_cuts_change_nothing(seed):
    every, rng = numbers(seed), np.random.default_rng(seed)
    for _ in range(5):
        cuts = np.sort(rng.integers(0, len(every), 7))
        parts = np.split(rng.permutation(every), cuts)
        assert merged(map(moments_of, parts)) == moments_of(every)


@pytest.mark.parametrize("value", [0.0, 0.1, TINY, -3.7, 1e20])
def test_equal_numbers_have_no_spread_at_all(value):
    found = moments_of([value] * 137)
    assert found.spread == 0
    assert found.mean == np.float32(value)


def test_nothing_has_no_mean():
    assert moments_of([]) == moments_of([np.nan, np.inf]) == merged([]) == NOTHING
    assert np.isnan(NOTHING.mean)
