"""Laws of the energy terms: gradient = central difference, kernels = reference."""

from dataclasses import replace

import numpy as np
import pytest

from bidexdata.hands import load_hands
from bidexdata.hands.device import device_hand
from bidexdata.hands.kinematics import hand_points
from bidexdata.objects.distance_field import device_field, signed_distance, surface_normal
from bidexdata.objects.prepared import SignedDistanceGrid
from bidexdata.synthesis import energies

wp = pytest.importorskip("warp")

FD_TOLERANCE = 1e-6  # float64, step 1e-6, energies of order one
F32_TOLERANCE = 2e-5  # float32 against float64, relative to the largest entry
SLOPE_TOLERANCE = 0.02  # slopes jump between cells, and float32 may choose the neighbour
CURVATURE_TOLERANCE = 0.03  # of the normals of a ball of 12 cm on cells of 5 mm; less on finer ones
SIZE = 0.4
RADIUS = 0.3  # of the unit-size ball
rng = np.random.default_rng(8)


wp.config.log_level = wp.LOG_WARNING
wp.init()


@pytest.fixture(autouse=True, params=[d.alias for d in wp.get_devices()])
def device(request):
    """Every law on every device; arrays and launches must not meet on two."""
    with wp.ScopedDevice(request.param):
        yield request.param


def ball_grid(cells=64, radius=RADIUS):
    """Exact distances of a ball around the origin, unit diagonal."""
    axis = np.linspace(-0.6, 0.6, cells + 1)
    x = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    values = (np.linalg.norm(x, axis=-1) - radius).astype(np.float32)
    return SignedDistanceGrid(values=values, origin=np.full(3, -0.6), cell=1.2 / cells)


def slab_grid():
    """Exact distances of the half space x < 0.2, which trilinear interpolation reproduces."""
    axis = np.linspace(-0.6, 0.6, 33)
    x = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    values = (x[..., 0] - 0.2).astype(np.float32)
    return SignedDistanceGrid(values=values, origin=np.full(3, -0.6), cell=1.2 / 32)


def difference(f, x, direction, step=1e-6):
    return (f(x + step * direction) - f(x - step * direction)) / (2 * step)


def assert_gradient(f, gradient, x):
    """The directional derivative of f at x is the gradient's, in five random directions."""
    for _ in range(5):
        direction = rng.standard_normal(x.shape)
        exact = np.sum(gradient * direction)
        np.testing.assert_allclose(difference(f, x, direction), exact, rtol=1e-5, atol=FD_TOLERANCE)


def launch(kernel, dim, inputs, outputs):
    wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs)


def field_of(grid):
    return device_field(grid, str(wp.get_device()))


def vectors(x):
    return wp.array(np.ascontiguousarray(x, np.float32), dtype=wp.vec3)


def floats(x):
    return wp.array(np.asarray(x, np.float32), dtype=float)


def poison(shape, dtype=float):
    a = wp.empty(shape, dtype=dtype)
    a.fill_(np.nan)
    return a


def assert_close(kernel_out, reference, tolerance=F32_TOLERANCE):
    reference = np.asarray(reference)
    scale = max(float(np.max(np.abs(reference), initial=0.0)), 1e-6)
    np.testing.assert_allclose(kernel_out.numpy(), reference, atol=tolerance * scale, rtol=0)


@pytest.mark.parametrize("a", [0.01, 0.06])
def test_the_region_penalty_is_continuously_differentiable(a):
    d = np.linspace(0, 3 * a, 3001)
    phi, slope = energies.region_penalty(d, a)
    assert np.all(phi[d <= a] == 0)
    np.testing.assert_allclose(phi[d >= 2 * a], d[d >= 2 * a] - a)
    h = 1e-7
    numeric = (energies.region_penalty(d + h, a)[0] - energies.region_penalty(d - h, a)[0]) / (
        2 * h
    )
    np.testing.assert_allclose(numeric, slope, atol=1e-4)
    # No jump of value or slope at the two seams.
    for seam in (a, 2 * a):
        left, right = (energies.region_penalty(np.array([seam + s]), a) for s in (-1e-9, 1e-9))
        np.testing.assert_allclose(left, right, atol=1e-6)


