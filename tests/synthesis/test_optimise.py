"""Laws of the optimisation as a whole: its gradient, its symmetry, its stages."""

from dataclasses import replace

import numpy as np
import pytest

from bidexdata.frames import (
    matrix_from_quat,
    quat_angle,
    quat_from_rotation_vector,
    quat_multiply,
    random_quat,
)
from bidexdata.hands import load_hands
from bidexdata.hands.contact_sets import contact_view
from bidexdata.hands.kinematics import forward_kinematics, hand_points
from bidexdata.objects.distance_field import signed_distance
from bidexdata.objects.prepared import SignedDistanceGrid
from bidexdata.synthesis import chain
from bidexdata.synthesis.forces import (
    BaseGive,
    base_give,
    contact_forces,
    force_scales,
    joint_torques,
    shifted_residual,
    wanted_press,
    weight_share,
)
from bidexdata.synthesis.optimise import closure_problem, optimise
from bidexdata.synthesis.optimise_config import (
    AdamConfig,
    ClosureConfig,
    EnergyConfig,
    OptimiseConfig,
    PhaseConfig,
)
from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.staging import Press, StagingConfig, squeeze, torque_offsets
from bidexdata.synthesis.workspace import Start, allocate
from bidexdata.wrench.qp import QPConfig

# Kernels are float32 and the field is piecewise linear: slopes agree to a few percent.
SLOPE_TOLERANCE = 0.03
SIZE = 0.4


class Ellipsoid:
    """A body whose field is symmetric about x = 0, with what the optimiser reads of an object."""

    def __init__(self, cells=80):
        axis = np.linspace(-0.7, 0.7, cells + 1)
        x = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
        radii = np.array([0.32, 0.25, 0.28])
        k0 = np.linalg.norm(x / radii, axis=-1)
        k1 = np.linalg.norm(x / radii**2, axis=-1)
        values = (k0 * (k0 - 1) / np.maximum(k1, 1e-6)).astype(np.float32)
        self.sdf = SignedDistanceGrid(values=values, origin=np.full(3, -0.7), cell=1.4 / cells)
        self.longest_side = 2 * radii.max()


@pytest.fixture(scope="module")
def hands():
    left, right = load_hands("capsule")
    return contact_view(left, "fingertips"), contact_view(right, "fingertips")


@pytest.fixture(scope="module")
def body():
    return Ellipsoid()


def facing_start(hands, count, seed=0, distance=0.11):
    """Hands on both sides of the body along x, palms facing it."""
    rng = np.random.default_rng(seed)
    # Palm faces -y of the hand frame: turn it to the body.
    right = matrix_from_quat([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])  # -y -> +x
    R = np.empty((count, 2, 3, 3))
    p = np.empty((count, 2, 3))
    for h, side in enumerate((-1.0, 1.0)):
        base = right if side < 0 else right.T
        for n in range(count):
            small = rng.normal(0, 0.1, 3)
            turn = matrix_from_quat(np.append(1.0, small) / np.linalg.norm(np.append(1.0, small)))
            R[n, h] = turn @ base
            # The middle of the contacts lies over the body's side.
            middle = hand_points(hands[h], hands[h].posture_curved).contact.mean(0)
            p[n, h] = np.array([side * (0.32 * SIZE + distance - 0.07), 0, 0]) - R[n, h] @ middle
    joints = tuple(np.tile(h.posture_curved, (count, 1)) for h in hands)
    anchors = np.array([[[-0.32 * SIZE, 0, 0]], [[0.32 * SIZE, 0, 0]]])
    return Start(
        size=np.full(count, SIZE),
        position=p,
        rotation=R,
        joints=joints,
        regions=np.tile(anchors, (count, 1, 1, 1)),
        plane=np.zeros((count, 4)),
    )


def short(steps=(12, 6, 4), **kwargs):
    base = OptimiseConfig()
    phases = (base.approach, base.pregrasp, base.grasp)
    a, b, c = (replace(p, steps=s) for p, s in zip(phases, steps, strict=True))
    return replace(base, approach=a, pregrasp=b, grasp=c, **kwargs)


