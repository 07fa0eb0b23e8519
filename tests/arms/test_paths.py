"""Waypoints, smoothing and timing of the paths of arms."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from bidexdata.arms.smoothing import NEAR, Smoother, roughness
from bidexdata.arms.timing import knot_times
from bidexdata.arms.waypoints import Poses, lifted, line, stand_off
from bidexdata.frames import quat_angle, random_quat

PIN = 1e-9
SOLVER = 2e-5  # OSQP stops at 1e-7 of its residuals; paths are of a few radians


def poses(rng, count: int) -> Poses:
    return Poses(
        rng.uniform(-0.5, 0.5, (count, 3)) + np.array([0, 0, 0.5]), random_quat(rng, (count,))
    )


def test_a_line_is_straight_turns_evenly_and_ends_where_it_should(rng):
    start, end = poses(rng, 20), poses(rng, 20)
    way = line(start, end, 5)
    assert way.pos.shape == (20, 5, 3)
    np.testing.assert_allclose(way.pos[:, -1], end.pos, atol=1e-12)
    assert quat_angle(way.quat_wxyz[:, -1], end.quat_wxyz).max() < 1e-7
    whole = quat_angle(start.quat_wxyz, end.quat_wxyz)
    steps = np.diff(np.concatenate([start.pos[:, None], way.pos], axis=1), axis=1)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[:, :1], steps.shape), atol=1e-12)
    first = quat_angle(start.quat_wxyz, way.quat_wxyz[:, 0])
    np.testing.assert_allclose(first, whole / 5, atol=1e-7)


def test_a_line_to_where_it_begins_stands_still(rng):
    start = poses(rng, 3)
    way = line(start, start, 4)
    np.testing.assert_allclose(way.pos, np.repeat(start.pos[:, None], 4, axis=1), atol=1e-12)


def test_the_stand_off_lies_as_far_away_as_it_should_and_not_in_the_table(rng):
    before, below = poses(rng, 200), rng.uniform(0.0, 0.3, 200)
    away = rng.normal(size=(200, 3))
    back = stand_off(before, away, below, 0.02)
    np.testing.assert_array_equal(back.quat_wxyz, before.quat_wxyz)
    plain = before.pos + away
    low = plain[:, 2] - below < 0.02
    assert low.any()
    np.testing.assert_allclose(back.pos[~low], plain[~low], atol=1e-12)
    np.testing.assert_allclose(back.pos[low, :2], plain[low, :2], atol=1e-12)
    np.testing.assert_allclose((back.pos[:, 2] - below)[low], 0.02, atol=1e-12)


def test_lifting_moves_along_z_alone(rng):
    pose = poses(rng, 4)
    up = lifted(pose, 0.1)
    np.testing.assert_allclose(up.pos - pose.pos, np.tile([0, 0, 0.1], (4, 1)))


@pytest.fixture(scope="module")
def smoother() -> Smoother:
    return Smoother(40, 8)


def walk(rng, knots: int = 40, joints: int = 8) -> np.ndarray:
    return np.cumsum(rng.uniform(-0.06, 0.06, (knots, joints)), axis=0)


PINNED = np.isin(np.arange(40), [0, 20, 21, 22, 39])
LOW, HIGH = np.full(8, -1.0), np.full(8, 1.2)


def test_pins_bounds_and_steps_hold_and_the_path_is_smoother(smoother, rng):
    for _ in range(10):
        path = np.clip(walk(rng), LOW + 0.01, HIGH - 0.01)
        found = smoother.smooth(path, PINNED, LOW, HIGH, 0.2)
        assert found.solved
        np.testing.assert_array_equal(found.path[PINNED], path[PINNED])
        assert np.all((found.path >= LOW) & (found.path <= HIGH))
        assert np.abs(np.diff(found.path, axis=0)).max() <= 0.2 + SOLVER
        assert roughness(found.path) <= roughness(path) + SOLVER


def test_a_path_of_even_steps_stays(smoother):
    path = np.linspace(0, 1, 40)[:, None] * np.linspace(-0.9, 1.1, 8)
    found = smoother.smooth(path, PINNED, LOW, HIGH, 0.2)
    np.testing.assert_allclose(found.path, path, atol=SOLVER)


def test_without_active_bounds_it_is_the_least_squares_solution(smoother, rng):
    path = 0.2 * walk(rng)
    found = smoother.smooth(path, PINNED, LOW, HIGH, 0.5)
    third = np.diff(np.eye(40), 3, axis=0)
    free, fixed = third[:, ~PINNED], third[:, PINNED]
    rows = np.concatenate([free, np.sqrt(NEAR) * np.eye(free.shape[1])])
    wanted = np.concatenate([-fixed @ path[PINNED], np.sqrt(NEAR) * path[~PINNED]])
    expected = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    np.testing.assert_allclose(found.path[~PINNED], expected, atol=1e-9)


def test_osqp_and_the_linear_system_agree_where_no_bound_is_met(rng):
    # One joint that meets its limit sends all of the path to OSQP.
    path = 0.2 * walk(rng, 40, 2)
    low, high = np.full(2, -3.0), np.full(2, 3.0)
    alone = Smoother(40, 2).smooth(path, PINNED, low, high, 0.5)
    high[1] = alone.path[~PINNED, 1].max() - 1e-3
    path[:, 1] = np.minimum(path[:, 1], high[1])
    both = Smoother(40, 2).smooth(path, PINNED, low, high, 0.5)
    assert both.solved
    np.testing.assert_allclose(both.path[:, 0], alone.path[:, 0], atol=2e-4)


def test_a_path_does_not_depend_on_the_one_before(rng):
    paths = [walk(rng, 12, 3) for _ in range(3)]
    pinned = np.isin(np.arange(12), [0, 11])
    bounds = (np.full(3, -2.0), np.full(3, 2.0), 0.3)
    used = Smoother(12, 3)
    for path in paths:
        fresh = Smoother(12, 3).smooth(path, pinned, *bounds)
        again = used.smooth(path, pinned, *bounds)
        np.testing.assert_allclose(again.path, fresh.path, atol=SOLVER)


def test_pins_that_lie_too_far_apart_give_the_path_back(rng):
    path = np.zeros((12, 3))
    path[6:] = 2.0
    pinned = np.isin(np.arange(12), [5, 6])
    found = Smoother(12, 3).smooth(path, pinned, np.full(3, -3.0), np.full(3, 3.0), 0.2)
    assert not found.solved
    np.testing.assert_array_equal(found.path, path)


def test_no_joint_is_faster_than_its_share_and_phases_take_their_least_time(rng):
    knots, least = (20, 5, 1, 14), (1.5, 0.0, 0.4, 1.0)
    paths = [walk(rng, 41, joints) for joints in (6, 8)]
    speeds = [rng.uniform(1, 3, joints) for joints in (6, 8)]
    time = knot_times(paths, speeds, knots, least, 0.5)
    assert time.shape == (41,)
    assert np.all(np.diff(time) > 0)
    for path, speed in zip(paths, speeds, strict=True):
        rate = np.abs(np.diff(path, axis=0)) / np.diff(time)[:, None]
        assert np.all(rate <= 0.5 * speed + 1e-9)
    ends = np.cumsum((0, *knots))
    assert np.all(np.diff(time[ends]) >= np.array(least) - 1e-12)
    for a, b in pairwise(ends):
        steps = np.diff(time[a : b + 1])
        np.testing.assert_allclose(steps, steps[0])


def test_a_still_path_takes_its_least_time():
    time = knot_times([np.zeros((4, 2))], [np.ones(2)], (3,), (0.6,), 0.5)
    np.testing.assert_allclose(time, [0, 0.2, 0.4, 0.6])