def test_the_region_penalty_has_the_papers_values():
    # By hand: a = 1, b = 2; at d = 1.5 the blend H(1/2) = 1/2 gives 1/4; at b it gives a.
    phi, slope = energies.region_penalty(np.array([0.5, 1.0, 1.5, 2.0, 3.0]), 1.0)
    np.testing.assert_allclose(phi, [0, 0, 0.25, 1, 2])
    np.testing.assert_allclose(slope, [0, 0, 1.25, 1, 1])


def test_region_gradient_is_the_central_difference():
    region = rng.uniform(-0.1, 0.1, (9, 3))
    x = rng.uniform(-0.3, 0.3, (6, 3))
    term = energies.region_energy(x, region, 0.06)
    assert_gradient(lambda y: energies.region_energy(y, region, 0.06).energy, term.gradient, x)


def test_a_pad_that_touches_its_region_costs_nothing_however_thick_the_finger():
    """E_dis and E_region take the same point of the finger: both are zero where it touches."""
    from bidexdata.synthesis import contact_kernels as k

    radius = np.array([0.002, 0.008, 0.05])
    points = rng.uniform(-0.1, 0.1, (1, 3, 3))
    normals = rng.standard_normal((1, 3, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    centres = points - radius[:, None] * normals
    np.testing.assert_allclose(energies.contact_points(centres, normals, radius), points)
    assert energies.target_energy(centres, points, normals, radius, 0.0).energy < 1e-20
    e, out = poison((1, 3)), vectors(np.zeros((1, 3, 3)))
    args = [wp.zeros(3, dtype=int), floats(radius), 1.0, 0.001]
    args += [vectors(np.tile(points[:, None], (1, 2, 1, 1))), vectors(centres), vectors(normals)]
    launch(k.contact_region, (1, 3), args, [e, out, vectors(np.zeros((1, 3, 3)))])
    assert not e.numpy().any()
    assert not out.numpy().any()


def test_target_gradient_is_the_central_difference():
    points, normals = rng.standard_normal((2, 5, 3))
    radius = rng.uniform(0.005, 0.01, 5)
    x = rng.standard_normal((5, 3))

    def f(y):
        return energies.target_energy(y, points, normals, radius, 0.01)

    assert_gradient(lambda y: f(y).energy, f(x).gradient, x)


def test_pad_gradients_are_the_central_differences():
    pads, normals = rng.standard_normal((2, 7, 3))
    term = energies.pad_energy(pads, normals, 0.75)
    assert term.energy > 0
    assert_gradient(lambda y: energies.pad_energy(y, normals, 0.75).energy, term.pad_gradient, pads)
    assert_gradient(
        lambda y: energies.pad_energy(pads, y, 0.75).energy, term.normal_gradient, normals
    )


def test_distance_and_depth_gradients_are_the_central_differences():
    grid = ball_grid()
    radius = rng.uniform(0.005, 0.01, 20)
    # Inside the grid, on both sides of the surface at 0.12 m, away from the faces of cells.
    x = rng.standard_normal((20, 3))
    x *= (rng.uniform(0.10, 0.15, 20) / np.linalg.norm(x, axis=1))[:, None]
    cell = SIZE * grid.cell
    x = (np.floor(x / cell) + np.clip(x / cell - np.floor(x / cell), 0.01, 0.99)) * cell

    def distance(y):
        return energies.distance_energy(*signed_distance(grid, SIZE, y), radius, 0.01)

    def depth(y):
        return energies.sphere_object_energy(*signed_distance(grid, SIZE, y), radius, 0.01)

    for term in (distance, depth):
        assert term(x).energy > 0
        # Interpolation is only piecewise smooth: a short step stays within a cell.
        for _ in range(5):
            direction = rng.standard_normal(x.shape)
            numeric = difference(lambda y, t=term: t(y).energy, x, direction)
            np.testing.assert_allclose(numeric, np.sum(term(x).gradient * direction), rtol=1e-5)


def test_plane_gradient_is_the_central_difference():
    plane = np.array([0.6, 0.0, 0.8, 0.05])
    radius = np.full(8, 0.02)
    x = rng.uniform(-0.1, 0.0, (8, 3))

    def f(y):
        return energies.sphere_plane_energy(y, plane, radius, 0.002)

    assert f(x).energy > 0
    assert_gradient(lambda y: f(y).energy, f(x).gradient, x)


def test_pair_gradient_is_the_central_difference():
    pairs = np.array([(a, b) for a in range(6) for b in range(a)])
    radius = rng.uniform(0.05, 0.1, 6)
    x = rng.uniform(-0.1, 0.1, (6, 3))

    def f(y):
        return energies.pair_energy(y, pairs, radius, 0.002)

    assert f(x).energy > 0
    assert_gradient(lambda y: f(y).energy, f(x).gradient, x)


@pytest.mark.parametrize("count", [1, 7])
def test_field_kernels_equal_the_reference(count):
    from bidexdata.objects import distance_field_kernels as k

    grid = ball_grid()
    size = rng.uniform(0.3, 0.8, count)
    x = rng.uniform(-0.6, 0.6, (count, 33, 3)) * size[:, None, None]
    x[:, -3:] *= 1.6  # beyond the grid
    d, g = poison((count, 33)), poison((count, 33), wp.vec3)
    p, n = poison((count, 33), wp.vec3), poison((count, 33), wp.vec3)
    field = field_of(grid)
    launch(k.closest_surface, (count, 33), [field, floats(size), 0.008, vectors(x)], [d, g, p, n])
    reference = [signed_distance(grid, s, row) for s, row in zip(size, x, strict=True)]
    assert_close(d, [r[0] for r in reference])
    assert_close(g, [r[1] for r in reference], SLOPE_TOLERANCE)
    near = x * (size[:, None] * (RADIUS + 0.02) / np.linalg.norm(x, axis=-1))[..., None]
    launch(
        k.closest_surface, (count, 33), [field, floats(size), 0.008, vectors(near)], [d, g, p, n]
    )
    # A ball's closest point and inward normal are known by hand; the grid is coarse.
    unit = near / np.linalg.norm(near, axis=-1, keepdims=True)
    np.testing.assert_allclose(p.numpy(), unit * size[:, None, None] * RADIUS, atol=2e-3)
    np.testing.assert_allclose(n.numpy(), -unit, atol=0.03)
    normals = [surface_normal(grid, s, q, 0.008) for s, q in zip(size, p.numpy(), strict=True)]
    np.testing.assert_allclose(n.numpy(), -np.array(normals), atol=2e-4)


def test_the_distance_is_continuous_across_the_grids_border():
    grid = ball_grid()
    edge = np.array([0.6, 0.1, -0.2])
    inside, outside = (signed_distance(grid, 1.0, edge * s)[0] for s in (1 - 1e-7, 1 + 1e-7))
    np.testing.assert_allclose(inside, outside, atol=1e-5)


def test_surface_chain_turns_normals_as_a_ball_does():
    """On a ball of radius R the normal turns by t / R: H g = tangential g / R, negative inward."""
    from bidexdata.objects import distance_field_kernels as k

    grid = ball_grid(cells=96)
    unit = rng.standard_normal((4, 10, 3))
    unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
    p = SIZE * RADIUS * unit
    gp, gn, start = rng.standard_normal((3, 4, 10, 3))
    none = np.zeros((4, 10, 3))

    def added(by_point, by_normal):
        out = vectors(start)
        args = [field_of(grid), floats(np.full(4, SIZE)), 0.008, vectors(p), vectors(-unit)]
        launch(k.surface_chain, (4, 10), [*args, vectors(by_point), vectors(by_normal)], [out])
        return out.numpy() - start

    def tangential(v):
        return v - np.sum(v * unit, axis=-1, keepdims=True) * unit

    np.testing.assert_allclose(added(gp, none), tangential(gp), atol=F32_TOLERANCE)
    turned = -tangential(gn) / (SIZE * RADIUS)
    error = np.linalg.norm(added(none, gn) - turned, axis=-1) / np.linalg.norm(turned, axis=-1)
    assert error.max() < CURVATURE_TOLERANCE


def test_the_region_gradient_on_a_ball_is_the_central_difference():
    """The point that faces the ball moves less than the centre: by 1 - r / |c| along the ball."""
    from bidexdata.objects import distance_field_kernels as k
    from bidexdata.synthesis.contact_kernels import contact_region

    shape, r, a = (8, 5), np.full(5, 0.012), 0.02
    centres = rng.standard_normal((*shape, 3))
    centres *= (SIZE * RADIUS + r[0]) / np.linalg.norm(centres, axis=-1, keepdims=True)
    region = rng.uniform(-0.1, 0.1, (8, 1, 6, 3))

    def energy(c):
        inward = -c / np.linalg.norm(c, axis=-1, keepdims=True)
        at = energies.contact_points(c, inward, r)
        return sum(
            energies.region_energy(x, R[0], a).energy for x, R in zip(at, region, strict=True)
        )

    d, e = poison(shape), poison(shape)
    slope, p, n = (poison(shape, wp.vec3) for _ in range(3))
    g, gn = (vectors(np.zeros((*shape, 3))) for _ in range(2))
    on = [field_of(ball_grid(cells=96)), floats(np.full(8, SIZE)), 0.008]
    launch(k.closest_surface, shape, [*on, vectors(centres)], [d, slope, p, n])
    args = [wp.zeros(5, dtype=int), floats(r), 1.0, a, vectors(region), vectors(centres), n]
    launch(contact_region, shape, args, [e, g, gn])
    launch(k.surface_chain, shape, [*on, p, n, vectors(np.zeros((*shape, 3))), gn], [g])
    numeric = np.zeros(centres.shape)
    for at in np.ndindex(centres.shape):
        one = np.zeros(centres.shape)
        one[at] = 1.0
        numeric[at] = difference(energy, centres, one)
    error = np.linalg.norm(g.numpy() - numeric) / np.linalg.norm(numeric)
    # The chain neglects the way from the centre to the surface: r / R for r / (R + r).
    assert error < 0.02


def test_surface_chain_on_a_plane_is_the_tangential_projection():
    from bidexdata.objects import distance_field_kernels as k

    p = np.concatenate([np.full((3, 5, 1), 0.2), rng.uniform(-0.2, 0.2, (3, 5, 2))], axis=-1)
    gp, gn = rng.standard_normal((2, 3, 5, 3))
    out = vectors(np.zeros((3, 5, 3)))
    inward = vectors(np.broadcast_to([-1.0, 0, 0], (3, 5, 3)))
    args = [field_of(slab_grid()), floats(np.ones(3)), 0.008, vectors(p), inward]
    launch(k.surface_chain, (3, 5), [*args, vectors(gp), vectors(gn)], [out])
    np.testing.assert_allclose(out.numpy(), gp * [0, 1, 1], atol=1e-3)


def test_contact_kernels_equal_the_reference():
    from bidexdata.synthesis import contact_kernels as k

    N, M = 5, 10
    c, p, n, g, pads = rng.uniform(-0.2, 0.2, (5, N, M, 3))
    d = rng.uniform(-0.02, 0.05, (N, M))
    radius = rng.uniform(0.005, 0.01, M)
    region = rng.uniform(-0.2, 0.2, (N, 2, 7, 3))
    side = np.repeat([0, 1], 5)
    e, out = poison((N, M)), poison((N, M), wp.vec3)

    launch(k.contact_distance, (N, M), [floats(radius), 3.0, 0.01, floats(d), vectors(g)], [e, out])
    term = energies.distance_energy(d, g, radius, 0.01)
    assert_close(out, 3 * term.gradient)
    np.testing.assert_allclose(e.numpy().sum(1), term.energy, rtol=1e-4)

    args = [floats(radius), 3.0, 0.01, vectors(c), vectors(p), vectors(n)]
    launch(k.contact_target, (N, M), args, [e, out])
    term = energies.target_energy(c, p, n, radius, 0.01)
    assert_close(out, 3 * term.gradient)
    np.testing.assert_allclose(e.numpy().sum(1), term.energy, rtol=1e-4)

    out, turned = vectors(g), vectors(p)
    args = [wp.array(side, dtype=int), floats(radius), 3.0, 0.06, vectors(region), vectors(c)]
    launch(k.contact_region, (N, M), [*args, vectors(n)], [e, out, turned])
    at = energies.contact_points(c, n, radius)
    for h in range(2):
        own = side == h
        term = energies.region_energy(at[:, own], region[:, h], 0.06)
        push = 3 * term.gradient
        np.testing.assert_allclose(out.numpy()[:, own], g[:, own] + push, atol=1e-4)
        by_normal = p[:, own] + radius[own, None] * push
        np.testing.assert_allclose(turned.numpy()[:, own], by_normal, atol=1e-6)
        np.testing.assert_allclose(e.numpy()[:, own].sum(1), term.energy, atol=1e-5)

    gn, out = vectors(g), poison((N, M), wp.vec3)
    launch(k.contact_pad, (N, M), [3.0, 0.02, vectors(pads), vectors(n)], [e, out, gn])
    term = energies.pad_energy(pads, n, 0.02)
    assert_close(out, 3 * term.pad_gradient)
    assert_close(gn, g + 3 * term.normal_gradient)


def test_sphere_kernels_equal_the_reference():
    from bidexdata.synthesis import sphere_kernels as k

    grid, N, K = ball_grid(), 3, 17
    size = np.array([0.3, 0.4, 0.8])
    x = rng.standard_normal((N, K, 3))
    x *= (size[:, None] * rng.uniform(0.2, 0.4, (N, K)) / np.linalg.norm(x, axis=-1))[..., None]
    radius = rng.uniform(0.005, 0.02, K)
    e, out = poison((N, K)), poison((N, K), wp.vec3)
    measured = wp.zeros((N, K), dtype=wp.vec4)
    args = [floats(radius), field_of(grid), floats(size), 3.0, 0.001, vectors(x)]
    launch(k.sphere_object, N, args, [measured, e, out])
    terms = [
        energies.sphere_object_energy(*signed_distance(grid, s, row), radius, 0.001)
        for s, row in zip(size, x, strict=True)
    ]
    assert_close(out, 3 * np.array([t.gradient for t in terms]), SLOPE_TOLERANCE)
    np.testing.assert_allclose(e.numpy().sum(1), [t.energy for t in terms], rtol=1e-3)

    before, energy = out.numpy().copy(), e.numpy().copy()
    plane = np.array([[0, 0, 1, 0.05], [0, 0.6, 0.8, 0.01], [0, 0, 0, 0]])
    args = [floats(radius), wp.array(plane.astype(np.float32), dtype=wp.vec4), 3.0, 0.002]
    launch(k.sphere_plane, N, [*args, vectors(x)], [e, out])
    term = energies.sphere_plane_energy(x[:2], plane[:2], radius, 0.002)
    np.testing.assert_allclose(out.numpy()[:2] - before[:2], 3 * term.gradient, atol=1e-4)
    assert np.array_equal(out.numpy()[2], before[2])
    np.testing.assert_allclose((e.numpy() - energy)[:2].sum(1), term.energy, rtol=1e-3)


def every_pair(hand):
    """The hand with every pair of its spheres listed, those of one body and of neighbours too."""
    count = len(hand.sphere_body)
    pairs = np.array([(a, b) for a in range(count) for b in range(a)], np.int32)
    return replace(hand, self_pairs=pairs)


@pytest.fixture(params=["capsule", "shadow", "no pairs"])
def hand(request):
    if request.param == "shadow":
        request.getfixturevalue("menagerie")
    if request.param == "no pairs":
        return replace(load_hands("capsule")[0], self_pairs=np.zeros((0, 2), np.int32))
    return load_hands(request.param)[0]


def postures(hand, count):
    """Sphere centres of postures of which half are far outside the limits, so that much overlaps."""
    low, high = hand.joint_lower, hand.joint_upper
    joints = rng.uniform(low, high, (count, len(low)))
    joints[::2] += rng.normal(0, 1.0, joints[::2].shape)
    return hand_points(hand, joints).sphere


def test_self_overlaps_of_a_hand_equal_the_reference(hand):
    """For each hand, its pairs, and every pair of its spheres, in postures that overlap too."""
    from bidexdata.synthesis import sphere_kernels as k

    N = 9
    for listed in (hand, every_pair(hand)):
        x, dev = postures(hand, N), device_hand(listed, str(wp.get_device()))
        start = rng.standard_normal(x.shape)
        e, out = poison(N), vectors(start)
        args = [dev.sphere_radius, dev.self_pairs, dev.pair_groups, dev.group_reach, 3.0, 0.002]
        launch(k.sphere_self, N, [*args, vectors(x)], [e, out])
        term = energies.pair_energy(x, listed.self_pairs, hand.sphere_radius, 0.002)
        assert np.any(term.energy > 0) or not len(listed.self_pairs)
        assert_close(out, start + 3 * term.gradient)
        assert_close(e, term.energy)


@pytest.mark.parametrize("apart", [0.0, 0.1, 5.0])
def test_overlaps_between_hands_equal_the_reference(hand, apart):
    from bidexdata.synthesis import sphere_kernels as k

    N, K, device = 11, len(hand.sphere_body), str(wp.get_device())
    dev = device_hand(hand, device)
    left, right = postures(hand, N), postures(hand, N) + rng.uniform(0, apart, (N, 1, 3))
    if apart > 1:
        right = right + 1.0
    x, radius = np.concatenate([left, right], axis=1), np.tile(hand.sphere_radius, 2)
    between = np.array([(a, K + b) for a in range(K) for b in range(K)])
    term = energies.pair_energy(x, between, radius, 0.005)
    assert np.all(term.energy == 0) if apart > 1 else np.any(term.energy > 0)
    start = rng.standard_normal(x.shape)
    e, pushed = poison(N), [vectors(start[:, :K]), vectors(start[:, K:])]
    balls = [dev.ball_hub, dev.ball_radius]
    args = [dev.sphere_radius, dev.sphere_radius, *balls, *balls, 3.0, 0.005]
    launch(k.hands_between, N, [*args, vectors(left), vectors(right)], [e, *pushed])
    expected = start + 3 * term.gradient
    assert_close(pushed[0], expected[:, :K])
    assert_close(pushed[1], expected[:, K:])
    assert_close(e, term.energy)
    if apart > 1:
        assert not e.numpy().any()


def test_the_box_around_a_hand_holds_its_spheres_and_no_more():
    from bidexdata.synthesis import sphere_kernels as k

    x = rng.uniform(-0.1, 0.1, (2, 6, 3))
    low, high = poison(2, wp.vec3), poison(2, wp.vec3)
    launch(k.hand_box, 2, [floats(np.full(6, 0.01)), vectors(x)], [low, high])
    np.testing.assert_allclose(low.numpy(), x.min(1) - 0.01, atol=1e-6)
    np.testing.assert_allclose(high.numpy(), x.max(1) + 0.01, atol=1e-6)


def test_remembering_clearances_changes_no_energy():
    """A sphere that wanders past the surface costs the same with and without its memory."""
    from bidexdata.synthesis import sphere_kernels as k

    N, K = 4, 50
    grid, radius = ball_grid(), floats(np.full(K, 0.01))
    size = floats(np.full(N, SIZE))
    x = rng.uniform(-0.25, 0.25, (N, K, 3))
    memory = wp.zeros((N, K), dtype=wp.vec4)
    touched = 0
    for _ in range(60):
        x += rng.normal(0, 0.004, x.shape)
        results = []
        for measured in (memory, wp.zeros((N, K), dtype=wp.vec4)):
            e, out = poison((N, K)), poison((N, K), wp.vec3)
            args = [radius, field_of(grid), size, 3.0, 0.001, vectors(x)]
            launch(k.sphere_object, N, args, [measured, e, out])
            results.append((e.numpy().copy(), out.numpy().copy()))
        assert np.array_equal(results[0][0], results[1][0])
        assert np.array_equal(results[0][1], results[1][1])
        touched += np.count_nonzero(results[0][0])
    assert touched > 500
