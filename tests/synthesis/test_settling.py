"""Laws of the quasi-static closing: balance, friction, symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from made_objects import ball_object, box_object

from bidexdata.errors import BadConfig
from bidexdata.synthesis.distance_field import device_field
from bidexdata.synthesis.settling import (
    LEAST_PRESSED,
    SettlingConfig,
    settled_contacts,
)

SIZE = 0.3
RADIUS = 0.008
BOX = np.array([1.0, 0.8, 0.6]) / np.linalg.norm([1.0, 0.8, 0.6]) * SIZE
BALL = 0.5 / np.sqrt(3) * SIZE
LONG = SettlingConfig(pressing_moves=20, waiting_moves=60, repeats=4)
GRID = 2e-3  # m, what trilinear distances are off by next to an edge or on a ball


@pytest.fixture(scope="module")
def box():
    return device_field(box_object().sdf)


@pytest.fixture(scope="module")
def ball():
    return device_field(ball_object().sdf)


def pads(at, inward, depth):
    """Spheres that start 15 mm off the surface points `at`, touch them, and aim `depth` inside."""
    at, inward = np.asarray(at, float), np.asarray(inward, float)
    off = np.array([-0.015, 0.0, depth])[:, None, None]
    return (at + (off - RADIUS) * inward)[None]


def close(field, centres, side, config=LONG):
    size = np.full(len(centres), SIZE)
    return settled_contacts(field, centres, side, np.full(len(side), RADIUS), size, config)


X = np.eye(3)[0]
HALF = BOX[0] / 2


def opposed(depth, dy=0.0):
    """One pad of each hand on the box's faces across x, `dy` apart along y."""
    at = [[-HALF, -dy / 2, 0], [HALF, dy / 2, 0]]
    return pads(at, [X, -X], depth)


@pytest.mark.parametrize("depth", [0.004, 0.01])
def test_two_opposed_pads_press_by_what_they_aim_inside(box, depth):
    """Wherever the object lies at first, the springs balance when both are as deep."""
    found = close(box, opposed(depth), np.array([0, 1]))
    np.testing.assert_allclose(found.pressed, depth, rtol=0.02)
    assert found.touching == 2
    assert found.turned < 0.02


def test_a_hand_alone_pushes_the_object_away(box):
    found = close(box, opposed(0.01)[:, :, :1], np.array([0]))
    np.testing.assert_allclose(found.pressed, LEAST_PRESSED)


def test_pads_that_miss_leave_the_object_where_it_is(box):
    found = close(box, pads([[0.4, 0, 0], [-0.4, 0, 0]], [X, -X], 0.01), np.array([0, 1]))
    np.testing.assert_allclose([*found.pressed, *found.touching], [LEAST_PRESSED, 0])
    np.testing.assert_allclose(found.turned, 0, atol=1e-3)


def test_pushes_that_do_not_meet_turn_the_object_into_their_friction_cones(box):
    """Pads dy apart press along a line atan(dy / width) off the normals: it must come within atan 0.3."""
    turns = [close(box, opposed(0.01, dy), np.array([0, 1])).turned[0] for dy in (0.0, 0.04, 0.08)]
    assert turns[0] < turns[1] < turns[2]
    least = np.arctan(0.08 / BOX[0]) - np.arctan(LONG.friction)
    assert least < turns[2] < least + 0.06


@pytest.mark.parametrize(("friction", "holds"), [(0.2, False), (0.6, True)])
def test_friction_decides_whether_a_ball_slips_out(ball, friction, holds):
    """Pads 0.3 rad above the middle of a ball, pressing along x: it stays where tan 0.3 < friction."""
    up = 0.3
    at = BALL * np.array([[-np.cos(up), 0, np.sin(up)], [np.cos(up), 0, np.sin(up)]])
    touch = at * (1 + RADIUS / BALL)
    ways = np.array([-0.015, 0.0, 0.012])[:, None, None]
    centres = (touch + ways * np.array([X, -X]))[None]
    config = SettlingConfig(
        friction=friction, aside=0.0, pressing_moves=40, waiting_moves=400, repeats=4
    )
    found = close(ball, centres, np.array([0, 1]), config)
    assert (found.pressed[0] > 0.005) == holds


def test_swapping_the_hands_changes_nothing(box):
    rng = np.random.default_rng(0)
    centres = pads(
        [[-HALF, 0.02, 0.01], [-HALF, -0.02, 0], [HALF, 0.01, 0.01], [HALF, -0.02, -0.01]],
        [X, X, -X, -X],
        0.008,
    ) + rng.normal(0, 1e-3, (1, 1, 4, 3))
    one = close(box, centres, np.array([0, 0, 1, 1]))
    other = close(box, centres[:, :, [2, 3, 0, 1]], np.array([0, 0, 1, 1]))
    np.testing.assert_allclose(np.ravel(one), np.ravel(other), rtol=1e-3)


def test_half_turns_change_nothing(box):
    """They map the box to itself, and the places that the object starts from."""
    centres = pads([[-HALF, 0.02, 0.01], [HALF, -0.01, 0.0]], [X, -X], 0.008)
    one = close(box, centres, np.array([0, 1]))
    for axis in range(3):
        sign = -np.ones(3)
        sign[axis] = 1
        other = close(box, centres * sign, np.array([0, 1]))
        np.testing.assert_allclose(np.ravel(one), np.ravel(other), rtol=2e-3)


def test_a_row_that_is_not_finite_is_nan_and_the_others_are_what_they_are_alone(box):
    three = np.concatenate([opposed(0.004), opposed(0.004), opposed(0.01, 0.03)])
    three[0, 1, 0, 0] = np.nan
    found = np.array(close(box, three, np.array([0, 1])))
    assert np.isnan(found[:, 0]).all()
    for row in (1, 2):
        alone = close(box, three[row : row + 1], np.array([0, 1]))
        np.testing.assert_array_equal(found[:, row], np.ravel(alone))


def test_no_row_is_no_result(box):
    found = close(box, np.zeros((0, 3, 2, 3)), np.array([0, 1]))
    assert np.shape(found) == (3, 0)


@pytest.mark.parametrize("wrong", [{"stride": 0.0}, {"repeats": 0}, {"friction": -1.0}])
def test_impossible_numbers_are_refused(wrong):
    with pytest.raises(BadConfig, match=f"SettlingConfig.{next(iter(wrong))}"):
        SettlingConfig(**wrong)