def total_energy(ws, energy, closure_weight=0.0, residual=None):
    """Weighted energy of each grasp, from what the kernels wrote."""
    c = ws.contacts
    total = energy.distance * c.distance_energy.numpy().sum(1, dtype=float)
    total += energy.region * c.region_energy.numpy().sum(1, dtype=float)
    total += energy.pad * c.pad_energy.numpy().sum(1, dtype=float)
    for hand in ws.hands:
        total += energy.penetration * hand.sphere_energy.numpy().sum(1, dtype=float)
        total += energy.self_penetration * hand.self_energy.numpy().astype(float)
    total += energy.self_penetration * ws.between_energy.numpy().astype(float)
    if residual is not None:
        total += closure_weight * residual.numpy().sum((1, 2), dtype=float)
    return total


def zero_energy(**weights):
    names = ("distance", "region", "penetration", "self_penetration", "pad")
    return EnergyConfig(**{**dict.fromkeys(names, 0.0), **weights})


def slopes(body, hands, start, energy, direction, *, closure=None, step=2e-3, circling=False):
    """Directional derivative by the chain of kernels and by central differences, (N,) each."""
    closure = closure or ClosureConfig(groups="decoupled", weight_decoupled=0.0)

    def run(amount, want_gradient):
        turned, moved, joints = [], [], []
        for h in range(2):
            d = direction[h]
            angle = amount * d[3:6]
            q = np.append(1.0, 0.5 * angle)
            turned.append(matrix_from_quat(q / np.linalg.norm(q)) @ start.rotation[:, h])
            moved.append(start.position[:, h] + amount * d[:3])
            joints.append(start.joints[h] + amount * hands[h].coupling @ d[6:])
        state = replace(
            start,
            rotation=np.stack(turned, 1),
            position=np.stack(moved, 1),
            joints=(joints[0], joints[1]),
        )
        ws = allocate(body, hands, state, np.full(len(state.size), 0.15))
        qp, weights = closure_problem(ws, closure)
        if circling:
            closing = chain.circling_closure_term(ws, qp, weights, closure, energy, 1)
        else:
            closing = chain.closure_term(ws, qp, weights, closure.qp, 3000)
        calls = [
            *chain.kinematics(ws),
            *chain.surface(ws, energy),
            *chain.distance_term(ws, energy, 0.0),
            *closing,
            *chain.region_term(ws, energy),
            *chain.pad_term(ws, energy),
            *chain.chain_to_centres(ws, energy),
            *chain.collision_terms(ws, energy),
            *chain.backward(ws),
        ]
        for call in calls:
            call()
        if want_gradient:
            return sum(
                hand.points.gradient.numpy().astype(float) @ direction[h]
                for h, hand in enumerate(ws.hands)
            )
        return total_energy(ws, energy, closure.weight_decoupled, qp.residual)

    numeric = (run(step, False) - run(-step, False)) / (2 * step)
    return run(0.0, True), numeric


@pytest.mark.parametrize(
    ("name", "distance"),
    [("distance", 0.11), ("region", 0.15), ("penetration", 0.06), ("self_penetration", 0.11)],
)
def test_the_gradient_of_each_energy_is_its_central_difference(body, hands, name, distance):
    start = facing_start(hands, 6, distance=distance)
    if name == "self_penetration":
        # Fingers curl into the palm, and the hands into each other.
        start = replace(start, joints=tuple(1.9 * q for q in start.joints))
        start = replace(start, position=0.2 * start.position)
    energy = zero_energy(**{name: 100.0})
    if name == "region":
        energy = replace(energy, region_threshold=0.02)
    rng = np.random.default_rng(3)
    exact, numeric = [], []
    for _ in range(4):
        direction = [rng.standard_normal(6 + h.coupling.shape[1]) * 0.3 for h in hands]
        a, b = slopes(body, hands, start, energy, direction)
        exact.append(a)
        numeric.append(b)
    exact, numeric = np.array(exact), np.array(numeric)
    scale = np.abs(numeric).max()
    assert scale > 1e-3
    np.testing.assert_allclose(exact, numeric, atol=SLOPE_TOLERANCE * scale)


