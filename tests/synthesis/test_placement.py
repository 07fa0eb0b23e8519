"""Laws of the starts: palms face the object, nothing touches, mirrored draws give mirrored hands."""

from dataclasses import replace

import numpy as np
import pytest
from made_objects import ball_object, box_object

from bidexdata import frames
from bidexdata.errors import BadConfig
from bidexdata.hands.kinematics import hand_points
from bidexdata.objects.distance_field import signed_distance
from bidexdata.record.scene import Scene
from bidexdata.synthesis.placement import PlacementConfig, hang_hand, place_palms, scaled_variation
from bidexdata.synthesis.placement_shapes import start_shapes, tangent_frames
from bidexdata.synthesis.regions import RegionConfig, select_region_pairs
from bidexdata.synthesis.regions_build import hull_depth, hull_planes

CONFIG = PlacementConfig()
BOX = box_object()
BALL = ball_object()
# The grid's trilinear error at a box's edges: half a cell of 2.5 % of the diagonal.
GRID = 0.0125


def start(obj, hands, size_mm=500, count=30, config=CONFIG, seed=1, **options):
    scene = Scene("made-00000000", size_mm, **options)
    pairs = select_region_pairs(obj, scene, RegionConfig(), np.random.default_rng(0))
    return (
        scene,
        pairs,
        place_palms(obj, hands, scene, pairs, config, np.random.default_rng(seed), count),
    )


def points_of(hand, placed, h):
    return hand_points(hand, placed.joints[:, h], placed.hand_pos[:, h], placed.hand_quat[:, h])


@pytest.mark.parametrize("obj", [BOX, BALL], ids=["box", "ball"])
@pytest.mark.parametrize("size_mm", [300, 500, 800])
def test_no_start_touches_the_object(hands, obj, size_mm):
    _, _, placed = start(obj, hands, size_mm)
    size = size_mm / 1000
    planes, offsets = hull_planes(obj)
    assert placed.ok.mean() > 0.9
    for h, hand in enumerate(hands):
        p = points_of(hand, placed, h)
        # Outside the hull's nearest plane by the clearance; the contact spheres by the stand-off.
        out = (p.sphere @ planes.T - size * offsets).max(axis=-1) - hand.sphere_radius
        assert out.min() > CONFIG.clearance - 1e-9
        tips = (p.contact @ planes.T - size * offsets).max(axis=-1) - hand.contact_radius
        assert tips.min() > CONFIG.standoff - 1e-9
        near = p.sphere[np.linalg.norm(p.sphere, axis=-1) < 0.59 * size] / size
        assert signed_distance(obj.sdf, size, near * size)[0].min() > -GRID * size


def test_palms_face_the_hull_point_nearest_to_their_region(hands):
    _, pairs, placed = start(BOX, hands)
    for h, hand in enumerate(hands):
        _, normal = hull_depth(BOX, 0.5, pairs.centres[placed.pair_index, h])
        R = frames.matrix_from_quat(placed.hand_quat[:, h])
        palm = R @ hand.T_hand_palm[:3, 2]
        assert np.einsum("ni,ni->n", palm, -normal).min() >= np.cos(CONFIG.tilt) - 1e-9


def test_without_tilt_and_shift_the_lowest_tip_hangs_at_the_stand_off_over_the_hull_point(hands):
    config = PlacementConfig(tilt=0.0, shift=0.0)
    _, pairs, placed = start(BOX, hands, config=config)
    for h, hand in enumerate(hands):
        centre = pairs.centres[placed.pair_index, h]
        depth, normal = hull_depth(BOX, 0.5, centre)
        over = centre + depth[:, None] * normal
        p = points_of(hand, placed, h)
        middle = p.contact.mean(axis=1) - over
        middle -= np.einsum("ni,ni->n", middle, normal)[:, None] * normal
        assert np.abs(middle).max() < 1e-9
        height = np.einsum("nci,ni->nc", p.contact - over[:, None], normal) - hand.contact_radius
        ball = np.einsum("nki,ni->nk", p.sphere - over[:, None], normal) - hand.sphere_radius
        lift = np.minimum(height.min(axis=1) - config.standoff, ball.min(axis=1) - config.clearance)
        assert np.allclose(lift, 0.0, atol=1e-9)


@pytest.mark.parametrize("size_mm", [150, 300])
def test_accepted_hands_are_clear_of_each_other(hands, size_mm):
    _, _, placed = start(BOX, hands, size_mm, count=60)
    a, b = (points_of(hand, placed, h).sphere for h, hand in enumerate(hands))
    gap = np.linalg.norm(a[:, :, None] - b[:, None], axis=-1)
    gap -= hands[0].sphere_radius[:, None] + hands[1].sphere_radius
    clear = gap.min(axis=(1, 2)) >= CONFIG.clearance - 1e-9
    # Not only accepted hands are clear: the last draw of a refused attempt is not.
    assert np.array_equal(clear, placed.ok)


def test_where_the_object_is_changes_nothing_of_its_starts(hands):
    # They are seen from it. Sides are by world y, roll by world directions: a shift keeps both.
    _, _, here = start(BOX, hands)
    _, _, there = start(BOX, hands, object_pos=(0.3, -0.2, 0.7))
    assert np.array_equal(there.hand_pos, here.hand_pos)
    assert np.array_equal(there.hand_quat, here.hand_quat)


