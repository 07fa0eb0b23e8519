"""Laws of the table: what lies under it is not grasped, and no hand of a kept grasp reaches in."""

from dataclasses import replace

import numpy as np
import pytest
from made_objects import ball_object, box_object

from bidexdata import frames
from bidexdata.config import with_overrides
from bidexdata.hands.kinematics import hand_points
from bidexdata.pictures.drawing import hand_part
from bidexdata.record import Scene, Status
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.pipeline import synthesize
from bidexdata.synthesis.placement import PlacementConfig, place_palms
from bidexdata.synthesis.placement_shapes import roll_from_down, tangent_frames
from bidexdata.synthesis.regions import RegionConfig, select_region_pairs
from bidexdata.synthesis.regions_build import hull_depth, hull_planes
from bidexdata.synthesis.table import raise_hands, reachable_regions, table_plane, touchable_points

REGIONS, PLACEMENT = RegionConfig(), PlacementConfig()
OBJECTS = {"box": box_object(), "ball": ball_object(), "plate": box_object((1.0, 0.8, 0.1))}
# Positions are float32 of metres up to one in regions and rows.
F32 = 1e-6
# The rounded ends of a drawn hand lie up to this much inside the true ones [m].
FACETS = 1e-3


def on_table(obj, size_mm=400, quat=(1.0, 0.0, 0.0, 0.0)):
    """The object with its lowest point on the table, turned as given."""
    turned = obj.solid.vertices @ frames.matrix_from_quat(np.array(quat)).T
    height = -float(turned[:, 2].min()) * size_mm / 1000
    return Scene(obj.object_id, size_mm, "tabletop", 0, (0.0, 0.0, height), tuple(quat))


def in_world(scene, points):
    turn = frames.matrix_from_quat(np.array(scene.object_quat_wxyz))
    return points @ turn.T + np.array(scene.object_pos)


def pairs_of(obj, scene, config=REGIONS):
    return select_region_pairs(obj, scene, config, np.random.default_rng(0))


def start(obj, hands, scene, config=PLACEMENT, count=30):
    """Starts as `place_palms` gives them, moved from the object frame to the world."""
    pairs = pairs_of(obj, scene)
    placed = place_palms(obj, hands, scene, pairs, config, np.random.default_rng(1), count)
    quat = frames.quat_multiply(np.array(scene.object_quat_wxyz), placed.hand_quat)
    return pairs, placed._replace(hand_pos=in_world(scene, placed.hand_pos), hand_quat=quat)


def points_of(hand, placed, h):
    return hand_points(hand, placed.joints[:, h], placed.hand_pos[:, h], placed.hand_quat[:, h])


@pytest.mark.parametrize("quat", [*np.eye(4), *frames.random_quat(np.random.default_rng(0), (4,))])
def test_the_tables_plane_is_the_worlds_ground_seen_from_the_object(quat):
    box = OBJECTS["box"]
    scene = on_table(box, 500, tuple(float(x) for x in quat))
    plane = table_plane(scene)
    assert np.linalg.norm(plane[:3]) == pytest.approx(1.0)
    corners = 0.5 * box.solid.vertices
    np.testing.assert_allclose(corners @ plane[:3] + plane[3], in_world(scene, corners)[:, 2])
    assert (corners @ plane[:3] + plane[3]).min() == pytest.approx(0.0, abs=1e-12)
    assert not table_plane(Scene("o", 500)).any()


