"""The losses, where their values are known by hand."""

from __future__ import annotations

import torch
from bidexgrasp_model.losses import (
    bi_view_loss,
    chamfer_loss,
    contact_loss,
    nearest_point,
    object_penetration_loss,
    para_loss,
    self_penetration_loss,
    single_view_loss,
)
from bidexgrasp_model.state import Layout


def test_view_losses_are_means_over_what_is_supervised():
    p, y = torch.zeros(1, 4), torch.tensor([[1.0, 0.4, 0, 0]])
    mask = torch.tensor([[True, True, False, False]])
    torch.testing.assert_close(single_view_loss(p, y, mask), torch.tensor((0.5 + 0.08) / 2))
    pair = torch.zeros(1, 2, 2)
    goal = torch.tensor([[[1.0, 1.0], [9.0, 9.0]]])
    row = torch.tensor([[True, False]])
    torch.testing.assert_close(bi_view_loss(pair, goal, row), torch.tensor(0.5))
    assert single_view_loss(p, y, mask & False) == 0


def test_the_parameter_loss_is_taken_of_each_part():
    layout = Layout(4)
    true = torch.zeros(3, 2, layout.width)
    found = true.clone()
    found[..., 0:3] = 2.0
    parts = para_loss(found, true, layout, torch.ones(3))
    assert {n: float(v) for n, v in parts.items()} == {
        "translation": 4.0, "rotation": 0.0, "joints": 0.0, "stages": 0.0
    }  # fmt: skip
    assert sum(s.stop - s.start for s in layout.groups.values()) == layout.width


def test_chamfer_is_zero_of_equal_clouds_in_any_order_and_adds_both_ways():
    a = torch.randn(2, 30, 3, generator=torch.Generator().manual_seed(0))
    assert chamfer_loss(a, a[:, torch.randperm(30)]).max() < 1e-5
    one, two = torch.zeros(1, 1, 3), torch.tensor([[[1.0, 0, 0], [0, 2, 0]]])
    torch.testing.assert_close(chamfer_loss(one, two), torch.tensor([1 + (1 + 4) / 2]))


def test_penetration_and_contact_are_depths_and_gaps():
    cloud = torch.tensor([[[0.0, 0, 0], [1, 0, 0]]])
    up = torch.tensor([[[0.0, 0, 1], [0, 0, 1]]])
    points = torch.tensor([[[0, 0, -0.02], [1, 0, 0.3], [0, 0, -0.4]]])
    torch.testing.assert_close(
        object_penetration_loss(points, cloud, up), torch.tensor([0.02 + 0.05])
    )
    pads = torch.tensor([[[0, 0, 0.01], [1, 0, 0.5]]])
    torch.testing.assert_close(contact_loss(pads, cloud, 0.02), torch.tensor([0.01]), atol=1e-4, rtol=0)  # fmt: skip
    assert contact_loss(pads + 9, cloud, 0.02) == 0


def test_outside_an_edge_there_is_no_depth():
    """Two faces of a box that meet in an edge: the plane of the one goes on behind the other."""
    side = torch.linspace(0.0, 0.1, 20)
    top = torch.stack([side - 0.1, 0 * side, 0 * side], -1)
    wall = torch.stack([0 * side, 0 * side, -side], -1)
    cloud = torch.cat([top, wall])[None]
    normals = torch.zeros_like(cloud)
    normals[0, :20, 2] = 1
    normals[0, 20:, 0] = 1
    beside = torch.tensor([[[0.003, 0.0, -0.001]], [[-0.002, 0.0, -0.004]]])
    cloud, normals = (x.expand(2, -1, -1) for x in (cloud, normals))
    depth = object_penetration_loss(beside, cloud, normals)
    torch.testing.assert_close(depth, torch.tensor([0.0, 0.002]))


def test_self_penetration_counts_what_is_closer_than_allowed():
    points = torch.tensor([[[0.0, 0, 0], [0.03, 0, 0], [1, 0, 0]]])
    pairs, least = torch.tensor([[0, 1], [0, 2]]), torch.tensor([0.05, 0.05])
    torch.testing.assert_close(self_penetration_loss(points, pairs, least), torch.tensor([0.02]))


def test_the_nearest_point_is_that_of_the_distances():
    g = torch.Generator().manual_seed(1)
    points, cloud = torch.randn(3, 40, 3, generator=g), torch.randn(3, 60, 3, generator=g)
    assert torch.equal(nearest_point(points, cloud), torch.cdist(points, cloud).argmin(-1))
