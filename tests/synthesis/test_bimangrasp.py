"""Laws of the baseline `bimangrasp`: its terms, their gradients, its annealing, its stages."""

import numpy as np
import pytest
from made_objects import box_object

from bidexdata.config import with_overrides
from bidexdata.errors import BadConfig
from bidexdata.frames import matrix_from_quat
from bidexdata.objects.distance_field import signed_distance, surface_normal
from bidexdata.record import Scene
from bidexdata.synthesis.baselines import annealing, bimangrasp, bimangrasp_starts
from bidexdata.synthesis.baselines import bimangrasp_energies as energies
from bidexdata.synthesis.baselines.bimangrasp_config import BimanGraspConfig
from bidexdata.synthesis.baselines.candidates import contact_candidates
from bidexdata.synthesis.forces import BaseGive
from bidexdata.synthesis.opening import LEAST_CLOSING, closing_joints
from bidexdata.synthesis.optimise import read_pose
from bidexdata.synthesis.staging import Press

SIZE_MM = 300
FLOAT32 = 2e-3  # relative, of sums of single-precision terms
SLOPE = 0.03  # relative: the field is piecewise linear


def config(*changes):
    few = ("energy.object_points=300", "energy.hand_points=60", "annealing.steps=60")
    return with_overrides(BimanGraspConfig(), [*few, *changes])


@pytest.fixture(scope="module")
def obj():
    return box_object()


def starts(obj, hands, rules, count=3, sizes=(SIZE_MM,)):
    return [
        bimangrasp_starts.draw_starts(obj, hands, Scene(obj.object_id, mm), rules, 0, count)
        for mm in sizes
    ]


def near(obj, hands, rules, count=3):
    """A state whose hands have come in from their starts, so that every term is at work."""
    state = bimangrasp.prepared(obj, hands, starts(obj, hands, rules, count), rules, "cpu")
    for hand in state.ws.hands:
        at = hand.position.numpy()
        hand.position.assign(0.2 * at)
    return state


def evaluated(state, rules, index):
    for call in annealing.energy_calls(state, rules.energy, index):
        call()
    weights = np.array([getattr(rules.energy, n) for n in energies.Terms._fields])
    terms = state.terms.numpy().astype(np.float64)
    return terms, terms @ weights


def test_orthonormal_wrenches_have_the_least_closure_energy():
    assert energies.closure_energy(np.eye(6)) == pytest.approx(np.log(2) / 10)
    assert energies.wrench_volume_energy(np.eye(6)) == pytest.approx(1.0)


def test_the_sign_of_a_normal_changes_neither_closure_nor_volume():
    rng = np.random.default_rng(0)
    p, n = rng.normal(size=(2, 5, 8, 3))
    flipped = n * rng.choice([-1.0, 1.0], size=(5, 8, 1))
    for term in (energies.closure_energy, energies.wrench_volume_energy):
        both = [term(energies.normal_wrenches(p, m)) for m in (n, flipped)]
        np.testing.assert_allclose(*both, rtol=1e-12)


def test_kernels_agree_with_the_float64_reference(obj, hands):
    rules = config()
    state = near(obj, hands, rules)
    index = annealing.first_contacts(state, rules.energy)
    got, _ = evaluated(state, rules, index)
    ws, size = state.ws, SIZE_MM / 1000
    spheres = [hand.points.sphere.numpy().astype(np.float64) for hand in ws.hands]
    radius = [hand.sphere_radius for hand in hands]
    half = ws.contacts.centres.shape[1] // 2
    places = index.numpy() + np.repeat([0, half], rules.energy.contacts)
    contacts = np.take_along_axis(ws.contacts.centres.numpy(), places[..., None], axis=1)
    contacts = contacts.astype(np.float64)
    distance, slope = signed_distance(obj.sdf, size, contacts)
    on = contacts - (distance / np.linalg.norm(slope, axis=-1))[..., None] * slope
    normals = -surface_normal(obj.sdf, size, on, rules.energy.normal_step)
    G = energies.normal_wrenches(contacts, normals)
    points = state.points.numpy().astype(np.float64)
    body = ws.hands[1].points.contact.numpy()[:, state.candidates[1] :].astype(np.float64)
    pen = [energies.depth_in_spheres(points, s, r) for s, r in zip(spheres, radius, strict=True)]
    between = energies.depth_in_spheres(body, spheres[0], radius[0])
    reach = rules.energy.keypoint_reach
    own = [
        energies.keypoint_energy(s, hand.self_pairs, reach)
        for s, hand in zip(spheres, hands, strict=True)
    ]
    want = energies.Terms(
        fc=energies.closure_energy(G),
        dis=energies.distance_energy(distance),
        pen=sum(energies.penetration_energy(d) for d in pen),
        spen=sum(own) + energies.penetration_energy(between),
        joints=np.zeros(3),
        vew=energies.wrench_volume_energy(G),
    )
    assert want.pen.max() > 0
    np.testing.assert_allclose(got, np.stack(want, axis=1), rtol=FLOAT32, atol=1e-6)