def test_a_ball_touches_a_point_above_the_table_where_geometry_says_so():
    # Heights at which a ball of radius 1 fits: on top always, at a side 1, underneath 2.
    normals = np.array([[0, 0, 1.0], [1.0, 0, 0], [0, 0, -1.0]])
    plane = np.array([0, 0, 1.0, 0])
    for height, fits in ((0.01, [1, 0, 0]), (1.01, [1, 1, 0]), (2.01, [1, 1, 1])):
        points = np.tile([0.0, 0.0, height], (3, 1))
        assert touchable_points(points, normals, plane, 1.0).tolist() == [bool(f) for f in fits]
        assert reachable_regions(points, normals, plane, 1.5).tolist() == [
            True,
            True,
            height > 1.5,
        ]


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("score", ["random", "force", "torque"])
def test_no_region_reaches_where_the_table_leaves_no_room(name, score):
    obj = OBJECTS[name]
    scene = on_table(obj)
    pairs = pairs_of(obj, scene, replace(REGIONS, score=score))
    assert len(pairs.score)
    tip = REGIONS.table_fingertip
    balls = in_world(scene, (pairs.points + tip * pairs.normals).reshape(-1, 3))
    assert balls[:, 2].min() >= tip - F32
    _, normal = hull_depth(obj, scene.size, pairs.centres.reshape(-1, 3))
    palms = in_world(scene, pairs.centres.reshape(-1, 3) + REGIONS.table_reach * normal)
    assert palms[:, 2].min() >= -F32
    # The anchors are still numbers of the object's own points.
    assert np.array_equal(
        obj.surface_points[pairs.anchors] * np.float32(scene.size), pairs.centres.astype(np.float32)
    )


def test_an_object_as_flat_as_a_fingertip_has_regions_on_top_only():
    sheet = box_object((1.0, 0.8, 0.01))
    pairs = pairs_of(sheet, on_table(sheet))
    assert np.all(pairs.mean_normals[..., 2] > 0.9)


@pytest.mark.parametrize("score", ["random", "force", "torque"])
def test_an_object_that_no_fingertip_can_touch_has_no_pairs(score):
    config = replace(REGIONS, score=score, table_fingertip=0.1, table_reach=1.0)
    upside_down = ball_object(points=40)
    below = Scene("made-00000000", 50, "tabletop", 0, (0.0, 0.0, -0.5))
    assert len(pairs_of(upside_down, below, config).score) == 0


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("size_mm", [300, 800])
def test_starts_on_a_table_are_above_it_and_clear_of_the_object(hands, name, size_mm):
    obj = OBJECTS[name]
    scene = on_table(obj, size_mm)
    _, placed = start(obj, hands, scene)
    assert placed.ok.mean() > 0.8
    planes, offsets = hull_planes(obj)
    for h, hand in enumerate(hands):
        balls = points_of(hand, placed, h).sphere[placed.ok]
        assert (balls[..., 2] - hand.sphere_radius).min() >= PLACEMENT.clearance - 1e-9
        local = (balls - np.array(scene.object_pos)) @ planes.T - scene.size * offsets
        assert (local.max(axis=-1) - hand.sphere_radius).min() >= PLACEMENT.clearance - 1e-9


def test_without_raising_low_objects_lose_starts_and_none_is_in_the_table(hands):
    box = OBJECTS["box"]
    scene = on_table(box, 200)
    _, placed = start(box, hands, scene, replace(PLACEMENT, table_raise=0.0, draws=1))
    _, raised = start(box, hands, scene, replace(PLACEMENT, draws=1))
    assert placed.ok.sum() < raised.ok.sum()
    for h, hand in enumerate(hands):
        lowest = (points_of(hand, placed, h).sphere[..., 2] - hand.sphere_radius).min(axis=1)
        assert np.all(lowest[placed.ok] >= PLACEMENT.clearance - 1e-9)
        # A hand that clears the table is not moved.
        was, now = placed.hand_pos[placed.ok, h], raised.hand_pos[placed.ok, h]
        assert np.array_equal(was, now)


def test_fingers_of_palms_that_face_sideways_point_down(hands):
    ball = OBJECTS["ball"]
    scene = on_table(ball)
    config = replace(PLACEMENT, tilt=0.0, table_roll=0.4)
    pairs, placed = start(ball, hands, scene, config)
    for h, hand in enumerate(hands):
        _, normal = hull_depth(ball, scene.size, pairs.centres[placed.pair_index, h])
        R = frames.matrix_from_quat(placed.hand_quat[:, h]) @ hand.T_hand_palm[:3, :3]
        sideways = np.abs(normal[:, 2]) < 0.86
        assert sideways.sum() > 5
        # Nearest to straight down that a finger across this normal can be, up to the roll.
        down = np.arccos(np.clip(-R[:, 2, 0] / np.sqrt(1 - normal[:, 2] ** 2), -1, 1))
        assert down[sideways].max() <= config.table_roll + 1e-6
    # As the paper has it, the table changes no direction.
    paper = replace(PLACEMENT, table_fingers="preferred", roll=0.0, tilt=0.0)
    pairs, placed = start(ball, hands, scene, paper)
    for h, direction in ((0, paper.left_direction), (1, paper.right_direction)):
        wish = np.array(direction) / np.linalg.norm(direction)
        _, normal = hull_depth(ball, scene.size, pairs.centres[placed.pair_index, h])
        R = frames.matrix_from_quat(placed.hand_quat[:, h])
        fingers = R @ hands[h].T_hand_palm[:3, 0]
        assert np.allclose(fingers @ wish, np.sqrt(1 - (normal @ wish) ** 2), atol=1e-9)


