"""Ways in joint space: what the planner returns the checker accepts, and the same twice."""

from __future__ import annotations

import numpy as np
import pytest

from bidexdata.arms.config import SearchConfig
from bidexdata.arms.planner import plan_way, planning, resampled, together, way_length

LOW, HIGH = np.full(2, -3.0), np.full(2, 3.0)
START, GOAL = np.array([-1.5, 0.0]), np.array([1.5, 0.0])
CONFIG = SearchConfig(nodes=200, spread=3.0)


def beside_the_wall(q: np.ndarray) -> np.ndarray:
    """A wall between start and goal, with room above and below."""
    return ~((np.abs(q[:, 0]) < 0.2) & (np.abs(q[:, 1]) < 1.0))


def test_a_way_leads_round_a_wall_the_same_way_twice():
    way = plan_way(START, GOAL, LOW, HIGH, beside_the_wall, CONFIG)
    assert way is not None
    np.testing.assert_array_equal(way[[0, -1]], [START, GOAL])
    assert ((way >= LOW) & (way <= HIGH)).all()
    # Between two checks a corner of the wall may be cut by a step at most.
    inside = resampled(way, 300)
    deep = (np.abs(inside[:, 0]) < 0.2 - CONFIG.step) & (np.abs(inside[:, 1]) < 1.0 - CONFIG.step)
    assert not deep.any()
    again = plan_way(START, GOAL, LOW, HIGH, beside_the_wall, CONFIG)
    np.testing.assert_array_equal(way, again)


@pytest.mark.parametrize("nodes", [0, 1, 200])
def test_without_a_wall_the_way_is_the_straight_one(nodes):
    everywhere = SearchConfig(nodes=nodes, spread=3.0)
    way = plan_way(START, GOAL, LOW, HIGH, lambda q: np.ones(len(q), bool), everywhere)
    assert way is not None
    np.testing.assert_array_equal(way, [START, GOAL])
    assert way_length(way) == 3.0


def test_there_is_no_way_through_a_closed_wall_or_from_a_place_that_is_not_free():
    closed = plan_way(START, GOAL, LOW, HIGH, lambda q: np.abs(q[:, 0]) > 0.2, CONFIG)
    assert closed is None
    assert plan_way(START, GOAL, LOW, HIGH, lambda q: q[:, 0] > -1.0, CONFIG) is None


@pytest.mark.parametrize("count", [1, 2, 7])
def test_resampling_keeps_the_ends_and_takes_equal_steps_on_a_line(count):
    path = resampled(np.stack([START, GOAL]), count)
    np.testing.assert_array_equal(path[[0, -1]], [START, GOAL])
    np.testing.assert_allclose(np.diff(path[:, 0]), 3.0 / count, atol=1e-12)


def test_plans_that_are_made_together_are_those_made_alone():
    goals = [GOAL, np.array([1.5, 1.0]), np.array([-0.1, 0.0]), np.array([1.0, -2.0])]
    plans = [planning(START, goal, LOW, HIGH, CONFIG, straight=True) for goal in goals]
    found = together(plans, lambda q, _of: beside_the_wall(q))
    for goal, way in zip(goals, found, strict=True):
        alone = plan_way(START, goal, LOW, HIGH, beside_the_wall, CONFIG)
        assert (way is None) == (alone is None)
        if way is not None:
            np.testing.assert_array_equal(way, alone)
    assert found[0] is not None
    assert found[2] is None
    assert together([], lambda q, _of: beside_the_wall(q)) == []
