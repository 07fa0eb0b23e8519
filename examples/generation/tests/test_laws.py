"""Laws of views, anchors, states, spheres and rotations, on seeded samples and edge cases."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from bidexgrasp_model.anchors import Anchor, anchor_axes, grasp_anchor, to_relative, to_world
from bidexgrasp_model.coordination import Coordination
from bidexgrasp_model.encoder import Features
from bidexgrasp_model.rotations import (
    matrix_from_quat,
    matrix_from_six,
    matrix_from_vector,
    quat_from_matrix,
    six_from_matrix,
    vector_from_matrix,
)
from bidexgrasp_model.sphere import minimum_sphere
from bidexgrasp_model.state import Layout, Poses, Scale, decode, encode
from bidexgrasp_model.tables import farthest_order, nearest
from bidexgrasp_model.views import candidate_views, nearest_view, view_labels

EXACT = 1e-6  # what the issue asks of float64 round trips
HALF = math.pi


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def random_rotations(n, seed=0):
    return matrix_from_quat(torch.randn(n, 4, generator=generator(seed), dtype=torch.float64))


def edge_rotations():
    turns = [[0, 0, 0], [HALF, 0, 0], [0, HALF, 0], [0, 0, HALF], [0, 0, -HALF], [1e-9, 0, 0]]
    return matrix_from_vector(torch.tensor(turns, dtype=torch.float64))


def rotations():
    return torch.cat([random_rotations(50), edge_rotations()])


def test_rotations_are_orthogonal_whatever_the_six_numbers():
    six = torch.randn(200, 6, generator=generator(), dtype=torch.float64)
    R = matrix_from_six(torch.cat([six, six * 1e-3]))
    eye = torch.eye(3, dtype=torch.float64).expand_as(R)
    torch.testing.assert_close(R @ R.transpose(1, 2), eye, atol=1e-12, rtol=0)
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(len(R)).double())


@pytest.mark.parametrize(
    "there_and_back",
    [
        lambda R: matrix_from_six(six_from_matrix(R)),
        lambda R: matrix_from_quat(quat_from_matrix(R)),
        lambda R: matrix_from_vector(vector_from_matrix(R)),
    ],
    ids=["six", "quat", "vector"],
)
def test_every_form_of_a_rotation_gives_it_back(there_and_back):
    R = rotations()
    torch.testing.assert_close(there_and_back(R), R, atol=EXACT, rtol=0)


def test_views_point_down_from_the_upper_hemisphere_and_are_spread():
    views = candidate_views(16)
    torch.testing.assert_close(views.norm(dim=1), torch.ones(16))
    assert (views[:, 2] < 0).all()
    angles = torch.acos((views @ views.T).clamp(-1, 1) - 2 * torch.eye(16)).min(dim=1).values
    # 16 discs of equal area would have a radius of 20 degrees; neighbours are further apart.
    assert angles.min() > math.radians(25)


def edge_views():
    return torch.tensor(
        [[0, 0, -1], [0, 0, 1], [1, 0, 0], [0, -1, 0], [1e-4, 0, -1]], dtype=torch.float64
    )


def test_anchors_stand_on_the_sphere_and_look_at_its_centre():
    view = torch.nn.functional.normalize(
        torch.cat([torch.randn(40, 3, generator=generator()).double(), edge_views()]), dim=-1
    )
    centre = torch.randn(len(view), 3, generator=generator(1)).double()
    radius = torch.rand(len(view), generator=generator(2)).double() + 0.1
    anchor = grasp_anchor(view, centre, radius)
    torch.testing.assert_close((anchor.pos - centre).norm(dim=1), radius)
    ahead = anchor.pos + radius[:, None] * anchor.rot[..., 0]
    torch.testing.assert_close(ahead, centre)
    eye = torch.eye(3, dtype=torch.float64).expand_as(anchor.rot)
    torch.testing.assert_close(anchor.rot @ anchor.rot.transpose(1, 2), eye, atol=1e-9, rtol=0)
    torch.testing.assert_close(torch.linalg.det(anchor.rot), torch.ones(len(view)).double())
    level = view[:, 2].abs() < 0.999
    assert (anchor.rot[level][:, 2, 2] > 0).all(), "z is the world's z across the view"


def random_grasps(n, joints=5, seed=0):
    g = generator(seed)
    R = random_rotations(n * 6, seed).reshape(n, 2, 3, 3, 3)
    pos = torch.randn(n, 2, 3, 3, generator=g, dtype=torch.float64)
    return Poses(pos, R, torch.randn(n, 2, 3, joints, generator=g, dtype=torch.float64))


def anchors_for(n, seed=3):
    view = torch.randn(n, 2, 3, generator=generator(seed), dtype=torch.float64)
    view = torch.nn.functional.normalize(view, dim=-1)
    radius = torch.rand(n, 2, generator=generator(seed), dtype=torch.float64) + 0.1
    return grasp_anchor(view, torch.zeros(n, 2, 3).double(), radius)


def test_a_pose_in_an_anchor_and_back_is_the_pose():
    poses, anchor = random_grasps(60), anchors_for(60)
    pos, rot = poses.pos[:, :, 1], poses.rot[:, :, 1]
    back = to_world(anchor, *to_relative(anchor, pos, rot))
    assert (back[0] - pos).abs().max() < EXACT
    assert (back[1] - rot).abs().max() < EXACT


def test_a_grasp_as_a_state_and_back_is_the_grasp():
    poses, anchor, layout = random_grasps(60), anchors_for(60), Layout(5)
    state = encode(poses, anchor)
    assert state.shape == (60, 2, layout.width)
    for found, true in zip(decode(state, anchor, layout), poses, strict=True):
        assert (found - true).abs().max() < EXACT
    scale = Scale.of(state, layout)
    assert (scale.restored(scale.normalised(state)) - state).abs().max() < EXACT
    assert (scale.std >= layout.least()).all()


def test_states_do_not_change_when_grasp_and_anchor_move_together():
    poses, anchor = random_grasps(20), anchors_for(20)
    R, t = random_rotations(1, 9)[0], torch.tensor([0.3, -0.2, 0.7], dtype=torch.float64)
    moved = Poses(poses.pos @ R.T + t, R @ poses.rot, poses.joints)
    along = Anchor(anchor.pos @ R.T + t, R @ anchor.rot)
    torch.testing.assert_close(encode(moved, along), encode(poses, anchor), atol=1e-9, rtol=0)


def test_a_view_knows_which_it_is_where_the_object_looks_alike_from_all(config):
    """Else a pair of views could not be told from another pair with other places."""
    module = Coordination(config.model)
    views = candidate_views(config.model.views)
    ball = Features(
        torch.zeros(1, 4, 3), torch.zeros(1, 4, 3), torch.ones(1, 4, config.model.width)
    )
    f = module.view_features(ball, views)[0]
    apart = torch.cdist(f, f) + torch.eye(len(views))
    assert apart.min() > 0.1


def test_labels_turn_with_the_scene():
    """Turning grasps by what maps views to views permutes their labels in the same way."""
    step = 2 * math.pi / 8
    ring = torch.tensor([[math.cos(k * step), math.sin(k * step), -0.3] for k in range(8)])
    views = torch.nn.functional.normalize(ring, dim=1)
    wrists = torch.randn(30, 2, 3, generator=generator(4))
    turn = matrix_from_vector(torch.tensor([0.0, 0, step]))
    centre = torch.zeros(30, 2, 3)
    before = nearest_view(wrists, centre, views)
    after = nearest_view(wrists @ turn.T, centre, views)
    torch.testing.assert_close(after, (before + 1) % 8)
    for hand in range(2):
        y, y_bi = view_labels(before, 8)
        turned, turned_bi = view_labels(after, 8)
        torch.testing.assert_close(turned[hand], y[hand].roll(1))
        torch.testing.assert_close(turned_bi, y_bi.roll((1, 1), (0, 1)))


def test_labels_are_distributions_with_each_other_s_margins():
    view = torch.randint(0, 16, (40, 2), generator=generator())
    y, y_bi = view_labels(view, 16)
    torch.testing.assert_close(y.sum(1), torch.ones(2))
    torch.testing.assert_close(y_bi.sum(1), y[1])
    torch.testing.assert_close(y_bi.sum(0), y[0])
    assert view_labels(view[:0], 16)[0].sum() == 0


@pytest.mark.parametrize("seed", range(5))
def test_the_minimum_sphere_holds_all_points_and_none_smaller_does(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(300, 3)) * rng.uniform(0.2, 2, 3)
    held = minimum_sphere(points)
    centre = held.weight @ points[held.point]
    distance = np.linalg.norm(points - centre, axis=1)
    radius = np.linalg.norm(points[held.point[0]] - centre)
    assert distance.max() <= radius * (1 + 1e-8)
    # It is smallest where its centre lies among the points that hold it.
    assert held.weight.min() >= -1e-9
    np.testing.assert_allclose(held.weight.sum(), 1)
    touching = np.linalg.norm(points[held.point] - centre, axis=1)[held.weight > 1e-12]
    np.testing.assert_allclose(touching, radius, rtol=1e-7)


@pytest.mark.parametrize(
    ("points", "radius"),
    [
        ([[0, 0, 0]], 0.0),
        ([[0, 0, 0], [2, 0, 0]], 1.0),
        ([[0, 0, 0], [2, 0, 0], [1, 0, 0]], 1.0),
        ([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], 1.0),
        ([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], math.sqrt(3)),
        ([[0, 0, 0], [0, 0, 0]], 0.0),
    ],
)
def test_the_minimum_sphere_of_a_few_points_is_known_by_hand(points, radius):
    points = np.array(points, float)
    held = minimum_sphere(points)
    centre = held.weight @ points[held.point]
    np.testing.assert_allclose(np.linalg.norm(points - centre, axis=1).max(), radius, atol=1e-9)


def test_anchor_axes_of_a_vertical_view_are_the_world_s():
    down = anchor_axes(torch.tensor([0.0, 0, -1]))
    torch.testing.assert_close(down[:, 2], torch.tensor([1.0, 0, 0]))
    torch.testing.assert_close(torch.linalg.det(down), torch.tensor(1.0))


def test_farthest_order_begins_with_what_lies_farthest_apart():
    points = np.array([[0, 0, 0], [0.1, 0, 0], [5, 0, 0], [0, 3, 0]], float)
    order = farthest_order(points, 4)
    assert order[0] == 2
    assert sorted(order) == [0, 1, 2, 3]
    assert order[1] == 3


def test_neighbours_are_found_nearest_first():
    points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0.4, 0, 0], [3, 0, 0]])[None]
    assert nearest(points[:, :1], points, 3).tolist() == [[[0, 2, 1]]]