@pytest.mark.parametrize("term", ["dis", "pen", "spen", "joints"])
def test_the_gradient_is_the_central_difference_in_random_directions(obj, hands, term):
    # Normals are held in the gradient of the other two, which are tested below.
    rules = config(*[f"energy.{n}={1.0 * (n == term)}" for n in energies.Terms._fields])
    state = near(obj, hands, rules)
    for hand in state.ws.hands:  # some joints beyond their limits
        hand.joints.assign(hand.joints.numpy() + 0.7)
    index = annealing.first_contacts(state, rules.energy)
    # A depth has a kink where its point comes in, or goes from one sphere to the next.
    close = []
    rng, step = np.random.default_rng(3), 3e-5
    for hand in state.ws.hands:
        evaluated(state, rules, index)
        gradient = hand.points.gradient.numpy().astype(np.float64).copy()
        position, rotation, joints = (
            a.numpy().copy() for a in (hand.position, hand.rotation, hand.joints)
        )
        for _ in range(3):
            along = rng.normal(size=gradient.shape[1])
            along[:6] *= 0.3
            found = []
            for sign in (1.0, -1.0):
                move = sign * step * along
                turn = rotation_of(move[3:6])
                hand.position.assign((position + move[:3]).astype(np.float32))
                hand.rotation.assign((turn @ rotation).astype(np.float32))
                hand.joints.assign((joints + move[6:]).astype(np.float32))
                found.append(evaluated(state, rules, index)[1])
            slope = (found[0] - found[1]) / (2 * step)
            close += np.isclose(gradient @ along, slope, rtol=SLOPE, atol=0.03).tolist()
        for array, old in ((hand.position, position), (hand.rotation, rotation)):
            array.assign(old)
        hand.joints.assign(joints)
    assert np.mean(close) >= (0.8 if term == "pen" else 1.0)


def rotation_of(vector):
    from bidexdata.frames import quat_from_rotation_vector

    return matrix_from_quat(quat_from_rotation_vector(vector))


def test_the_wrench_gradient_is_the_central_difference_with_normals_held():
    import warp as wp

    from bidexdata.devices import start_warp
    from bidexdata.synthesis.baselines.bimangrasp_kernels import wrench_terms

    start_warp()
    rng = np.random.default_rng(5)
    p, n = rng.normal(size=(2, 4, 8, 3))
    p, n = 0.1 * p, n / np.linalg.norm(n, axis=-1, keepdims=True)
    terms = wp.zeros((4, 6), dtype=float, device="cpu")
    gradient = wp.zeros((4, 8), dtype=wp.vec3, device="cpu")
    vectors = [wp.array(x.astype(np.float32), dtype=wp.vec3, device="cpu") for x in (p, n)]
    zero = wp.zeros((4, 8), dtype=float, device="cpu")
    still = wp.zeros((4, 8), dtype=wp.vec3, device="cpu")
    inputs = [1.0, 0.5, 0.0, *vectors, zero, still, terms, gradient]
    wp.launch(wrench_terms, dim=4, inputs=inputs, device="cpu")

    def energy(points):
        G = energies.normal_wrenches(points, n)
        return energies.closure_energy(G) + 0.5 * energies.wrench_volume_energy(G)

    along, step = rng.normal(size=p.shape), 1e-6
    slope = (energy(p + step * along) - energy(p - step * along)) / (2 * step)
    got = np.sum(gradient.numpy().astype(np.float64) * along, axis=(1, 2))
    np.testing.assert_allclose(got, slope, rtol=1e-3)


def test_annealing_lowers_the_energy_and_keeps_what_it_says(obj, hands):
    rules = config("annealing.steps=400")
    state = bimangrasp.prepared(obj, hands, starts(obj, hands, rules), rules, "cpu")
    index = annealing.first_contacts(state, rules.energy)
    before = evaluated(state, rules, index)[1]
    annealing.anneal(state, rules)
    kept, energy = state.kept_terms.numpy(), state.energy.numpy()
    weights = np.array([getattr(rules.energy, n) for n in energies.Terms._fields])
    np.testing.assert_allclose(kept @ weights, energy, rtol=1e-5)
    assert np.all(energy < 0.5 * before)
    # Contacts aside, the kept terms are those of the kept poses.
    again = evaluated(state, rules, index)[0]
    columns = [energies.Terms._fields.index(n) for n in ("pen", "spen", "joints")]
    np.testing.assert_allclose(again[:, columns], kept[:, columns], atol=1e-6)


