import dataclasses

import numpy as np
import pytest
from picture_samples import box_solid, grasps

from bidexdata.frames import matrix_from_quat, quat_angle, random_quat
from bidexdata.hands.kinematics import hand_points
from bidexdata.pictures.drawing import contact_parts, grasp_parts, hand_part, solid_parts
from bidexdata.pictures.picture import draw_grasp, draw_object, draw_stages
from bidexdata.pictures.posing import has_pose, moment_of, poses_at
from bidexdata.pictures.raycast import RayScene
from bidexdata.pictures.views import choose_views, side_direction

FLOAT32 = 1e-6  # poses are stored in single precision


@pytest.fixture(scope="module")
def solid():
    return box_solid("box0-00000000")


@pytest.fixture(scope="module")
def batch(hands, solid):
    return grasps(hands, solid)


def test_drawn_fingertips_are_where_forward_kinematics_puts_the_pads(hands, batch):
    for stage in range(3):
        poses = poses_at(batch, 0, stage)
        for h, hand in enumerate(hands):
            part = hand_part(hand, poses.pos[h], poses.quat_wxyz[h], poses.joints[h])
            tips = slice(hand.fingertips)
            points = hand_points(hand, poses.joints[h], poses.pos[h], poses.quat_wxyz[h])
            pads = points.contact[tips]
            gap = np.linalg.norm(part.vertices[None] - pads[:, None], axis=2).min(axis=1)
            # A drawn vertex lies within a fingertip's length of the middle of every pad ...
            assert np.all(gap < 0.02)
            # ... and nothing of the hand is farther from the wrist than a hand is long.
            assert np.linalg.norm(part.vertices - poses.pos[h], axis=1).max() < 0.3


def test_a_turned_and_shifted_hand_is_the_same_hand(hands):
    rng = np.random.default_rng(0)
    hand = hands[0]
    joints = hand.posture_curved
    home = hand_part(hand, np.zeros(3), (1, 0, 0, 0), joints)
    for q in [*random_quat(rng, (3,)), *np.eye(4)]:
        p = rng.normal(size=3)
        part = hand_part(hand, p, q, joints)
        assert np.allclose(part.vertices, home.vertices @ matrix_from_quat(q).T + p)


def test_an_object_is_drawn_at_its_size_and_pose(solid):
    rng = np.random.default_rng(1)
    pos, quat = rng.normal(size=3), random_quat(rng)
    for surface, count in (("mesh", 1), ("pieces", 2)):
        parts = solid_parts(solid, 0.4, pos, quat, surface=surface)
        assert len(parts) == count
        local = np.concatenate([(p.vertices - pos) @ matrix_from_quat(quat) for p in parts])
        assert np.linalg.norm(np.ptp(local, axis=0)) == pytest.approx(0.4)
    assert parts[0].colour != parts[1].colour


def test_a_grasp_shows_its_object_at_the_exact_size(batch, solid, hands):
    between = dataclasses.replace(
        batch, columns=batch.columns | {"size": batch.size * np.float32(1.001)}
    )
    for rows in (batch, between):
        drawn = next(p for p in grasp_parts(rows, 0, solid, hands) if p.label == "object")
        diagonal = np.linalg.norm(np.ptp(drawn.vertices, axis=0))
        assert diagonal == pytest.approx(float(rows.size[0]), rel=1e-5)


def test_contacts_are_marked_where_the_record_has_them(batch):
    parts = contact_parts(batch, 0)
    points = batch["contact_point"][0].reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    balls = np.array([p.vertices.mean(axis=0) for p in parts[::2]])
    assert np.allclose(balls, points, atol=1e-6)
    for point, shaft in zip(points, parts[1::2], strict=True):
        assert np.sign((shaft.vertices - point)[:, 0].sum()) == np.sign(point[0])  # outwards


def test_stages_are_the_stored_poses_exactly(batch):
    for number, name in enumerate(("pregrasp", "grasp", "squeeze")):
        for stage in (number, float(number), name):
            poses = poses_at(batch, 1, stage)
            assert np.array_equal(poses.pos, batch["hand_pos"][1, :, number])
            assert np.array_equal(poses.quat_wxyz, batch["hand_quat_wxyz"][1, :, number])
            assert np.array_equal(poses.joints, batch["joints"][1, :, number], equal_nan=True)


