import numpy as np
import pytest

from bidexdata.record.rates import MIN_CLUSTERS, clustered_interval, rate_interval


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


def test_few_objects_fall_back_to_wilson_and_empty_ones_do_not_count():
    few = clustered_interval([1] * (MIN_CLUSTERS - 1) + [0] * 5, [2] * (MIN_CLUSTERS - 1) + [0] * 5)
    assert few == rate_interval(MIN_CLUSTERS - 1, 2 * (MIN_CLUSTERS - 1))