@pytest.mark.parametrize("circling", [False, True])
def test_the_gradient_of_the_closure_follows_its_central_difference(body, hands, circling):
    """Through QP, surface point and normal; curvature between pad and surface is neglected."""
    start = facing_start(hands, 8, distance=0.065)
    # One hand alone cannot balance its own pressure, so this closure energy is far from zero.
    closure = ClosureConfig(groups="decoupled", weight_decoupled=10.0, iterations=3000)
    rng = np.random.default_rng(4)
    pairs = []
    for _ in range(4):
        direction = [rng.standard_normal(6 + h.coupling.shape[1]) * 0.3 for h in hands]
        how = {"closure": closure, "circling": circling}
        pairs.append(slopes(body, hands, start, zero_energy(), direction, **how))
    exact, numeric = np.concatenate(pairs, axis=1)
    assert np.abs(numeric).max() > 1e-2
    assert np.corrcoef(exact, numeric)[0, 1] > 0.97
    slope = np.sum(exact * numeric) / np.sum(numeric**2)
    assert 0.9 < slope < 1.3


@pytest.mark.parametrize("table", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.03)])
def test_a_mirrored_start_gives_the_mirrored_result(body, hands, table):
    mirror = np.diag([-1.0, 1, 1])
    start = facing_start(hands, 5)
    start = replace(start, plane=np.tile(table, (5, 1)))

    def swapped(position, rotation):
        return position[:, ::-1] @ mirror, mirror @ rotation[:, ::-1] @ mirror

    p, R = swapped(start.position, start.rotation)
    other = replace(
        start,
        position=p,
        rotation=R,
        joints=start.joints[::-1],
        regions=start.regions[:, ::-1] @ mirror,
    )
    one = optimise(body, hands, start, short()).grasp
    two = optimise(body, hands, other, short()).grasp
    back_p, back_R = swapped(two.position, matrix_from_quat(two.quat_wxyz))
    np.testing.assert_allclose(back_p, one.position, atol=2e-4)
    np.testing.assert_allclose(back_R, matrix_from_quat(one.quat_wxyz), atol=5e-3)
    for h in range(2):
        np.testing.assert_allclose(two.joints[1 - h], one.joints[h], atol=2e-2)
    moved = np.abs(one.position - start.position).max()
    assert moved > 5e-3


def test_the_pads_end_at_the_distances_asked_for(body, hands):
    config = OptimiseConfig()
    found = optimise(body, hands, facing_start(hands, 8), config)
    # At the grasp the margin of the collision spheres keeps some pads away.
    for pose, wanted in ((found.pregrasp, config.pregrasp.distance), (found.grasp, 0.0)):
        for h, hand in enumerate(hands):
            base = (pose.position[:, h], pose.quat_wxyz[:, h])
            centres = hand_points(hand, pose.joints[h], *base).contact
            gaps = signed_distance(body.sdf, SIZE, centres)[0] - hand.contact_radius
            assert abs(np.median(gaps) - wanted) < 2e-3


def test_contact_spheres_have_a_margin_of_their_own(body, hands):
    # The margin of 2 mm and the weight of the distance leave pads 1.9 mm off; without it they touch.
    def mean_gap(margin):
        energy = EnergyConfig(contact_margin=margin)
        return optimise(
            body, hands, facing_start(hands, 8), OptimiseConfig(energy=energy)
        ).gaps.mean()

    kept, let_in = mean_gap(EnergyConfig().object_margin), mean_gap(-0.002)
    assert kept == pytest.approx(1.9e-3, abs=4e-4)
    assert let_in < 0.6 * kept


