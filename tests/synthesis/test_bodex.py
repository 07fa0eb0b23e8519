"""Laws of the baseline `bodex`: starts on the hull, its step rule, its three stages."""

import numpy as np
import pytest
from made_objects import box_object

from bidexdata.config import with_overrides
from bidexdata.devices import start_warp
from bidexdata.hands.kinematics import hand_points
from bidexdata.record import Scene, Status
from bidexdata.synthesis.baselines import bodex, bodex_starts
from bidexdata.synthesis.baselines.bodex_config import BodexConfig
from bidexdata.synthesis.baselines.hull_points import along_normals, hull_points
from bidexdata.synthesis.pipeline import synthesize

SIZE_MM = 300


@pytest.fixture(scope="module")
def obj():
    return box_object()


def draw(obj, hands, count=6, setting="floating", config=None):
    height = 0.2 if setting == "tabletop" else 0.0
    scene = Scene(obj.object_id, SIZE_MM, setting, object_pos=(0.0, 0.0, height))
    return bodex_starts.draw_starts(obj, hands, scene, config or BodexConfig(), 0, count)


def test_hull_points_lie_a_dilation_off_the_faces_of_a_box(obj):
    size, way = 0.3, 0.1
    half = size * np.abs(obj.hull.vertices).max(axis=0)
    found = hull_points(along_normals(obj, size, way), 128, np.random.default_rng(0))
    beyond = np.max(np.abs(found.points) - half, axis=1)
    assert len(found.points) == 128
    assert np.all(beyond <= way + 1e-6)
    on_face = np.abs(found.normals).max(axis=1) > 1 - 1e-6  # the others lie on chamfers
    assert np.mean(on_face) > 0.2
    np.testing.assert_allclose(beyond[on_face], way, atol=1e-6)
    assert np.all(np.sum(found.normals * found.points, axis=1) > 0)


def test_palms_face_the_object_within_the_tilts(obj, hands):
    config = with_overrides(BodexConfig(), ["starts.tilt=0.0"])
    for h, hand in enumerate(hands):
        start = draw(obj, hands, config=config).start
        palm = start.rotation[:, h] @ hand.T_hand_palm[:3, 2]
        fingers = start.rotation[:, h] @ hand.T_hand_palm[:3, 0]
        over = start.position[:, h] + config.starts.ahead * fingers
        # From what lies at the hull point, straight on along the palm's normal, is the object.
        assert np.all(np.sum(palm * over, axis=1) < 0)
        np.testing.assert_allclose(np.linalg.det(start.rotation[:, h]), 1.0, atol=1e-9)


def test_hands_start_apart_and_above_the_table(obj, hands):
    found = draw(obj, hands, setting="tabletop")
    assert np.any(found.status == Status.OK)
    clearance = BodexConfig().starts.clearance
    spheres = []
    for h, hand in enumerate(hands):
        local = hand_points(hand, found.start.joints[h]).sphere
        R, p = found.start.rotation[:, h], found.start.position[:, h]
        spheres.append(np.einsum("nij,nkj->nki", R, local) + p[:, None])
        height = spheres[h] @ found.start.plane[0, :3] + found.start.plane[0, 3]
        assert np.min(height - hand.sphere_radius) >= clearance
    gap = np.linalg.norm(spheres[0][:, :, None] - spheres[1][:, None], axis=-1)
    gap -= hands[0].sphere_radius[:, None] + hands[1].sphere_radius
    assert gap.min() >= clearance - 1e-9


def test_an_attempt_does_not_depend_on_how_many_follow_it(obj, hands):
    few, many = draw(obj, hands, 2), draw(obj, hands, 6)
    np.testing.assert_array_equal(few.start.position, many.start.position[:2])


def test_the_start_posture_is_read_by_name_and_kept_within_limits(hands):
    for hand in hands:
        q = bodex_starts.posture(hand, {"THJ4": 1.2, "FFJ3": 99.0})
        named = dict(zip((n.rsplit("_", 1)[-1] for n in hand.joint_names), q, strict=True))
        assert named["THJ4"] == pytest.approx(1.2)
        assert np.all((q >= hand.joint_lower) & (q <= hand.joint_upper))