def test_starts_follow_from_the_seed_and_do_not_depend_on_how_many_follow(hands):
    _, _, a = start(BOX, hands, count=12)
    _, _, b = start(BOX, hands, count=12)
    _, _, more = start(BOX, hands, count=30)
    _, _, other = start(BOX, hands, count=12, seed=2)
    for x, y, z in zip(a, b, more, strict=True):
        assert np.array_equal(x, y)
        assert np.array_equal(x, z[:12])
    assert not np.array_equal(a.hand_quat, other.hand_quat)


def test_attempts_take_the_best_pairs_in_turn(hands):
    config = replace(CONFIG, pairs=4)
    _, _, placed = start(BOX, hands, count=10, config=config)
    assert placed.pair_index.tolist() == [0, 1, 2, 3, 0, 1, 2, 3, 0, 1]
    assert not np.allclose(placed.hand_quat[0], placed.hand_quat[4])


def test_later_attempts_of_a_pair_hang_within_its_regions(hands):
    """On a box, whose hull normals are the axes: sideways by no more than the region's radius."""
    config = replace(CONFIG, pairs=4, repeats="region", over="palm", tilt=0.0, shift=0.0, draws=1)
    _, pairs, placed = start(BOX, hands, count=40, config=config)
    _, _, fewer = start(BOX, hands, count=9, config=config)
    assert np.array_equal(placed.hand_pos[:9], fewer.hand_pos)
    for h, hand in enumerate(hands):
        R = frames.matrix_from_quat(placed.hand_quat[:, h])
        palm = placed.hand_pos[:, h] + R @ hand.T_hand_palm[:3, 3]
        away = palm - pairs.centres[placed.pair_index, h]
        normal = R @ hand.T_hand_palm[:3, 2]
        away -= np.einsum("ni,ni->n", away, normal)[:, None] * normal
        sideways = np.linalg.norm(away, axis=1)
        assert np.all(sideways[:4] < 1e-9)
        assert np.all(sideways[4:] > 1e-4)
        # Regions at an edge reach over it, so the palm may hang over the next face's plane.
        assert np.all(sideways < RegionConfig().radius + 1e-9)
        assert np.median(sideways[4:]) > 0.01


def test_flat_regions_start_open_and_curved_ones_curved(hands):
    for obj, flat in ((BALL, 0.0), (BOX, 2.0)):
        _, _, placed = start(obj, hands, count=8, config=replace(CONFIG, flat=flat))
        for h, hand in enumerate(hands):
            posture = hand.posture_open if flat else hand.posture_curved
            assert np.array_equal(placed.joints[:, h], np.tile(posture, (8, 1)))


def test_mirrored_draws_give_mirrored_hands(hands):
    # The same numbers on a region and on its mirror image across y = 0, one hand each.
    rng = np.random.default_rng(4)
    mirror = np.array([1.0, -1.0, 1.0])
    over = rng.standard_normal((20, 3))
    normal = rng.standard_normal((20, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    lots = rng.random((20, 5))
    flat = np.arange(20) % 2 == 0
    direction = np.array(CONFIG.right_direction) / np.sqrt(3)
    poses = []
    for h, sign in ((0, mirror), (1, np.ones(3))):
        poses.append(
            hang_hand(
                start_shapes(hands[h], "contacts"), flat, over * sign, normal * sign,
                direction * sign, scaled_variation(lots, CONFIG, mirrored=h == 0), CONFIG,
            )
        )  # fmt: skip
    (_, R_left, _), (_, R_right, _) = poses
    shapes = [start_shapes(hand, "contacts") for hand in hands]
    for left, right in zip(*shapes, strict=True):
        assert np.allclose(left.contacts, right.contacts * mirror, atol=1e-6)
    palm = [R @ hand.T_hand_palm[:3, :3] for R, hand in zip((R_left, R_right), hands, strict=True)]
    assert np.allclose(palm[0], mirror[:, None] * palm[1] * mirror, atol=1e-6)
    origin = [p + R @ hand.T_hand_palm[:3, 3] for (p, R, _), hand in zip(poses, hands, strict=True)]
    assert np.allclose(origin[0], origin[1] * mirror, atol=1e-6)


def test_without_roll_the_fingers_point_as_near_the_preferred_direction_as_they_can(hands):
    config = PlacementConfig(roll=0.0, tilt=0.0)
    _, pairs, placed = start(BALL, hands, config=config)
    for h, direction in ((0, config.left_direction), (1, config.right_direction)):
        wish = np.array(direction) / np.linalg.norm(direction)
        _, normal = hull_depth(BALL, 0.5, pairs.centres[placed.pair_index, h])
        R = frames.matrix_from_quat(placed.hand_quat[:, h])
        fingers = R @ hands[h].T_hand_palm[:3, 0]
        best = np.sqrt(1 - (normal @ wish) ** 2)
        assert np.allclose(fingers @ wish, best, atol=1e-9)


@pytest.mark.parametrize("z", [[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [0.6, 0, 0.8]])
def test_tangent_frames_exist_for_every_direction(z):
    z = np.array([z])
    for direction in (np.array([0, 0, 1.0]), np.array([1.0, 0, 0]), z[0]):
        R = tangent_frames(z, direction)
        assert np.allclose(R[0].T @ R[0], np.eye(3), atol=1e-12)
        assert np.linalg.det(R[0]) == pytest.approx(1.0)
        assert np.allclose(R[0][:, 2], z[0])


def test_impossible_numbers_are_refused_by_name():
    with pytest.raises(BadConfig, match=r"PlacementConfig\.tilt"):
        PlacementConfig(tilt=2.0)
    with pytest.raises(BadConfig, match=r"PlacementConfig\.left_direction"):
        PlacementConfig(left_direction=(0.0, 0.0, 0.0))