def test_mirrored_hands_roll_and_rise_mirrored():
    rng = np.random.default_rng(3)
    mirror = np.array([1.0, -1.0, 1.0])
    normal = rng.standard_normal((40, 3))
    normal[:3] = [[0, 0, 1.0], [1.0, 0, 0], [0.6, 0.8, 0]]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    direction, down = np.array([1.0, 1.0, -1.0]) / np.sqrt(3), np.array([0, 0, -1.0])
    turn, roll = rng.uniform(-1, 1, (2, 40))
    right = roll_from_down(turn, roll, normal, direction, down)
    left = roll_from_down(-turn, -roll, normal * mirror, direction * mirror, down)
    assert np.allclose(np.cos(left), np.cos(right), atol=1e-9)
    assert np.allclose(np.sin(left), -np.sin(right), atol=1e-9)
    # The turn that it gives brings the fingers to where it says.
    palm = tangent_frames(-normal, direction)
    straight = roll_from_down(np.zeros(40), roll, normal, direction, down)
    fingers = np.cos(straight)[:, None] * palm[:, :, 0] + np.sin(straight)[:, None] * palm[:, :, 1]
    sideways = np.abs(normal[:, 2]) < 0.87
    assert np.allclose(-fingers[sideways, 2], np.sqrt(1 - normal[sideways, 2] ** 2), atol=1e-9)

    spheres = rng.uniform(-0.1, 0.1, (40, 7, 3))
    plane, radius = np.array([0, 0, 1.0, 0.02]), np.full(7, 0.01)
    one = raise_hands(spheres, radius, normal, plane, 0.005, 0.06)
    two = raise_hands(spheres * mirror, radius, normal * mirror, plane, 0.005, 0.06)
    assert np.array_equal(one.ok, two.ok)
    assert np.allclose(one.shift * mirror, two.shift, atol=1e-12)
    assert 0 < one.ok.sum() < 40
    # Raised hands just clear the table and stay at their distance from the hull.
    assert np.allclose(np.sum(one.shift * normal, axis=1), 0.0, atol=1e-12)
    lowest = ((spheres + one.shift[:, None]) @ plane[:3] + plane[3] - radius).min(axis=1)
    moved = np.linalg.norm(one.shift, axis=1) > 0
    assert np.allclose(lowest[moved], 0.005, atol=1e-9)
    assert np.linalg.norm(one.shift, axis=1).max() <= 0.06


@pytest.mark.parametrize("limit", [0.05, 1e-5])
def test_no_accepted_grasp_has_a_hand_deeper_in_the_table_than_the_limit_at_any_stage(hands, limit):
    plate = OBJECTS["plate"]
    config = with_overrides(SynthConfig(), [f"selection.table_depth={limit}"])
    made = synthesize(plate, hands, [on_table(plate, 200)], config, seed=2, grasps=6)
    counts = made.header.counts["made-00000000/200/table0"]
    ok = np.flatnonzero(made["synth_status"] == Status.OK)
    assert len(ok)
    assert ("table_penetration" in counts) == (limit < 0.001)
    for row in ok:
        for stage in range(3):
            for h, hand in enumerate(hands):
                pose = (made[n][row, h, stage] for n in ("hand_pos", "hand_quat_wxyz", "joints"))
                assert hand_part(hand, *pose).vertices[:, 2].min() > -limit - FACETS
