"""Laws of the quasi-static closing: its float64 reference, balance, friction, symmetry."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
import warp as wp
from made_objects import ball_object, box_object
from settling_reference import rested

from bidexdata.errors import BadConfig
from bidexdata.objects.distance_field import device_field
from bidexdata.synthesis.settling import (
    CORNERS,
    LEAST_PRESSED,
    SettlingConfig,
    settled_contacts,
)
from bidexdata.synthesis.settling_kernels import settle

wp.config.log_level = wp.LOG_WARNING
wp.init()
DEVICES = [d.alias for d in wp.get_devices()]

OBJECTS = {"box": box_object(), "ball": ball_object()}
SIZE = 0.3
RADIUS = 0.008
BOX = np.array([1.0, 0.8, 0.6]) / np.linalg.norm([1.0, 0.8, 0.6]) * SIZE
BALL = 0.5 / np.sqrt(3) * SIZE
X = np.eye(3)[0]
HALF = BOX[0] / 2
SIDE = np.repeat([0, 1], 3)
LONG = SettlingConfig(pressing_moves=20, waiting_moves=60, repeats=4)
# Float32 of some tens of centimetres and of an arc cosine near one; the steps damp what they add.
LENGTHS, ANGLES = 2e-6, 1e-3


class Placed(NamedTuple):
    """A distance field, and the device that it lies on."""

    field: Any
    device: str


@pytest.fixture(scope="module", params=DEVICES)
def device(request):
    return request.param


@pytest.fixture(scope="module")
def box(device):
    return Placed(device_field(OBJECTS["box"].sdf, device), device)


@pytest.fixture(scope="module")
def ball(device):
    return Placed(device_field(OBJECTS["ball"].sdf, device), device)


def pads(at, inward, depth):
    """Spheres that start 15 mm off the surface points `at`, touch them, and aim `depth` inside."""
    at, inward = np.asarray(at, float), np.asarray(inward, float)
    off = np.array([-0.015, 0.0, depth])[:, None, None]
    return (at + (off - RADIUS) * inward)[None]


def close(on, centres, side, config=LONG):
    size, radius = np.full(len(centres), SIZE), np.full(len(side), RADIUS)
    return settled_contacts(on.field, centres, side, radius, size, config, on.device)


def squeezed(name, count, seed=0):
    """Sizes, and three spheres of each hand on both sides of an object; some aim short of it."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.25, 0.4, count)
    if name == "box":
        half = BOX / SIZE / 2 * size[:, None, None]
        at = rng.uniform(-0.6, 0.6, (count, 6, 3)) * half
        at[..., 0] = np.repeat([-1, 1], 3) * half[..., 0]
        inward = np.repeat([X, -X], 3, axis=0)
    else:
        inward = np.repeat([X, -X], 3, axis=0) + rng.normal(0, 0.4, (count, 6, 3))
        inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
        at = -BALL / SIZE * size[:, None, None] * inward
    ways = rng.uniform([-0.02, -0.002, -0.01], [-0.005, 0.002, 0.02], (count, 6, 3))
    ways = np.moveaxis(ways, 2, 1)[..., None]
    aimed = inward + rng.normal(0, 0.2, at.shape)
    touching = at - RADIUS * inward
    return size, touching[:, None] + ways * aimed[:, None]


def settled_by_kernel(name, size, centres, side, radius, config, device):
    """What the kernel alone writes, over NaN: pressed (N, S, 2), touching and turned (N, S)."""
    dim = (len(size), len(CORNERS))

    def given(values, dtype):
        kind = np.int32 if dtype is int else np.float32
        return wp.array(np.ascontiguousarray(values, kind), dtype=dtype, device=device)

    def poison(dtype, *more):
        made = wp.empty((*dim, *more), dtype=dtype, device=device)
        made.fill_(np.nan)
        return made

    kept = [poison(wp.vec3, len(radius)), poison(wp.vec4, len(radius))]
    found = [poison(wp.vec2), poison(float), poison(float)]
    counts = (config.closing_moves, config.pressing_moves, config.waiting_moves, config.repeats)
    inputs = [device_field(OBJECTS[name].sdf, device), given(size, float)]
    inputs += [given(CORNERS * config.aside, wp.vec3), given(side, int), given(radius, float)]
    inputs += [config.friction, *counts, config.stride, given(centres, wp.vec3)]
    wp.launch(settle, dim=dim, inputs=inputs, outputs=[*kept, *found], device=device)
    return [out.numpy() for out in found]


def assert_as_the_reference(name, size, centres, radius, config, device):
    """Where the end does not hang on a threshold that inputs a rounding error apart fall about."""
    found = settled_by_kernel(name, size, centres, SIDE, radius, config, device)
    model = (OBJECTS[name].sdf, size, CORNERS * config.aside)
    expected = rested(*model, centres, SIDE, radius, config)
    steady, rng = np.ones(found[1].shape, bool), np.random.default_rng(0)
    for _ in range(4):
        near = rested(*model, centres + rng.normal(0, 1e-7, centres.shape), SIDE, radius, config)
        steady &= np.abs(near.pressed - expected.pressed).max(axis=-1, initial=0) < LENGTHS
        steady &= near.touching == expected.touching
    assert steady.sum() >= 0.9 * steady.size
    np.testing.assert_allclose(found[0][steady], expected.pressed[steady], atol=LENGTHS)
    # Where the object gives way to a hand alone, what still presses is lost in rounding.
    held = steady & (expected.pressed.max(axis=-1, initial=0) > LENGTHS)
    np.testing.assert_array_equal(found[1][held], expected.touching[held])
    np.testing.assert_allclose(found[2][steady], expected.turned[steady], atol=ANGLES)
    assert all(np.isfinite(out).all() for out in found)
    return expected


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("count", [0, 1, 7, 70])
def test_the_kernel_closes_as_the_reference_does(name, count, device):
    """Pads that slide, stick, miss, let go and push the object away, on a flat and a round one."""
    radius = np.linspace(0.006, 0.010, 6)
    size, centres = squeezed(name, count)
    ends = assert_as_the_reference(name, size, centres, radius, SettlingConfig(), device)
    if count == 70:
        assert set(np.unique(ends.touching)) >= {2, 3, 4, 5, 6}
        assert np.median(ends.turned) > 0.01


@pytest.mark.parametrize(
    "change",
    [{"friction": 0.0}, {"friction": 1.0}, {"stride": 0.001}, {"repeats": 5}, {"aside": 0.0}],
    ids=lambda change: next(iter(change)),
)
def test_every_setting_means_to_the_kernel_what_it_means_to_the_reference(change, device):
    size, centres = squeezed("box", 20, seed=1)
    config = SettlingConfig(closing_moves=3, **change)
    assert_as_the_reference("box", size, centres, np.full(6, RADIUS), config, device)


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