def test_a_step_has_half_its_length_at_first_whatever_the_gradient(hands):
    import warp as wp

    from bidexdata.synthesis.baselines.bodex_kernels import normalised_step

    start_warp()
    rng = np.random.default_rng(0)
    free = hands[0].coupling.shape[1]
    group = bodex.variable_groups(hands[0])
    assert len(set(group.tolist())) == 5
    gradient = rng.normal(size=(3, 6 + free)) * np.array([1e-6, 1.0, 1e6])[:, None]
    joints = wp.zeros((3, free), dtype=float, device="cpu")
    wide = [wp.array(np.full(free, v, np.float32), device="cpu") for v in (-9.0, 9.0)]
    position = wp.zeros(3, dtype=wp.vec3, device="cpu")
    rotation = wp.array(np.tile(np.eye(3, dtype=np.float32), (3, 1, 1)), dtype=wp.mat33)
    velocity = wp.zeros((3, 6 + free), dtype=float, device="cpu")
    given = wp.array(gradient.astype(np.float32), dtype=float, device="cpu")
    inputs = [*wide, wp.array(group, dtype=int, device="cpu"), 0.9, 0.001, 0.02, 0.01, 1.0]
    wp.launch(
        normalised_step,
        dim=3,
        inputs=[*inputs, given, velocity, position, rotation, joints],
        device="cpu",
    )
    moved = position.numpy()
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 0.0005, rtol=1e-4)
    assert np.all(np.sum(moved * gradient[:, :3], axis=1) < 0)
    angle = np.arccos(np.clip((np.trace(rotation.numpy(), axis1=1, axis2=2) - 1) / 2, -1, 1))
    np.testing.assert_allclose(angle, 0.01, rtol=1e-2)
    for finger in range(5):
        way = np.linalg.norm(joints.numpy()[:, group == finger], axis=1)
        np.testing.assert_allclose(way, 0.005, rtol=1e-4)


def test_the_pregrasp_is_a_centimetre_off_and_the_squeeze_leaves_the_base(obj, hands):
    found = synthesize(obj, hands, [Scene(obj.object_id, SIZE_MM)], BodexConfig(), grasps=4)
    assert len(found) == 4
    assert np.all(found["selected"] & found["audit"])
    for h, hand in enumerate(hands):
        gaps = []
        for stage in range(2):
            pads = hand_points(
                hand,
                found["joints"][:, h, stage, : len(hand.joint_names)],
                found["hand_pos"][:, h, stage].astype(np.float64),
                found["hand_quat_wxyz"][:, h, stage].astype(np.float64),
            ).contact[:, : hand.fingertips]
            points = found["contact_point"][:, h, : hand.fingertips]
            off = np.linalg.norm(pads - points, axis=-1)
            gaps.append(np.median(off - hand.contact_radius[: hand.fingertips]))
        assert gaps[0] == pytest.approx(0.010, abs=0.003)
        assert gaps[1] == pytest.approx(0.0, abs=0.003)
        np.testing.assert_array_equal(found["hand_pos"][:, h, 2], found["hand_pos"][:, h, 1])
        q = found["joints"][:, h]
        np.testing.assert_allclose(q[:, 2], 2 * q[:, 1] - q[:, 0], atol=1e-5)
    assert np.all(found["region_id"] == -1)


def test_margins_are_the_peers_per_kind_of_sphere(obj, hands):
    from bidexdata.synthesis.workspace import allocate

    config, start = BodexConfig(), draw(obj, hands, 1).start
    ws = allocate(obj, hands, start, np.ones(1))
    contacts = len(hands[0].contact_body)
    for distance, touching, other in ((0.01, 0.008, 0.01), (0.0, -0.002, 0.002)):
        (left, _) = bodex.sphere_reach(ws, config, distance)
        margin = left.numpy() - hands[0].sphere_radius
        np.testing.assert_allclose(margin[:contacts], touching, atol=1e-6)
        np.testing.assert_allclose(margin[contacts:], other, atol=1e-6)
