"""Laws of the contact QP: against hand calculation, float64, OSQP and finite differences."""

import itertools

import numpy as np
import pytest
import warp as wp

from bidexdata.errors import BadConfig
from bidexdata.frames import matrix_from_quat, quat_from_rotation_vector
from bidexdata.wrench.contact_model import cone_violation, contact_frames, wrench_of
from bidexdata.wrench.qp import (
    QPConfig,
    allocate_contact_qp,
    contact_qp,
    contact_qp_gradient,
    solve_contact_qp,
)
from bidexdata.wrench.qp_groups import axis_targets, qp_groups, zero_target
from bidexdata.wrench.qp_reference import osqp_contact_qp, reference_qp

wp.config.log_level = wp.LOG_WARNING
wp.init()
DEVICES = [d.alias for d in wp.get_devices()]

CONFIG = QPConfig()
LENGTH = 0.15
# Float32 sums of ten unit forces.
FLOAT32 = 2e-6
# The kernel's pressure bound: one Newton step from an error of 1 %, then float32.
PRESSURE = 1e-4


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def grasps(count, seed=0):
    """Two hands of five contacts on opposite sides of a ball, (N, 10, 3) each."""
    rng = np.random.default_rng(seed)
    side = unit(rng.standard_normal((count, 1, 3)))
    towards = np.concatenate([np.repeat(side, 5, 1), np.repeat(-side, 5, 1)], axis=1)
    normals = unit(-towards + 0.3 * rng.standard_normal(towards.shape))
    points = LENGTH * towards + 0.04 * rng.standard_normal(towards.shape)
    return points.astype(np.float32), normals.astype(np.float32)


def solve(points, normals, config=CONFIG, **options):
    lengths = np.full(len(points), LENGTH, np.float32)
    return contact_qp(points, normals, lengths, config, **options)


def device_arrays(points, normals, lengths, device="cpu"):
    def vectors(v):
        return wp.array(np.ascontiguousarray(v, np.float32), dtype=wp.vec3, device=device)

    return (
        vectors(points),
        vectors(normals),
        wp.array(np.asarray(lengths, np.float32), dtype=float, device=device),
    )