def test_between_stages_hands_move_evenly(batch):
    rng = np.random.default_rng(2)
    quats = random_quat(rng, (len(batch), 2, 3)).astype(np.float32)
    turned = dataclasses.replace(batch, columns={**batch.columns, "hand_quat_wxyz": quats})
    a, b = poses_at(turned, 2, 1), poses_at(turned, 2, 2)
    for t in (0.25, 0.5, 0.9):
        poses = poses_at(turned, 2, 1 + t)
        assert np.allclose(poses.pos, (1 - t) * a.pos + t * b.pos)
        assert np.allclose(poses.joints, (1 - t) * a.joints + t * b.joints, equal_nan=True)
        whole = quat_angle(a.quat_wxyz, b.quat_wxyz)
        # Stored quaternions are unit to single precision only.
        assert np.allclose(quat_angle(a.quat_wxyz, poses.quat_wxyz), t * whole, atol=1e-3)


@pytest.mark.parametrize("moment", [-0.1, 2.1, float("nan")])
def test_there_is_no_stage_outside(moment):
    with pytest.raises(ValueError, match="stage"):
        moment_of(moment)


def test_a_failed_attempt_shows_the_object_alone(batch, solid, hands):
    last = len(batch) - 1
    assert not has_pose(batch, last)
    parts = grasp_parts(batch, last, solid, hands)
    assert {p.label for p in parts} == {"object"}
    assert draw_grasp(batch, last, solid, hands, width=40, height=30).shape == (30, 40, 3)


def test_a_table_is_drawn_under_a_tabletop_scene_only(batch, solid, hands):
    on_table = dataclasses.replace(
        batch, columns={**batch.columns, "setting": np.array(["tabletop"] * len(batch))}
    )
    assert "ground" not in {p.label for p in grasp_parts(batch, 0, solid, hands)}
    ground = [p for p in grasp_parts(on_table, 0, solid, hands) if p.label == "ground"]
    assert len(ground) == 1
    assert np.all(ground[0].vertices[:, 2] == 0)


def test_both_hands_are_seen_on_opposite_sides(batch, solid, hands):
    parts = grasp_parts(batch, 0, solid, hands)
    scene = RayScene(parts)
    first, second = choose_views(parts, scene, 2)
    assert first @ second < np.cos(np.radians(60)) + 1e-9
    pixels = draw_grasp(batch, 0, solid, hands, width=120, height=90).astype(int)
    r, g, b = pixels[..., 0], pixels[..., 1], pixels[..., 2]
    blue, green = (b > g + 30) & (b > r + 30), (g > r + 30) & (g > b + 15)
    assert blue.sum() > 100
    assert green.sum() > 100
    left, right = np.nonzero(blue)[1].mean(), np.nonzero(green)[1].mean()
    assert abs(left - right) > 40


def test_one_hand_and_its_object_are_both_seen_on_opposite_sides(solid, hands):
    batch = grasps(hands[1:], solid)
    for row in range(len(batch) - 1):
        parts = grasp_parts(batch, row, solid, hands[1:])
        assert {p.label for p in parts} >= {"object", "right"}
        hand, whole = (next(p for p in parts if p.label == x) for x in ("right", "object"))
        across = hand.vertices.mean(axis=0) - whole.vertices.mean(axis=0)
        (direction,) = choose_views(parts, RayScene(parts), 1)
        assert abs(direction @ across) / np.linalg.norm(across) < 0.5
        pixels = draw_grasp(batch, row, solid, hands[1:], width=120, height=90, contacts=False)
        r, g, b = (pixels[..., k].astype(int) for k in range(3))
        green, sand = (g > r + 30) & (g > b + 15), (r > g + 10) & (g > b + 25)
        assert green.sum() > 300
        assert sand.sum() > 300
    frames = draw_stages(batch, 0, solid, hands[1:], ("pregrasp", "squeeze"), width=60, height=48)
    assert (frames[0] != frames[1]).any()


def test_the_side_direction_is_across_the_hands_and_always_defined():
    rng = np.random.default_rng(3)
    pairs = [*rng.normal(size=(20, 2, 3)), np.array([[0, 0, 1], [0, 0, -1]]), np.zeros((2, 3))]
    for pair in pairs:
        direction = side_direction(list(pair.astype(float)))
        assert np.linalg.norm(direction) == pytest.approx(1)
        assert abs(direction @ (pair[1] - pair[0])) < 1e-9
    assert np.linalg.norm(side_direction([])) == pytest.approx(1)


def test_stages_of_one_grasp_differ_and_the_camera_stands_still(batch, solid, hands):
    frames = draw_stages(
        batch, 0, solid, hands, ("pregrasp", "grasp", "grasp"), width=60, height=48
    )
    assert np.array_equal(frames[1], frames[2])
    changed = np.any(frames[0] != frames[1], axis=2)
    assert 0.02 < changed.mean() < 0.6  # hands move, background and object stay


def test_an_object_is_drawn_as_mesh_beside_pieces(solid):
    pixels = draw_object(solid, width=50, height=40)
    assert pixels.shape == (40, 104, 3)
    assert not np.array_equal(pixels[:, :50], pixels[:, 54:])