def test_joints_stay_within_their_limits(body, hands):
    phase = PhaseConfig(
        steps=30, distance=0.0, step_position=0.0, step_rotation=0.0, step_joints=1.0
    )
    config = replace(short(), approach=phase)
    grasp = optimise(body, hands, facing_start(hands, 4), config).grasp
    for hand, q in zip(hands, grasp.joints, strict=True):
        assert np.all(q >= hand.joint_lower - 1e-6)
        assert np.all(q <= hand.joint_upper + 1e-6)


def test_the_same_start_gives_the_same_bytes_in_any_batch(body, hands):
    start = facing_start(hands, 7)

    def rows(index):
        return Start(
            size=start.size[index],
            position=start.position[index],
            rotation=start.rotation[index],
            joints=(start.joints[0][index], start.joints[1][index]),
            regions=start.regions[index],
            plane=start.plane[index],
        )

    whole = optimise(body, hands, start, short())
    again = optimise(body, hands, start, short())
    part = optimise(body, hands, rows(slice(3, 4)), short())
    for a, b in ((whole, again),):
        assert a.grasp.position.tobytes() == b.grasp.position.tobytes()
        assert a.points.tobytes() == b.points.tobytes()
    assert part.grasp.position.tobytes() == whole.grasp.position[3:4].tobytes()
    assert part.grasp.quat_wxyz.tobytes() == whole.grasp.quat_wxyz[3:4].tobytes()
    assert part.energies.closure.tobytes() == whole.energies.closure[3:4].tobytes()


def test_no_start_gives_no_grasp(body, hands):
    start = facing_start(hands, 1)
    none = Start(
        size=start.size[:0],
        position=start.position[:0],
        rotation=start.rotation[:0],
        joints=(start.joints[0][:0], start.joints[1][:0]),
        regions=start.regions[:0],
        plane=start.plane[:0],
    )
    assert optimise(body, hands, none, short()).grasp.position.shape == (0, 2, 3)


def test_a_start_that_is_not_finite_spoils_no_other(body, hands):
    start = facing_start(hands, 4)
    bad = start.position.copy()
    bad[1] = np.nan
    found = optimise(body, hands, replace(start, position=bad), short())
    clean = optimise(body, hands, start, short())
    assert found.grasp.finite().tolist() == [True, False, True, True]
    keep = [0, 2, 3]
    assert np.array_equal(found.grasp.position[keep], clean.grasp.position[keep])


def test_a_table_is_left_clear(body, hands):
    start = facing_start(hands, 6)
    height = 0.06
    plane = np.tile([0.0, 0.0, 1.0, height], (6, 1))
    found = optimise(body, hands, replace(start, plane=plane), OptimiseConfig())
    free = optimise(body, hands, start, OptimiseConfig())

    def lowest(pose):
        bottoms = []
        for h, hand in enumerate(hands):
            points = hand_points(hand, pose.joints[h], pose.position[:, h], pose.quat_wxyz[:, h])
            bottoms.append((points.sphere[..., 2] - hand.sphere_radius).min(axis=1))
        return np.min(bottoms, axis=0) + height

    assert np.min(lowest(free.grasp)) < -0.005, "the table must matter in this test"
    assert np.min(lowest(found.grasp)) > -0.004


def test_the_squeeze_without_torques_is_the_papers():
    """2 G - G_pre: by hand, a hand that moved by d and turned by r goes on by d and r."""
    hands = load_hands("capsule")
    rng = np.random.default_rng(0)
    joints = [rng.uniform(0, 1, (2, 3, len(h.joint_names))) for h in hands]
    turn = random_quat(rng, (3, 2))
    small = np.tile([np.cos(0.1), np.sin(0.1), 0, 0], (3, 2, 1))
    pre = Pose(rng.standard_normal((3, 2, 3)), turn, (joints[0][0], joints[1][0]))
    grasp = Pose(pre.position + 0.01, quat_multiply(small, turn), (joints[0][1], joints[1][1]))
    none = [np.zeros((3, h.coupling.shape[1])) for h in hands]
    still = Press(none, BaseGive(np.zeros((3, 2, 3)), np.zeros((3, 2, 3))))
    target = squeeze(pre, grasp, still, hands, StagingConfig(extrapolate=1.0))
    np.testing.assert_allclose(target.position, grasp.position + 0.01)
    assert np.all(quat_angle(target.quat_wxyz, quat_multiply(small, grasp.quat_wxyz)) < 1e-9)
    for h in range(2):
        np.testing.assert_allclose(target.joints[h], 2 * grasp.joints[h] - pre.joints[h])