@pytest.mark.parametrize("beta", [0.0, 0.2, 0.7, 1.0])
@pytest.mark.parametrize("mu", [0.0, 0.1, 0.3, 0.6])
def test_two_opposed_contacts_through_the_origin_follow_the_closed_form(mu, beta):
    # Q = 4 max(0, beta - 2 mu)^2 for beta <= 1 and gamma <= 2 - beta: the two directions along the
    # normals cost nothing, in the other four friction 2 mu falls short of beta.
    points = np.array([[[-0.1, 0, 0], [0.1, 0, 0]]], np.float32)
    normals = np.array([[[1, 0, 0], [-1, 0, 0]]], np.float32)
    config = QPConfig(mu=mu, beta=beta, gamma=0.5 * (2 - beta))
    q = solve(points, normals, config, coupling="coupled", iterations=2000, hands=1)
    expected = 4 * max(0.0, beta - 2 * mu) ** 2
    assert q.residual.sum() == pytest.approx(expected, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("coupling", ["decoupled", "coupled"])
def test_every_iterate_is_feasible(coupling):
    points, normals = grasps(40)
    for iterations, beta in itertools.product((1, 4, 100), (0.2, 0.8, 6.0)):
        config = QPConfig(beta=beta)
        f = solve(points, normals, config, coupling=coupling, iterations=iterations).forces
        n = np.broadcast_to(normals[:, None, None], f.shape)
        assert cone_violation(f, n, mu=CONFIG.mu, cap=CONFIG.cap).max() < FLOAT32
        pressure = np.einsum("nltci,nltci->nltc", f, n)
        for hand in (slice(0, 5), slice(5, 10)):
            assert pressure[..., hand].sum(-1).min() > CONFIG.gamma - PRESSURE


def test_the_residual_is_that_of_the_forces():
    points, normals = grasps(12)
    q = solve(points, normals, coupling="mix", iterations=30)
    goal = CONFIG.beta * axis_targets()
    for k, (layer, hand) in enumerate([(0, slice(0, 5)), (0, slice(5, 10)), (1, slice(0, 10))]):
        f = q.forces[:, layer, :, hand]
        p = np.broadcast_to(points[:, None, hand], f.shape)
        w = wrench_of(p, f) - np.concatenate([goal[:, 0], LENGTH * goal[:, 1]], axis=-1)
        w[..., 3:] /= LENGTH
        assert np.allclose((w**2).sum(-1), q.residual[:, k], atol=1e-5)


@pytest.mark.parametrize("coupling", ["decoupled", "coupled"])
def test_the_kernel_reaches_the_float64_optimum(coupling):
    points, normals = grasps(4, seed=5)
    config = QPConfig(beta=0.8)
    q = solve(points, normals, config, coupling=coupling, iterations=4000)
    hands = [slice(0, 5), slice(5, 10)] if coupling == "decoupled" else [slice(0, 10)]
    for i in range(len(points)):
        for k, mine in enumerate(hands):
            hand = np.repeat([0, 1], 5)[mine]
            best = reference_qp(
                points[i, mine], normals[i, mine], hand, axis_targets()[2], LENGTH, config
            )
            assert q.residual[i, k, 2] == pytest.approx(best.residual, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize(("coupling", "beta"), [("decoupled", 0.8), ("coupled", 6.0)])
def test_osqp_agrees(coupling, beta):
    points, normals = grasps(3, seed=7)
    config = QPConfig(beta=beta, mu=0.2)
    q = solve(points, normals, config, coupling=coupling, iterations=4000)
    hands = [slice(0, 5), slice(5, 10)] if coupling == "decoupled" else [slice(0, 10)]
    for i in range(len(points)):
        for k, mine in enumerate(hands):
            for t in (0, 3, 4):
                args = (
                    points[i, mine], normals[i, mine], np.repeat([0, 1], 5)[mine],
                    axis_targets()[t], LENGTH, config,
                )  # fmt: skip
                pyramids = osqp_contact_qp(*args, rounds=1).residual
                eight = QPConfig(beta=beta, mu=0.2, cone_sides=8)
                assert osqp_contact_qp(*args[:-1], eight).residual == pyramids
                cones = osqp_contact_qp(*args).residual
                # OSQP stops at residuals of 1e-5 to 1e-4.
                assert q.residual[i, k, t] == pytest.approx(cones, rel=5e-4)
                assert pyramids <= cones * (1 + 5e-4)


def contact_sets(kind, count, rng):
    """Sets of five contacts, (N, 5, 3) each."""
    points = LENGTH * rng.standard_normal((count, 5, 3))
    normals = unit(rng.standard_normal((count, 5, 3)))
    if kind == "grasp":  # all press towards the middle, more or less
        normals = unit(-points + 0.5 * LENGTH * rng.standard_normal(points.shape))
    elif kind == "coplanar":  # points and normals in one plane
        points[..., 2] = normals[..., 2] = 0
        normals = unit(normals)
    elif kind == "parallel":
        normals = np.repeat(normals[:, :1], 5, axis=1)
    elif kind == "one point":
        points = np.repeat(points[:, :1], 5, axis=1)
    elif kind == "twice":  # three contacts, two of them there twice
        points, normals = points[:, [0, 0, 1, 1, 2]], normals[:, [0, 0, 1, 1, 2]]
    return points.astype(np.float32), normals.astype(np.float32)


KINDS = ("grasp", "random", "coplanar", "parallel", "one point", "twice")


def require_that_osqp_agrees(kind, sides, count):
    points, normals = contact_sets(kind, count, np.random.default_rng([len(kind), sides]))
    axes, unsolved = np.concatenate([axis_targets(), zero_target()]), 0
    for beta in (CONFIG.beta, 0.8):
        config = QPConfig(beta=beta, cone_sides=sides)
        found = solve(points, normals, config, hands=1, targets=axes, iterations=10_000).residual
        for i in range(count):
            t = i % len(axes)
            args = (points[i], normals[i], np.zeros(5, int), axes[t], LENGTH, config)
            try:
                expected = osqp_contact_qp(*args).residual
            except ArithmeticError:
                unsolved += 1
                continue
            # Neither is at the optimum: OSQP stops at wrenches of 1e-4 to 1e-3 caps, we after so many steps.
            assert found[i, 0, t] == pytest.approx(expected, rel=1e-3, abs=6e-4)
    assert unsolved <= 0.01 * 2 * count


@pytest.mark.parametrize("sides", [0, 8])
@pytest.mark.parametrize("kind", KINDS)
def test_osqp_agrees_on_random_and_degenerate_sets(kind, sides):
    require_that_osqp_agrees(kind, sides, 6)


@pytest.mark.slow
@pytest.mark.parametrize("sides", [0, 8])
@pytest.mark.parametrize("kind", KINDS)
def test_osqp_agrees_on_thousands_of_sets(kind, sides):
    require_that_osqp_agrees(kind, sides, 200)


def test_pyramids_with_many_sides_are_cones():
    points, normals = grasps(20, seed=31)
    round_ = solve(points, normals, QPConfig(beta=0.8), iterations=400)
    many = solve(points, normals, QPConfig(beta=0.8, cone_sides=500), iterations=400)
    eight = solve(points, normals, QPConfig(beta=0.8, cone_sides=8), iterations=400)
    assert np.allclose(many.residual, round_.residual, atol=2e-4)
    assert eight.residual.sum() < round_.residual.sum() - 1e-3  # they are larger than the cones


def test_forces_stay_within_the_pyramids():
    points, normals = grasps(20, seed=33)
    config = QPConfig(beta=6.0, cone_sides=8)
    f = solve(points, normals, config, coupling="coupled", iterations=50).forces.astype(np.float64)
    frame = contact_frames(normals)[:, None, None]
    local = np.einsum("nltcij,nltci->nltcj", np.broadcast_to(frame, (*f.shape, 3)), f)
    angles = 2 * np.pi * np.arange(8) / 8
    reach = local[..., 1:] @ np.stack([np.cos(angles), np.sin(angles)])
    assert (reach.max(-1) - config.mu * local[..., 0]).max() < FLOAT32
    assert (np.linalg.norm(local[..., 1:], axis=-1) - config.mu * local[..., 0]).max() > 1e-3


@pytest.mark.parametrize("coupling", ["decoupled", "coupled"])
def test_the_solution_satisfies_the_variational_inequality(coupling):
    # KKT in one formula: no feasible forces lie downhill of the solution.
    points, normals = grasps(20, seed=9)
    config = QPConfig(beta=0.8)
    q = solve(points, normals, config, coupling=coupling, iterations=3000)
    others = [
        solve(points, normals, config, coupling=coupling, iterations=i).forces for i in (1, 3, 20)
    ]
    groups = [(0, 5), (5, 10)] if coupling == "decoupled" else [(0, 10)]
    goal = config.beta * axis_targets()
    for start, stop in groups:
        f = q.forces[:, 0, :, start:stop].astype(np.float64)
        arm = np.broadcast_to(points[:, None, start:stop] / LENGTH, f.shape)
        r_f = f.sum(2) - goal[:, 0]
        r_t = np.cross(arm, f).sum(2) - goal[:, 1]
        g = r_f[:, :, None] + np.cross(r_t[:, :, None], arm)
        for other in others:
            step = other[:, 0, :, start:stop] - f
            assert np.einsum("ntci,ntci->nt", g, step).min() > -2e-3


def test_one_more_contact_never_raises_the_optimum():
    # gamma = 0: with a pressure bound the same holds, as the added contact may stay idle.
    points, normals = grasps(6, seed=11)
    for gamma in (0.0, 1.0):
        config = QPConfig(beta=0.8, gamma=gamma)
        values = [
            solve(points[:, :m], normals[:, :m], config, hands=1, iterations=3000).residual
            for m in (2, 3, 5, 8)
        ]
        for fewer, more in itertools.pairwise(values):
            assert np.all(more <= fewer + 1e-4)


def test_a_batch_gives_what_a_loop_gives():
    points, normals = grasps(17, seed=13)
    whole = solve(points, normals, coupling="mix", iterations=25)
    for i in (0, 1, 16):
        one = solve(points[i : i + 1], normals[i : i + 1], coupling="mix", iterations=25)
        assert np.array_equal(one.residual[0], whole.residual[i])
        assert np.array_equal(one.forces[0], whole.forces[i])


def test_mixed_groups_give_what_each_gives_alone():
    points, normals = grasps(9, seed=15)
    mix = solve(points, normals, coupling="mix", iterations=25)
    alone = solve(points, normals, coupling="decoupled", iterations=25)
    together = solve(points, normals, coupling="coupled", iterations=25)
    assert np.array_equal(mix.residual[:, :2], alone.residual)
    assert np.array_equal(mix.residual[:, 2:], together.residual)
    assert np.array_equal(mix.forces[:, :1], alone.forces)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("count", [0, 1, 7, 130])
def test_every_output_is_written(device, count):
    points, normals = grasps(max(count, 1))
    p, n, length = device_arrays(points[:count], normals[:count], np.full(count, LENGTH), device)
    groups = qp_groups((5, 5), "mix")
    qp = allocate_contact_qp(count, groups, device=device)
    for array in (qp.residual, qp.residual_force, qp.residual_torque):
        array.fill_(np.nan)
    solve_contact_qp(p, n, length, qp, CONFIG, iterations=3)
    gradients = [wp.empty_like(p), wp.empty_like(p)]
    for array in gradients:
        array.fill_(np.nan)
    weight = wp.array(np.ones(3, np.float32), dtype=float, device=device)
    contact_qp_gradient(p, n, length, qp, weight, *gradients)
    for array in (qp.residual, qp.residual_force, qp.residual_torque, *gradients, qp.forces):
        assert np.all(np.isfinite(array.numpy()))


def test_hands_may_have_different_numbers_of_contacts():
    points, normals = grasps(5, seed=17)
    keep = [0, 1, 2, 3, 4, 5, 6, 7]
    p, n, length = device_arrays(points, normals, np.full(5, LENGTH))
    qp = allocate_contact_qp(5, qp_groups((5, 3), "mix"))
    solve_contact_qp(p, n, length, qp, CONFIG, iterations=40)
    # The two padded places are as if they were not there.
    for hand, part in ((0, slice(0, 5)), (1, slice(5, 8))):
        one = solve(points[:, part], normals[:, part], hands=1, iterations=40)
        assert np.array_equal(qp.residual.numpy()[:, hand], one.residual[:, 0])
    assert np.all(qp.forces.numpy()[:, :, :, 8:] == 0)
    grads = [wp.empty_like(p), wp.empty_like(p)]
    weight = wp.array(np.ones(3, np.float32), dtype=float, device="cpu")
    contact_qp_gradient(p, n, length, qp, weight, *grads)
    assert np.all(grads[0].numpy()[:, 8:] == 0)
    assert np.all(np.any(grads[0].numpy()[:, keep] != 0, axis=-1))


@pytest.mark.parametrize("coupling", ["decoupled", "coupled", "mix"])
def test_the_gradient_is_the_finite_difference_of_the_optimum(coupling):
    # Loads beyond what the contacts can resist: then the optimum is smooth and not zero.
    points, normals = grasps(6, seed=19)
    config = QPConfig(beta=3.0, mu=0.2)
    rng = np.random.default_rng(20)
    step = 2e-3
    weights = rng.uniform(0.5, 2, {"decoupled": 2, "coupled": 1, "mix": 3}[coupling])

    def energy(points, normals):
        q = solve(points, normals, config, coupling=coupling, iterations=3000)
        return (q.residual.astype(np.float64).sum(-1) * weights).sum(-1)

    p, n, length = device_arrays(points, normals, np.full(6, LENGTH))
    qp = allocate_contact_qp(6, qp_groups((5, 5), coupling))
    solve_contact_qp(p, n, length, qp, config, iterations=3000)
    by_point, by_normal = wp.empty_like(p), wp.empty_like(p)
    weight = wp.array(weights.astype(np.float32), dtype=float, device="cpu")
    contact_qp_gradient(p, n, length, qp, weight, by_point, by_normal)

    shift = LENGTH * rng.standard_normal(points.shape) * step
    difference = energy(points + shift, normals) - energy(points - shift, normals)
    slope = 2 * (by_point.numpy() * shift).sum((1, 2))
    assert np.allclose(difference, slope, rtol=0.01, atol=2e-4)

    turn = quat_from_rotation_vector(rng.standard_normal(points.shape) * step)
    R = matrix_from_quat(turn)
    ahead, back = np.einsum("ncij,ncj->nci", R, normals), np.einsum("ncji,ncj->nci", R, normals)
    difference = energy(points, ahead) - energy(points, back)
    slope = (by_normal.numpy() * (ahead - back)).sum((1, 2))
    assert np.allclose(difference, slope, rtol=0.01, atol=2e-4)
    along = np.einsum("nci,nci->nc", by_normal.numpy(), normals)
    assert np.abs(along).max() < 1e-3


def test_a_warm_start_continues_where_the_last_call_ended():
    points, normals = grasps(10, seed=21)
    p, n, length = device_arrays(points, normals, np.full(10, LENGTH))
    qp = allocate_contact_qp(10, qp_groups((5, 5), "coupled"))
    best = solve(points, normals, iterations=2000).residual.sum()
    last = np.inf
    for _ in range(40):
        solve_contact_qp(p, n, length, qp, CONFIG, iterations=4)
        now = qp.residual.numpy().sum()
        assert now < last * 1.05 + 1e-5
        last = now
    assert last < best + 0.02


def test_without_load_two_facing_hands_press_in_balance_and_one_hand_cannot():
    points, normals = grasps(10, seed=23)
    both = solve(points, normals, coupling="coupled", targets=zero_target(), iterations=500)
    alone = solve(points, normals, coupling="decoupled", targets=zero_target(), iterations=500)
    assert both.residual.shape == (10, 1, 1)
    # A hand on one side presses with gamma = 1 away from itself and has nothing against it.
    assert both.residual.max() < 0.05
    assert alone.residual.min() > 0.3


@pytest.mark.parametrize(
    "normals",
    [
        np.tile([0.0, 0.0, 1.0], (5, 1)),  # parallel
        np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 1, 0]], float),  # coplanar
        np.array([[1, 0, 0], [1, 0, 0], [-1, 0, 0], [-1, 0, 0], [-1, 0, 0]], float),
    ],
)
@pytest.mark.parametrize("spread", [0.0, 0.1])
def test_degenerate_contact_sets_have_the_optimum_of_float64(normals, spread):
    # Spread 0: all contacts in one point, where torques vanish.
    points = -spread * normals + spread * np.array([[0, 0, 0.3], [0, 0, -0.3], [0.2, 0, 0]] * 2)[:5]
    q = solve(
        points[None].astype(np.float32), normals[None].astype(np.float32), hands=1, iterations=5000
    )
    for t, target in enumerate(axis_targets()):
        best = reference_qp(points, normals, np.zeros(5, int), target, LENGTH, CONFIG)
        assert q.residual[0, 0, t] == pytest.approx(best.residual, rel=1e-3, abs=1e-5)


