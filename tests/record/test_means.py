"""Intervals of means: against the rows themselves, and how often they hold what they should."""

import numpy as np
import pytest
from scipy import stats

from bidexdata.record.intervals import MIN_OBJECTS, t95
from bidexdata.record.means import mean_interval
from bidexdata.record.moments import moments_of

TRUE_MEAN = 3.0
COVERAGE = (0.92, 0.98)
"""What counts as 95 %: a thousand repeats scatter by 0.7 percentage points (one deviation), and
intervals from few unlike objects are a point or so too narrow."""


def made_objects(rng: np.random.Generator, objects: int, spread: float = 1.0) -> list[np.ndarray]:
    """Grasps of objects that differ from each other; 5 to 30 of each."""
    level = TRUE_MEAN + spread * rng.normal(size=objects)
    return [rng.normal(v, 1.0, rng.integers(5, 31)).astype(np.float32) for v in level]


def interval(objects, **options):
    return mean_interval(map(moments_of, objects), **options)


@pytest.mark.parametrize("objects", [MIN_OBJECTS, 40])
def test_the_bootstrap_is_the_one_over_whole_rows(objects):
    rng = np.random.default_rng(objects)
    rows = made_objects(rng, objects)
    found = interval(rows)
    draws = (rng.integers(0, objects, objects) for _ in range(8000))
    means = [np.concatenate([rows[i] for i in draw]).mean() for draw in draws]
    tail = stats.norm.cdf(-stats.t.ppf(0.975, objects - 1) * np.sqrt(objects / (objects - 1)))
    low, high = np.quantile(means, [tail, 1 - tail])
    assert found.method == "object bootstrap"
    assert found.mean == pytest.approx(np.concatenate(rows).mean(), rel=1e-6)
    # Both are of finitely many draws: their bounds repeat to some percent of the width.
    assert abs(found.low - low) < 0.06 * (high - low)
    assert abs(found.high - high) < 0.06 * (high - low)
    assert found == interval(rows)


@pytest.mark.parametrize(
    ("objects", "method", "repeats"),
    [
        (1, "grasp t", 2000),
        (2, "object t", 2000),
        (9, "object t", 1000),
        (10, "object bootstrap", 1000),
        (30, "object bootstrap", 600),
    ],
)
def test_95_percent_of_intervals_hold_the_mean(objects, method, repeats):
    rng = np.random.default_rng(objects)
    spread = 0.0 if objects == 1 else 1.0  # one object says nothing of others
    held = 0
    for _ in range(repeats):
        found = interval(made_objects(rng, objects, spread))
        assert found.method == method
        held += found.low <= TRUE_MEAN <= found.high
    assert COVERAGE[0] <= held / repeats <= COVERAGE[1]


def test_one_object_has_the_textbook_interval_of_student():
    values = made_objects(np.random.default_rng(0), 1)[0].astype(float)
    found = interval([values])
    half = stats.t.ppf(0.975, len(values) - 1) * stats.sem(values)
    assert (found.n, found.objects) == (len(values), 1)
    assert found.low == pytest.approx(values.mean() - half, rel=1e-4)
    assert found.high == pytest.approx(values.mean() + half, rel=1e-4)


def test_few_objects_with_one_grasp_each_have_it_too():
    values = np.array([1.0, 4.0, 2.0, 2.5])
    found = interval(values[:, None])
    half = stats.t.ppf(0.975, 3) * stats.sem(values)
    assert (found.method, found.mean) == ("object t", values.mean())
    assert found.low == pytest.approx(found.mean - half, rel=1e-4)
    assert found.high == pytest.approx(found.mean + half, rel=1e-4)


def test_few_objects_with_unlike_numbers_of_grasps_have_the_jackknife_of_efron():
    """The means without each object scatter about their own mean, which is not the pooled one."""
    rows = [np.array(r) for r in ([1.0], [3.0, 5.0, 4.0, 6.0, 2.0], [0.5, 1.5])]
    found, k = interval(rows), len(rows)
    without = [np.concatenate([r for j, r in enumerate(rows) if j != i]).mean() for i in range(k)]
    error = np.sqrt((k - 1) / k * np.sum((np.array(without) - np.mean(without)) ** 2))
    assert np.mean(without) != pytest.approx(found.mean, rel=0.05)
    assert found.method == "object t"
    assert found.high - found.mean == pytest.approx(stats.t.ppf(0.975, k - 1) * error, rel=1e-4)


@pytest.mark.parametrize("objects", [1, 2, 9, 10, 25])
@pytest.mark.parametrize("value", [0.0, 0.1])
def test_equal_numbers_have_an_interval_without_width(objects, value):
    found = interval([np.full(3 + i, value, np.float32) for i in range(objects)])
    assert found.low == found.mean == found.high == np.float32(value)


@pytest.mark.parametrize("objects", [2, 12])
def test_objects_of_equal_mean_still_have_a_width_where_grasps_differ(objects):
    found = interval([[1.0, 3.0]] * objects)
    assert found.method == "grasp t"
    assert found.low < 2.0 < found.high


def test_what_was_not_measured_does_not_count():
    rows = made_objects(np.random.default_rng(1), 15)
    holes = [np.append(r, [np.nan, np.inf]) for r in rows] + [np.array([np.nan]), np.array([])]
    assert interval(holes) == interval(rows)


@pytest.mark.parametrize("objects", [[], [[]], [[np.nan]], [[0.5]], [[0.5], [], [np.nan]]])
def test_one_grasp_or_none_has_no_interval(objects):
    found = interval(objects)
    plain = found.to_dict()
    assert (plain["low"], plain["high"], plain["method"]) == (None, None, "none")
    assert plain["mean"] == (0.5 if found.n else None)


def test_an_interval_is_cut_where_no_number_can_be():
    assert interval([[0.0, 1.0]]).low < 0
    assert interval([[0.0, 1.0]], least=0.0).low == 0


def test_students_quantile_is_that_of_scipy():
    found = [t95(v) for v in range(1, 500)]
    assert found == pytest.approx(stats.t.ppf(0.975, np.arange(1, 500)), abs=2e-4)
