"""Laws of contacts that lie a little elsewhere: circling in the closure, shifted for the selection."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from made_objects import ball_object, box_object

from bidexdata.frames import matrix_from_quat, random_quat
from bidexdata.objects.distance_field import device_field
from bidexdata.objects.distance_field_kernels import closest_surface
from bidexdata.synthesis import energies
from bidexdata.synthesis.contact_kernels import circling_centres, shifted_centres

wp.config.log_level = wp.LOG_WARNING
wp.init()
DEVICES = [d.alias for d in wp.get_devices()]

SHIFT = 0.012
PER_HAND = 5
SIDE = np.repeat([0, 1], PER_HAND)
# Float32 of positions under a metre, and of directions that are differences of such.
FLOAT32 = 3e-7
GRID = 3e-4  # m, distances on a ball of 12 cm from cells of 1 cm
SIZE = 0.4


@wp.kernel
def _lots(seed: int, out: wp.array[wp.vec3]):
    """The first three draws of each stream."""
    i = wp.tid()
    lot = wp.rand_init(seed, i)
    out[i] = wp.vec3(wp.randf(lot), wp.randf(lot), wp.randf(lot))


def lots(seed, count):
    """The same on the CPU, as float64, (count, 3): other devices must draw them too."""
    out = wp.empty(count, dtype=wp.vec3, device="cpu")
    wp.launch(_lots, dim=count, inputs=[seed], outputs=[out], device="cpu")
    return out.numpy().astype(np.float64)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def contacts(count, seed=0):
    """Points, unit normals and the hands' bases of so many grasps, some 0.1 m around, as float32."""
    rng = np.random.default_rng(seed)
    points = 0.1 * rng.standard_normal((count, 2 * PER_HAND, 3))
    normals = unit(rng.standard_normal(points.shape))
    bases = 0.3 * unit(rng.standard_normal((count, 2, 3)))
    return tuple(v.astype(np.float32) for v in (points, normals, bases))


def vectors(values, device):
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3, device=device)


def poison(shape, dtype, device):
    made = wp.empty(shape, dtype=dtype, device=device)
    made.fill_(np.nan)
    return made


def on_device(points, normals, bases, device):
    """Both hands' bases, points and normals as the kernels take them."""
    return [vectors(v, device) for v in (bases[:, 0], bases[:, 1], points, normals)]


def circling(points, normals, bases, turns, device="cpu", shift=SHIFT):
    side = wp.array(SIDE.astype(np.int32), device=device)
    out = poison(points.shape[:2], wp.vec3, device)
    given = [side, shift, turns, *on_device(points, normals, bases, device)]
    wp.launch(circling_centres, dim=out.shape, inputs=given, outputs=[out], device=device)
    return out.numpy()


def shifted(points, normals, bases, sets, device="cpu", shift=SHIFT):
    """Centres, sizes and torque lengths of all sets; grasp k has size k + 1 and length k + 0.5."""
    side = wp.array(SIDE.astype(np.int32), device=device)
    rows, order = sets * len(points), np.arange(len(points), dtype=np.float32)
    out = poison((rows, points.shape[1]), wp.vec3, device)
    size, length = poison(rows, float, device), poison(rows, float, device)
    given = [side, sets, shift, *on_device(points, normals, bases, device)]
    given += [wp.array(order + extra, dtype=float, device=device) for extra in (1.0, 0.5)]
    wp.launch(
        shifted_centres, dim=out.shape, inputs=given, outputs=[out, size, length], device=device
    )
    return out.numpy(), size.numpy(), length.numpy()


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("turns", [0.0, 0.3, -2.25])
@pytest.mark.parametrize("count", [0, 1, 7, 130])
def test_circling_contacts_equal_the_reference(device, turns, count):
    """Each finger starts at a lot, at a pace of 0.5 to 1.5 either way; the right hand turns back."""
    points, normals, bases = contacts(count)
    start, pace, way = lots(0, PER_HAND).T
    turn = start + np.where(way < 0.5, -1, 1) * (0.5 + pace) * turns
    turn = np.tile(np.concatenate([turn, -turn]), (count, 1))
    exact = [v.astype(float) for v in (points, normals, bases[:, SIDE])]
    expected = energies.beside(*exact, SHIFT, turn)
    np.testing.assert_allclose(
        circling(points, normals, bases, turns, device), expected, atol=FLOAT32
    )


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("sets", [1, 6])
@pytest.mark.parametrize("count", [0, 1, 7, 130])
def test_shifted_contacts_equal_the_reference(device, sets, count):
    """Set s moves contact i by the i-th stream of seed s, in every grasp."""
    points, normals, bases = contacts(count, seed=1)
    centres, size, length = shifted(points, normals, bases, sets, device)
    turn = np.stack([lots(s, 2 * PER_HAND)[:, 0] for s in range(sets)])
    exact = [np.repeat(v.astype(float), sets, axis=0) for v in (points, normals, bases[:, SIDE])]
    expected = energies.beside(*exact, SHIFT, np.tile(turn, (count, 1)))
    np.testing.assert_allclose(centres, expected, atol=FLOAT32)
    np.testing.assert_array_equal(size, np.repeat(np.arange(count) + 1.0, sets))
    np.testing.assert_array_equal(length, np.repeat(np.arange(count) + 0.5, sets))


