import numpy as np
import pytest

from bidexdata.record.intervals import MIN_OBJECTS
from bidexdata.record.means import mean_interval
from bidexdata.record.moments import moments_of
from bidexdata.record.rates import clustered_interval, rate_interval


@pytest.mark.parametrize(("k", "n"), [(0, 1), (1, 1), (0, 50), (50, 50), (7, 20), (999, 1000)])
def test_wilson_bounds_solve_the_score_equation(k, n):
    # The bounds are the p with |k/n - p| = z sqrt(p (1 - p) / n): solve it by bisection instead.
    rate = rate_interval(k, n)
    for bound, side in ((rate.low, -1), (rate.high, 1)):
        lo, hi = (0.0, k / n) if side < 0 else (k / n, 1.0)
        for _ in range(200):
            p = (lo + hi) / 2
            outside = abs(k / n - p) > 1.959963984540054 * np.sqrt(p * (1 - p) / n)
            if side < 0:
                lo, hi = (p, hi) if outside else (lo, p)
            else:
                lo, hi = (lo, p) if outside else (p, hi)
        assert bound == pytest.approx((lo + hi) / 2, abs=1e-9)


def test_nothing_tried_has_no_rate():
    rate = rate_interval(0, 0)
    assert np.isnan(rate.rate)
    assert rate.to_dict()["rate"] is None
    assert "not available" in str(rate)


@pytest.mark.parametrize(("k", "n"), [(2, 1), (-1, 4)])
def test_impossible_counts_are_refused(k, n):
    with pytest.raises(ValueError, match="is no rate"):
        rate_interval(k, n)


def test_clustered_rows_get_a_wider_interval_than_independent_ones():
    k, n = [0, 20] * 10, [20] * 20  # an object fails or succeeds as a whole
    clustered, independent = clustered_interval(k, n), rate_interval(sum(k), sum(n))
    assert clustered.method == "object bootstrap"
    assert clustered.high - clustered.low > 2 * (independent.high - independent.low)
    assert clustered == clustered_interval(k, n)


def test_clusters_without_trials_do_not_count():
    k, n = [1, 2, 0, 4], [4, 4, 4, 4]
    assert clustered_interval([*k, 0, 0], [*n, 0, 0]) == clustered_interval(k, n)


@pytest.mark.parametrize("objects", [1, 2, MIN_OBJECTS - 1, MIN_OBJECTS + 2])
@pytest.mark.parametrize("wins", [0, 5, 10])
def test_objects_that_agree_have_wilsons_interval(objects, wins):
    found = clustered_interval([wins] * objects, [10] * objects)
    assert found == rate_interval(wins * objects, 10 * objects)
    assert found.low < found.high


@pytest.mark.parametrize("objects", [2, MIN_OBJECTS - 1, MIN_OBJECTS, 30])
def test_a_rate_has_the_interval_that_the_mean_of_its_rows_has(objects):
    rng = np.random.default_rng(objects)
    rows = [rng.random(20) < p for p in rng.uniform(0.4, 0.6, objects)]
    rate = clustered_interval([int(r.sum()) for r in rows], [len(r) for r in rows])
    mean = mean_interval([moments_of(r) for r in rows])
    assert rate.method == mean.method
    assert rate.low == pytest.approx(max(0.0, mean.low), abs=1e-12)
    assert rate.high == pytest.approx(min(1.0, mean.high), abs=1e-12)


@pytest.mark.parametrize("objects", [3, 9, 10, 30])
def test_95_percent_of_intervals_hold_the_rate(objects):
    rng = np.random.default_rng(objects)
    held = 0
    for _ in range(600):
        found = clustered_interval(
            rng.binomial(20, rng.beta(4, 2, objects)).tolist(), [20] * objects
        )
        held += found.low <= 4 / 6 <= found.high
    assert 0.92 <= held / 600 <= 0.985
