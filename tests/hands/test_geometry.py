"""Contacts, spheres, pairs and drawing meshes against the collision geometry."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial.distance import cdist

from bidexdata.hands import load_hand
from bidexdata.hands.geometry import body_shapes, depth, surface_samples, tessellate
from bidexdata.hands.kinematics import forward_kinematics, hand_points
from bidexdata.hands.meshes import visual_meshes
from bidexdata.hands.pairs import body_balls, pair_groups

MM = 1e-3


def test_contact_spheres_touch_the_pads(hand):
    shapes = body_shapes(hand.make_spec().compile())
    for c, body in enumerate(hand.contact_body):
        front = hand.contact_pos[c] + hand.contact_radius[c] * hand.contact_normal[c]
        assert abs(depth(shapes[body], front[None])[0]) < 2 * MM, hand.contact_names[c]
        if hand.contact_part[c] == "palm":
            assert hand.contact_finger[c] == ""
            assert not any(hand.body_names[body] in bodies for bodies in hand.fingers.values())
        else:
            assert hand.body_names[body] in hand.fingers[hand.contact_finger[c]]


def test_palm_origin_lies_on_the_palm(hand):
    shapes = body_shapes(hand.make_spec().compile())[0]
    assert abs(depth(shapes, hand.T_hand_palm[None, :3, 3])[0]) < 1 * MM


def test_fingertips_contact_spheres_come_first_among_the_collision_spheres(hand):
    count = hand.fingertips
    np.testing.assert_array_equal(hand.sphere_body[:count], hand.contact_body[:count])
    np.testing.assert_array_equal(hand.sphere_pos[:count], hand.contact_pos[:count])
    np.testing.assert_array_equal(hand.sphere_radius[:count], hand.contact_radius[:count])


def test_spheres_follow_the_collision_geometry(hand):
    """Measured (capsule, shadow): fingers within 7.0 and 7.5 mm, palm within 9.9 and 12.5 mm.

    The largest gaps are corners of boxes, the largest protrusions the thin back plate (2.5 and
    3.2 mm). Area-weighted mean gap: fingers 0.5 and 0.7 mm, palm 2.6 and 2.4 mm.
    """
    protrusion, gaps, areas = np.zeros(len(hand.sphere_body)), [], []
    for body, shapes in enumerate(body_shapes(hand.make_spec().compile())):
        mine = np.flatnonzero(hand.sphere_body == body)
        samples, area = surface_samples(shapes, 2 * MM)
        if not len(samples):
            continue
        apart = cdist(hand.sphere_pos[mine], samples)
        deep = np.maximum(depth(shapes, hand.sphere_pos[mine]), apart.min(axis=1))
        protrusion[mine] = hand.sphere_radius[mine] - deep
        gaps.append((apart - hand.sphere_radius[mine, None]).min(axis=0, initial=np.inf))
        areas.append(area)
    gap, area = np.maximum(np.concatenate(gaps), 0.0), np.concatenate(areas)
    assert protrusion.max() < 3.5 * MM
    assert gap.max() < 14 * MM
    assert gap @ area / area.sum() < 1.6 * MM
    assert area[gap < 5 * MM].sum() / area.sum() > 0.92
    assert 60 <= len(hand.sphere_body) <= 90
    assert hand.sphere_radius.min() >= 6 * MM
    assert hand.sphere_radius.max() <= 13.5 * MM


def test_self_pairs_are_free_at_rest_and_may_collide(hand, rng):
    model = hand.make_spec().compile()
    a, b = hand.self_pairs.T
    assert 400 < len(a) < 700
    assert np.all(a < b)
    standing = np.stack([0 * hand.posture_open, hand.posture_open, hand.posture_curved])
    centre = hand_points(hand, standing).sphere
    gap = np.linalg.norm(centre[:, a] - centre[:, b], axis=-1)
    assert np.all(gap > hand.sphere_radius[a] + hand.sphere_radius[b])
    bodies = {tuple(sorted(pair)) for pair in hand.sphere_body[hand.self_pairs].tolist()}
    excluded = {(s >> 16, s & 0xFFFF) for s in model.exclude_signature.tolist()}
    for i, j in bodies:
        assert hand.body_parent[i] != j
        assert hand.body_parent[j] != i
        assert not {(i + 1, j + 1), (j + 1, i + 1)} & excluded


def test_groups_hold_every_self_pair_once_and_their_balls_hold_its_spheres(hand, edge_joints):
    groups = pair_groups(hand)
    listed = {tuple(sorted(pair)) for pair in groups.pairs.tolist()}
    assert listed == {tuple(sorted(pair)) for pair in hand.self_pairs.tolist()}
    assert len(groups.pairs) == len(hand.self_pairs)
    first, stop = groups.ends.T
    np.testing.assert_array_equal(first, [0, *stop[:-1]])
    assert stop[-1] == len(groups.pairs)
    bodies = [hand.sphere_body[groups.pairs[i:j]] for i, j in groups.ends]
    assert all(np.all(of_group == of_group[0]) for of_group in bodies)
    assert len({tuple(of_group[0]) for of_group in bodies}) == len(groups.ends)
    centre = hand_points(hand, edge_joints(hand, 50)).sphere
    for (i, j), hubs, reach in zip(groups.ends, groups.hubs, groups.reach, strict=True):
        a, b = groups.pairs[i:j].T
        gap = np.linalg.norm(centre[:, a] - centre[:, b], axis=-1)
        gap -= hand.sphere_radius[a] + hand.sphere_radius[b]
        apart = np.linalg.norm(centre[:, hubs[0]] - centre[:, hubs[1]], axis=-1) - reach
        assert np.all(gap >= apart[:, None])


def test_a_body_s_ball_holds_its_spheres(hand):
    balls = body_balls(hand)
    held = hand.sphere_body[balls.hubs]
    assert sorted(held) == sorted(set(hand.sphere_body))
    hub = balls.hubs[np.searchsorted(held, hand.sphere_body)]
    offset = np.linalg.norm(hand.sphere_pos - hand.sphere_pos[hub], axis=1)
    radius = balls.radius[np.searchsorted(held, hand.sphere_body)]
    assert np.all(offset + hand.sphere_radius <= radius)


def test_rest_and_start_postures_are_free_of_self_collision(hand):
    """In MuJoCo itself, with the palm on a free joint as in the simulation."""
    spec = hand.make_spec()
    spec.body(hand.root_body).add_freejoint()
    model = spec.compile()
    data = mujoco.MjData(model)
    for joints in (0 * hand.posture_open, hand.posture_open, hand.posture_curved):
        data.qpos[7:] = joints
        mujoco.mj_forward(model, data)
        pairs = [tuple(model.geom_bodyid[g] - 1) for g in data.contact.geom[: data.ncon]]
        deep = data.contact.dist[: data.ncon].min(initial=0.0)
        assert deep > -0.5 * MM, [(hand.body_names[i], hand.body_names[j]) for i, j in pairs]


def test_built_in_fingertips_agree_with_menagerie(menagerie, edge_joints):
    """The golden check: tip centre and three sides of the tip, within 2 mm everywhere."""
    for side in ("left", "right"):
        ours, theirs = load_hand("capsule", side), load_hand("shadow", side)
        assert ours.joint_names == theirs.joint_names
        assert ours.body_names == theirs.body_names
        joints = edge_joints(theirs, 300)
        np.testing.assert_allclose(
            hand_points(ours, joints).contact[:, : ours.fingertips],
            hand_points(theirs, joints).contact[:, : theirs.fingertips],
            atol=1e-5,
        )
        # Farthest points of the tips' geometry, in the hand frame, along directions that turn
        # with the distal links: pad face, pad direction, tip.
        tips = {hand: body_shapes(hand.make_spec().compile()) for hand in (ours, theirs)}
        for c, body in enumerate(theirs.contact_body[: theirs.fingertips]):
            for direction in ([0, -1, 0], theirs.contact_normal[c], [0, 0, 1]):
                reach = [_reach(tips[h][body], np.array(direction, float)) for h in (ours, theirs)]
                assert abs(reach[0] - reach[1]) < 2 * MM, (theirs.contact_names[c], direction)
        R = [
            forward_kinematics(h, joints)[1][:, h.contact_body[: h.fingertips]]
            for h in (ours, theirs)
        ]
        np.testing.assert_allclose(R[0], R[1], atol=1e-4)


def test_built_in_hand_weighs_and_bends_like_menagerie(menagerie):
    for side in ("left", "right"):
        ours, theirs = load_hand("capsule", side), load_hand("shadow", side)
        np.testing.assert_allclose(ours.joint_lower, theirs.joint_lower, atol=1e-5)
        np.testing.assert_allclose(ours.joint_upper, theirs.joint_upper, atol=1e-5)
        mass = [h.make_spec().compile().body_mass for h in (ours, theirs)]
        np.testing.assert_allclose(mass[0], mass[1], atol=1e-6)
        assert set(ours.actuator_names) == set(theirs.actuator_names)


@pytest.mark.parametrize("kind", ["sphere", "capsule", "cylinder", "box"])
def test_tessellated_primitives_are_closed_and_wound_outwards(kind):
    import trimesh

    size = np.array([0.01, 0.02, 0.03])
    mesh = trimesh.Trimesh(*tessellate(kind, size, segments=96), process=True)
    volume = {
        "sphere": 4 / 3 * np.pi * 0.01**3,
        "capsule": 4 / 3 * np.pi * 0.01**3 + np.pi * 0.01**2 * 0.04,
        "cylinder": np.pi * 0.01**2 * 0.04,
        "box": 8 * 0.01 * 0.02 * 0.03,
    }
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(volume[kind], rel=3e-3)


def test_depth_is_zero_on_the_surface_and_samples_cover_its_area(hand):
    for shapes in body_shapes(hand.make_spec().compile()):
        points, area = surface_samples(shapes, 3 * MM)
        assert np.abs(depth(shapes, points)).max(initial=0) < 0.3 * MM  # chords of 24 segments
        assert np.all(area > 0)


def test_visual_meshes_lie_on_their_bodies(hand):
    meshes = visual_meshes(hand)
    shown = {m.body for m in meshes}
    assert {int(b) for b in hand.contact_body} <= shown
    assert 0 in shown
    tips = {int(b): c for c, b in enumerate(hand.contact_body[: hand.fingertips])}
    for body, mesh, rgba in meshes:
        assert mesh.faces.min() >= 0
        assert mesh.faces.max() < len(mesh.vertices)
        assert np.abs(mesh.vertices).max() < 0.15
        assert all(0 <= v <= 1 for v in rgba)
        if body in tips:
            distance = np.linalg.norm(mesh.vertices - hand.contact_pos[tips[body]], axis=1)
            assert distance.min() < hand.contact_radius[tips[body]] + 2 * MM


def test_visual_triangles_face_outwards(hand):
    import trimesh

    for _, mesh, _ in visual_meshes(hand):
        assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume > 0


def _reach(shapes, direction):
    points = np.concatenate([s.vertices @ s.R.T + s.pos for s in shapes])
    return (points @ direction).max()