@pytest.mark.parametrize("shift", [0.0, SHIFT, 0.1])
def test_contacts_move_as_far_as_they_are_told_and_along_the_surface(shift):
    given = contacts(50, seed=2)
    points, normals, _ = given
    for moved in (
        circling(*given, 0.7, shift=shift),
        shifted(*given, 4, shift=shift)[0].reshape(50, 4, -1, 3)[:, 2],
    ):
        way = moved.astype(float) - points
        np.testing.assert_allclose(np.linalg.norm(way, axis=-1), shift, atol=FLOAT32)
        np.testing.assert_allclose(np.sum(way * normals, axis=-1), 0, atol=FLOAT32)


def test_every_finger_goes_round_at_a_pace_of_its_own():
    points, normals, bases = contacts(3, seed=3)
    step = 0.02
    ways = [circling(points, normals, bases, t).astype(float) - points for t in (0.0, step)]
    cosine = np.sum(ways[0] * ways[1], axis=-1) / SHIFT**2
    sine = np.sum(np.cross(ways[0], ways[1]) * normals, axis=-1) / SHIFT**2
    pace = np.arctan2(sine, cosine) / (2 * np.pi * step)
    np.testing.assert_allclose(pace, np.tile(pace[0], (3, 1)), atol=1e-4)
    np.testing.assert_allclose(pace[0, :PER_HAND], -pace[0, PER_HAND:], atol=1e-4)
    assert np.all((np.abs(pace) > 0.5) & (np.abs(pace) < 1.5))
    assert np.min(np.diff(np.sort(pace[0, :PER_HAND]))) > 1e-3


def test_mirrored_hands_have_mirrored_circles():
    points, normals, bases = contacts(4, seed=4)
    mirror = np.array([-1, 1, 1], np.float32)
    swapped = np.argsort(np.roll(SIDE, PER_HAND), kind="stable")
    one = circling(points, normals, bases, 0.4)
    other = circling(
        points[:, swapped] * mirror, normals[:, swapped] * mirror, bases[:, ::-1] * mirror, 0.4
    )
    np.testing.assert_allclose(other[:, swapped] * mirror, one, atol=FLOAT32)


def test_turned_grasps_have_turned_contacts():
    points, normals, bases = contacts(4, seed=5)
    R = matrix_from_quat(random_quat(np.random.default_rng(6))).astype(np.float32)
    turned = [v @ R.T for v in (points, normals, bases)]
    pairs = [
        (circling(points, normals, bases, 1.3), circling(*turned, 1.3)),
        (shifted(points, normals, bases, 3)[0], shifted(*turned, 3)[0]),
    ]
    for one, other in pairs:
        np.testing.assert_allclose(other, one @ R.T, atol=3 * FLOAT32)


def test_a_contact_on_the_line_of_its_normal_through_the_base_stays():
    """There turns begin nowhere; no number may come of it that is none."""
    points = np.zeros((1, 2 * PER_HAND, 3), np.float32)
    normals = np.tile(np.float32([0, 0, -1]), (1, 2 * PER_HAND, 1))
    bases = np.tile(np.float32([0, 0, 0.3]), (1, 2, 1))
    np.testing.assert_array_equal(circling(points, normals, bases, 0.3), points)
    np.testing.assert_array_equal(shifted(points, normals, bases, 1)[0], points)
    turn = np.full((1, 2 * PER_HAND), 0.2)
    exact = [v.astype(float) for v in (points, normals, bases[:, SIDE])]
    np.testing.assert_array_equal(energies.beside(*exact, SHIFT, turn), points)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("body", ["box", "ball"])
def test_moved_contacts_come_to_lie_on_the_surface_by_the_shift_along_it(device, body):
    """On a face they are there at once; on a ball the arc is that whose tangent is the shift."""
    rng, count = np.random.default_rng(7), 20
    bases = 0.5 * unit(rng.standard_normal((count, 2, 3)))
    if body == "box":
        obj = box_object()
        half = SIZE * np.ptp(obj.solid.vertices, axis=0) / 2
        # Far enough from the edges that the contacts stay on their face.
        points = rng.uniform(-0.5, 0.5, (count, 2 * PER_HAND, 3)) * half
        points[..., 0] = half[0]
        normals = np.tile([-1.0, 0, 0], (count, 2 * PER_HAND, 1))
    else:
        obj = ball_object()
        radius = SIZE * 0.5 / np.sqrt(3)
        normals = -unit(rng.standard_normal((count, 2 * PER_HAND, 3)))
        points = -radius * normals
    centres = shifted(points, normals, bases, 2, device)[0]
    shape, field = centres.shape[:2], device_field(obj.sdf, device)
    size = wp.full(shape[0], SIZE, dtype=float, device=device)
    distance = poison(shape, float, device)
    slope, place, inward = (poison(shape, wp.vec3, device) for _ in range(3))
    given = [field, size, 0.008, vectors(centres, device)]
    wp.launch(
        closest_surface,
        dim=shape,
        inputs=given,
        outputs=[distance, slope, place, inward],
        device=device,
    )
    found, start = place.numpy().astype(float), np.repeat(points, 2, axis=0)
    if body == "box":
        np.testing.assert_allclose(distance.numpy(), 0, atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(found - start, axis=-1), SHIFT, atol=1e-6)
    else:
        lifted = np.hypot(radius, SHIFT) - radius
        np.testing.assert_allclose(distance.numpy(), lifted, atol=GRID)
        np.testing.assert_allclose(np.linalg.norm(found, axis=-1), radius, atol=GRID)
        cosine = np.sum(unit(found) * unit(start), axis=-1)
        np.testing.assert_allclose(np.tan(np.arccos(cosine)) * radius, SHIFT, atol=2 * GRID)
