"""Laws of charts: where a number lies, what is cut, what is a dot."""

import numpy as np
import pytest

from bidexdata.pictures.chart import PAPER, Band, Line, log_chart, powers_of_ten

RED = (200, 0, 0)
SIZE = {"title": "t", "footer": "f", "width": 600, "height": 300}


def drawn(values, bands=()) -> np.ndarray:
    """Where the line is red: rows and columns of the plot."""
    chart = np.asarray(log_chart([Line("a", np.array(values), RED)], bands=bands, **SIZE)).astype(
        int
    )
    red = (chart[..., 0] > 150) & (chart[..., 1] < 90)
    red[:, 340:] = False  # the legend
    return np.argwhere(red)


def test_equal_factors_are_equal_ways_up():
    rows = [drawn([v] * 40 + [np.nan, 1e-3, np.nan, 1e2])[:, 0] for v in (1e-2, 1e-1, 1.0, 1e1)]
    at = [np.bincount(r).argmax() for r in rows]
    steps = -np.diff(at)
    assert np.all(steps > 10)
    assert np.ptp(steps) <= 1


def test_nothing_below_the_lower_edge_is_lost():
    low = drawn([1e-30] * 20 + [1.0] * 2)[:, 0].max()
    assert low == drawn([0.0] * 20 + [1.0] * 2)[:, 0].max()


def test_a_gap_is_left_where_there_is_no_number_and_where_a_band_begins():
    whole = drawn([1.0, 1.0, 1.0, 1.0])
    for cut in (drawn([1.0, 1.0, np.nan, 1.0, 1.0]), drawn([1.0] * 4, [Band("b", 2, 4)])):
        columns = np.unique(cut[:, 1])
        assert np.max(np.diff(columns)) > 20
    assert np.max(np.diff(np.unique(whole[:, 1]))) == 1


def test_a_number_alone_is_a_dot():
    assert len(drawn([np.nan, 1.0, np.nan])) > 9


@pytest.mark.parametrize(
    ("values", "powers"),
    [
        ([], (-1, 0)),
        ([0.0, np.nan], (-1, 0)),
        ([1.0], (-1, 0)),
        ([0.02, 3.0], (-2, 1)),
        ([1e-30, 1], (-7, 0)),
    ],
)
def test_powers_of_ten_enclose_the_numbers(values, powers):
    assert powers_of_ten(np.array(values, float)) == powers


def test_the_same_numbers_give_the_same_picture():
    one, two = (log_chart([Line("a", np.geomspace(1, 5, 9), RED)], **SIZE) for _ in range(2))
    assert one.tobytes() == two.tobytes()
    assert one.getpixel((0, 0)) == PAPER