def test_the_bases_target_leads_by_what_its_weld_gives_way():
    """By hand: 5 N along y that act 0.1 m along x of the base's origin, k = 1000 N/m, 10 N m/rad."""
    points, forces = np.zeros((1, 2, 2, 3)), np.zeros((1, 2, 2, 3))
    points[0, 0, 0], forces[0, 0, 0] = [0.3, 0, 0], [0, 5, 0]
    position = np.tile([0.2, 0.0, 0.0], (1, 2, 1))
    give = base_give(points, forces, position, [(1000.0, 10.0)] * 2)
    np.testing.assert_allclose(give.shift[0], [[0, 0.005, 0], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(give.turn[0], [[0, 0, 0.05], [0, 0, 0]], atol=1e-12)
    hands = load_hands("capsule")
    joints = (hands[0].posture_open[None], hands[1].posture_open[None])
    grasp = Pose(position, np.tile([1.0, 0, 0, 0], (1, 2, 1)), joints)
    press = Press([np.zeros((1, h.coupling.shape[1])) for h in hands], give)
    target = squeeze(grasp, grasp, press, hands, StagingConfig(base_lead=2.0))
    np.testing.assert_allclose(target.position - grasp.position, 2 * give.shift)
    quarter = [np.cos(0.05), 0, 0, np.sin(0.05)]
    np.testing.assert_allclose(target.quat_wxyz[0, 0], quarter, atol=1e-12)


def test_torques_do_the_work_of_the_forces(body, hands):
    """J^T f . du = f . dp for small changes of the joints, p being where the fingers touch."""
    found = optimise(body, hands, facing_start(hands, 3), short())
    rng = np.random.default_rng(5)
    forces = rng.standard_normal((3, 2, found.points.shape[2], 3))
    torques = joint_torques(found.workspace, forces)
    for h, hand in enumerate(hands):
        base = matrix_from_quat(found.grasp.quat_wxyz[:, h])
        joints, carrier = found.grasp.joints[h], hand.contact_body
        pos, rot = forward_kinematics(hand, joints)
        local = np.einsum(
            "nji,ncj->nci", base, found.points[:, h] - found.grasp.position[:, None, h]
        )
        local = np.einsum("ncji,ncj->nci", rot[:, carrier], local - pos[:, carrier])
        du = rng.standard_normal(hand.coupling.shape[1]) * 1e-6
        ends = []
        for sign in (1, -1):
            pos, rot = forward_kinematics(hand, joints + sign * hand.coupling @ du)
            at = pos[:, carrier] + np.einsum("ncij,ncj->nci", rot[:, carrier], local)
            ends.append(np.einsum("nij,ncj->nci", base, at))
        work = np.sum(forces[:, h] * (ends[0] - ends[1]) / 2, axis=(1, 2))
        np.testing.assert_allclose(torques[h] @ du, work, rtol=1e-3, atol=1e-9)


def exerted(hand, joints, targets, stiffness):
    """Joint torques of MuJoCo's actuators at `joints` with controls for `targets`, (J,)."""
    import mujoco

    model = hand.make_spec().compile()
    model.actuator_gainprm[:] = model.actuator_biasprm[:] = 0.0
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1] = stiffness, -stiffness
    model.actuator_forcelimited[:] = model.actuator_ctrllimited[:] = 0
    data = mujoco.MjData(model)
    at = [model.joint(name).qposadr[0] for name in hand.joint_names]
    data.qpos[at] = joints
    data.ctrl[[model.actuator(n).id for n in hand.actuator_names]] = hand.actuator_moment @ targets
    mujoco.mj_forward(model, data)
    return data.qfrc_actuator[[model.joint(name).dofadr[0] for name in hand.joint_names]]


def test_the_offsets_make_the_actuators_do_the_work_of_the_torques(hands):
    """In MuJoCo, at the grasp: neither half nor twice, on tendons over two joints either."""
    config = StagingConfig(largest_offset=3.0)
    rng = np.random.default_rng(6)
    for hand in hands:
        assert np.any(np.count_nonzero(hand.coupling, axis=0) > 1), "a tendon must be in this test"
        wanted = rng.uniform(-0.2, 0.2, (1, hand.coupling.shape[1]))
        joints = hand.coupling @ rng.uniform(0.1, 0.5, hand.coupling.shape[1])
        targets = joints + torque_offsets(hand, wanted, config)[0]
        torques = exerted(hand, joints, targets, config.stiffness)
        np.testing.assert_allclose(hand.coupling.T @ torques, wanted[0], atol=1e-9)


def test_a_tendon_pulls_with_the_least_squares_torque_of_its_joints(hands):
    """By hand: joint torques 0.3 and 0.1 under one tendon; 0.2 at both is closest to them."""
    hand = hands[0]
    d = int(np.argmax(np.count_nonzero(hand.coupling, axis=0)))
    pair = np.flatnonzero(hand.coupling[:, d])
    wanted = np.zeros((1, hand.coupling.shape[1]))
    wanted[0, d] = 0.3 + 0.1
    offsets = torque_offsets(hand, wanted, StagingConfig(stiffness=5.0))[0]
    np.testing.assert_allclose(offsets[pair], 0.02, atol=1e-12)
    assert np.count_nonzero(np.abs(offsets) > 1e-12) == 2
    nearest = np.linalg.lstsq(hand.actuator_moment.T[pair], np.array([0.3, 0.1]), rcond=None)[0]
    np.testing.assert_allclose(5.0 * hand.actuator_moment @ offsets, nearest, atol=1e-12)


def test_each_hand_presses_as_hard_as_the_weight_asks(body, hands):
    found = optimise(body, hands, facing_start(hands, 4), OptimiseConfig())
    forces = contact_forces(found.workspace, ClosureConfig(), 150)
    mass = np.array([0.0, 0.01, 0.1, 1.0])
    scale = force_scales(forces.forces, found.normals_in, wanted_press(mass, 3.0, 8.0))
    pressed = np.sum(forces.forces * found.normals_in, axis=(2, 3)) * scale
    np.testing.assert_allclose(pressed, np.tile([[3.0], [3.0], [7.84], [78.4]], (1, 2)), rtol=1e-5)
    assert np.all(forces.residual >= 0)


def shifted(workspace, shift, mu=0.3, weight=0.0):
    closure, step = ClosureConfig(qp=QPConfig(mu=mu)), EnergyConfig().normal_step
    load = np.full(workspace.count, weight)
    return shifted_residual(workspace, closure, step, load, shift=shift, sets=12, iterations=150)


def test_contacts_that_stay_have_the_coupled_residual(body, hands):
    found = optimise(body, hands, facing_start(hands, 4), short())
    plain = contact_forces(found.workspace, ClosureConfig(), 150).residual
    np.testing.assert_allclose(shifted(found.workspace, 0.0), plain, rtol=0.02, atol=1e-5)


def test_heavier_objects_leave_more_residual_and_what_friction_holds_none(body, hands):
    """Each hand presses with 1; all ten contacts at their cap of 1 hold less than 10 (1 + mu)."""
    found = optimise(body, hands, facing_start(hands, 4), short())
    means = [shifted(found.workspace, 0.0, weight=w).mean() for w in (0.0, 0.1, 3.0, 14.0)]
    assert means[0] <= means[1] + 1e-6
    assert means[1] < 0.01
    assert means[1] < means[2] < means[3]
    assert means[3] > (14.0 - 10 * 1.3) ** 2
    np.testing.assert_allclose(weight_share(np.array([0.0, 1.0]), np.array([0.0, 4.9])), [0, 2])


def test_a_balance_that_needs_exact_places_is_lost_when_they_move(body, hands):
    """The farther the contacts move, the worse; and no grasp is judged by its neighbours."""
    slippery = 0.05
    closure = ClosureConfig(qp=QPConfig(mu=slippery), weight_coupled=200.0)
    config = OptimiseConfig(closure=closure)
    found = optimise(body, hands, facing_start(hands, 6), config)
    means = [shifted(found.workspace, shift, slippery).mean() for shift in (0.0, 0.01, 0.03)]
    assert means[0] < means[1] < means[2]
    start = facing_start(hands, 6)
    first = replace(
        start,
        **{name: getattr(start, name)[:2] for name in ("size", "position", "rotation", "plane")},
        joints=tuple(j[:2] for j in start.joints),
        regions=start.regions[:2],
    )
    alone = optimise(body, hands, first, config)
    np.testing.assert_array_equal(
        shifted(alone.workspace, 0.01, slippery), shifted(found.workspace, 0.01, slippery)[:2]
    )


def test_the_step_rule_is_adam_with_shared_moments(hands, body):
    """Two steps by hand in float64."""
    start = facing_start(hands, 3)
    ws = allocate(body, hands, start, np.full(3, 0.15))
    rule = AdamConfig(beta1=0.9, beta2=0.95, final_fraction=0.5)
    phase = PhaseConfig(
        steps=2, distance=0.0, step_position=0.002, step_rotation=0.02, step_joints=0.03
    )
    move = chain.adam(ws, rule, phase)[0]
    rng = np.random.default_rng(1)
    free = hands[0].coupling.shape[1]
    gradients = rng.standard_normal((2, 3, 6 + free)).astype(np.float32)
    m, v = np.zeros((3, 6 + free)), np.zeros((3, 2 + free))
    p, R = start.position[:, 0].copy(), start.rotation[:, 0].copy()
    first = ws.hands[0].joints.numpy().astype(float)
    lower, upper = ws.hands[0].model.free_lower.numpy(), ws.hands[0].model.free_upper.numpy()
    for i, g in enumerate(gradients):
        ws.hands[0].points.gradient.assign(g)
        move(i)
        m = 0.9 * m + 0.1 * g
        squares = np.concatenate(
            [np.sum(g[:, :3] ** 2, 1)[:, None], np.sum(g[:, 3:6] ** 2, 1)[:, None], g[:, 6:] ** 2],
            1,
        )
        v = 0.95 * v + 0.05 * squares
        m_hat, v_hat = m / (1 - 0.9 ** (i + 1)), v / (1 - 0.95 ** (i + 1))
        fraction = (1.0, 0.5)[i]
        p = p - 0.002 * fraction * m_hat[:, :3] / np.sqrt(v_hat[:, :1])
        # About the base's origin, in the object frame: the turn comes after what was there.
        turn = -0.02 * fraction * m_hat[:, 3:6] / np.sqrt(v_hat[:, 1:2])
        R = matrix_from_quat(quat_from_rotation_vector(turn)) @ R
        first = np.clip(
            first - 0.03 * fraction * m_hat[:, 6:] / np.sqrt(v_hat[:, 2:]), lower, upper
        )
    np.testing.assert_allclose(ws.hands[0].position.numpy(), p, atol=1e-6)
    np.testing.assert_allclose(ws.hands[0].joints.numpy(), first, atol=1e-5)
    np.testing.assert_allclose(ws.hands[0].rotation.numpy(), R, atol=1e-6)