def test_no_contact_leaves_the_whole_load():
    q = solve(np.zeros((3, 0, 3), np.float32), np.zeros((3, 0, 3), np.float32), hands=1)
    assert np.allclose(q.residual, CONFIG.beta**2)


def test_more_pressure_than_the_caps_allow_ends_at_the_caps():
    points, normals = grasps(4, seed=25)
    f = solve(points, normals, QPConfig(gamma=20.0, mu=0.3), iterations=50).forces
    pressed = np.einsum("nltci,nci->nltc", f, normals)
    assert np.allclose(pressed, 1.0, atol=1e-5)


@pytest.mark.parametrize(
    "change", [{"mu": -0.1}, {"cap": 0.0}, {"gamma": float("nan")}, {"cone_sides": 2}]
)
def test_impossible_constants_are_refused_by_name(change):
    with pytest.raises(BadConfig, match=f"QPConfig.{next(iter(change))}"):
        QPConfig(**change)


def test_targets_of_each_grasp_are_those_of_all_one_by_one():
    arrays = device_arrays(*grasps(6, seed=12), np.full(6, LENGTH))
    own = axis_targets()[:, None]  # one of the six axes for each of the six grasps
    groups = qp_groups((5, 5), "coupled")
    found = allocate_contact_qp(6, groups, own)
    solve_contact_qp(*arrays, found, CONFIG, iterations=60)
    for t, target in enumerate(axis_targets()):
        one = allocate_contact_qp(6, groups, target[None])
        solve_contact_qp(*arrays, one, CONFIG, iterations=60)
        assert np.array_equal(found.residual.numpy()[t], one.residual.numpy()[t])