def test_a_scene_does_not_depend_on_the_scenes_beside_it(obj, hands):
    rules = config()
    alone = bimangrasp.search(obj, hands, starts(obj, hands, rules), rules)
    both = starts(obj, hands, rules, sizes=(SIZE_MM, 500))
    beside = bimangrasp.search(obj, hands, both, rules)
    np.testing.assert_array_equal(alone.grasp.position, beside.grasp.position[:3])
    np.testing.assert_array_equal(alone.grasp.joints[1], beside.grasp.joints[1][:3])
    assert np.all(np.isfinite(beside.grasp.position))


@pytest.mark.parametrize("clamp", [True, False])
def test_joints_leave_their_limits_only_where_nothing_clamps_them(obj, hands, clamp):
    rules = config(f"annealing.clamp={str(clamp).lower()}", "annealing.steps=5")
    state = bimangrasp.prepared(obj, hands, starts(obj, hands, rules), rules, "cpu")
    annealing.anneal(state, rules)
    beyond = False
    for hand in state.ws.hands:
        u = hand.joints.numpy()
        low, high = hand.model.free_lower.numpy(), hand.model.free_upper.numpy()
        beyond |= bool(np.any((u < low) | (u > high)))
    assert beyond != clamp
    pose = read_pose(state.ws, hands)
    assert np.all(pose.joints[0] <= hands[0].joint_upper + 1e-6)


def test_hands_start_opposite_each_other_with_palms_within_the_cone(obj, hands):
    rules = BimanGraspConfig()
    (found,) = starts(obj, hands, rules, count=6)
    palm = [found.start.rotation[:, h] @ hand.T_hand_palm[:3, 2] for h, hand in enumerate(hands)]
    inward = [-found.start.position[:, h] for h in range(2)]
    for h in range(2):
        along = np.sum(palm[h] * inward[h], axis=1) / np.linalg.norm(inward[h], axis=1)
        assert np.all(along > 0.5)
    # Half a turn about z takes one hand's side to the other's.
    assert np.all(np.sum(inward[0][:, :2] * inward[1][:, :2], axis=1) < 0)
    scene = Scene(obj.object_id, SIZE_MM, "tabletop", 0)
    with pytest.raises(BadConfig, match="no table"):
        bimangrasp_starts.draw_starts(obj, hands, scene, rules, 0, 1)


def test_an_attempt_does_not_depend_on_how_many_follow_it(obj, hands):
    few, many = (starts(obj, hands, BimanGraspConfig(), n)[0].start for n in (2, 5))
    np.testing.assert_array_equal(few.position, many.position[:2])
    np.testing.assert_array_equal(few.joints[0], many.joints[0][:2])


def test_the_squeeze_is_as_far_beyond_the_grasp_as_the_pregrasp_is_before_it(obj, hands):
    rules = config()
    found = bimangrasp.search(obj, hands, starts(obj, hands, rules), rules)
    n = len(found.grasp.position)
    torques = [np.zeros((n, hand.coupling.shape[1])) for hand in hands]
    press = Press(torques, BaseGive(np.zeros((n, 2, 3)), np.zeros((n, 2, 3))))
    target = bimangrasp.aim(found, press, hands, rules)
    for h, hand in enumerate(hands):
        back = found.grasp.position[:, h] - found.pregrasp.position[:, h]
        palm = matrix_from_quat(found.grasp.quat_wxyz[:, h]) @ hand.T_hand_palm[:3, 2]
        np.testing.assert_allclose(back, 0.01 * palm, atol=1e-9)
        np.testing.assert_allclose(target.position[:, h] - found.grasp.position[:, h], back)
        closed = found.grasp.joints[h] - found.pregrasp.joints[h]
        sense = np.tile(closing_joints(hand, LEAST_CLOSING), (n, 1))
        np.testing.assert_allclose(closed, 0.1 * sense, atol=1e-9)
        np.testing.assert_allclose(target.joints[h] - found.grasp.joints[h], closed, atol=1e-9)


def test_flexion_closes_the_fingers_and_spreading_does_not(hands):
    for hand in hands:
        sense = dict(zip(hand.joint_names, closing_joints(hand, LEAST_CLOSING), strict=True))
        flexion = [n for n in sense if n[-3:] in {"FJ3", "FJ2", "FJ1"}]
        spreading = [n for n in sense if n[-4:] in {"FFJ4", "MFJ4", "RFJ4", "LFJ4"}]
        assert len(flexion) == 12
        assert all(sense[n] == 1.0 for n in flexion)
        assert all(sense[n] == 0.0 for n in spreading)


def test_candidates_lie_on_the_palmar_side_of_every_finger(hands):
    for hand in hands:
        found = contact_candidates(hand, 10)
        assert len(found.body) == 10 * 3 * len(hand.fingers)
        for c, body in enumerate(hand.contact_body[: hand.fingertips]):
            own = found.pos[found.body == body]
            assert len(own) == 10
            palmar = hand.contact_normal[c] * [1, 1, 0]
            assert np.mean(own @ palmar) > 0
