"""Where a page's camera stands: everything is in the picture, whatever the window's shape."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest
from armed_source import armed_source
from picture_samples import Made

from bidexdata.arms.motion import hand_poses, motion_of
from bidexdata.arms.robot_shapes import robot_parts
from bidexdata.frames import matrix_from_quat
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.pictures.camera import view_rotation
from bidexdata.pictures.drawing import solid_parts
from bidexdata.pictures.posing import poses_at
from bidexdata.viewer.nodes import body_meshes
from bidexdata.viewer.page_camera import PageCamera
from bidexdata.viewer.view import FIELD_OF_VIEW, Aim, View, view_of_grasp, view_of_motion

ASPECTS = (0.4, 1.0, 1.33, 2.6)
"""Width over height of what the panel leaves free: a half of a screen, and a wide one."""


def projected(points, aim: Aim, aspect: float) -> np.ndarray:
    """Places in the picture, -1 to 1 across and up, (n, 2); nan behind the camera."""
    local = (points - aim.position) @ view_rotation(aim.position - aim.target)
    local[local[:, 2] >= 0] = np.nan
    tangent = np.tan(0.5 * FIELD_OF_VIEW) * np.array([aspect, 1.0])
    return local[:, :2] / -local[:, 2:] / tangent


def hand_points(hands, poses):
    found = []
    for hand, pos, quat, joints in zip(hands, *poses, strict=True):
        body_pos, body_rot = forward_kinematics(hand, joints[: len(hand.joint_names)])
        for body, vertices, _ in body_meshes(hand):
            in_hand = body_pos[body] + vertices @ body_rot[body].T
            found.append(pos + in_hand @ matrix_from_quat(quat).T)
    return np.concatenate(found)


@pytest.fixture(scope="module")
def motion(hands, tmp_path_factory):
    source = armed_source(hands, tmp_path_factory.mktemp("rig"))
    return motion_of(source.robot(), source.arms("box0-00000000"), 0)


@pytest.mark.parametrize("aspect", ASPECTS)
@pytest.mark.parametrize("sides", [2, 1])
def test_hands_and_object_are_in_the_picture_at_every_stage(hands, aspect, sides):
    hands = hands[-sides:]
    source = Made(hands)
    for object_id, batch in source.batches.items():
        for row in np.flatnonzero(np.isfinite(batch["hand_pos"]).all(axis=(1, 2, 3))).tolist():
            size = float(batch["size"][row])
            aim = view_of_grasp(hands, batch, row, size).aim(aspect)
            solid = solid_parts(source.solids[object_id], size, surface="mesh")[0].vertices
            R = matrix_from_quat(np.asarray(batch["object_quat_wxyz"][row], float))
            seen = [batch["object_pos"][row] + solid @ R.T]
            seen += [hand_points(hands, poses_at(batch, row, at)) for at in (0, 0.6, 1, 2)]
            assert np.abs(projected(np.concatenate(seen), aim, aspect)).max() <= 1


@pytest.mark.parametrize("aspect", ASPECTS)
def test_arms_and_hands_are_in_the_picture_all_through_their_motion(motion, aspect):
    aim, widest = view_of_motion(motion).aim(aspect), 0.0
    for time in np.random.default_rng(3).uniform(0, motion.seconds, 8):
        moment = motion.at(float(time))
        parts = robot_parts(motion.robot, moment.arms, moment.joints)
        hands = hand_points(motion.robot.hands, hand_poses(motion.robot, moment))
        points = np.concatenate([hands, *(part.vertices for part in parts)])
        widest = max(widest, np.abs(projected(points, aim, aspect)).max())
    assert 0.7 < widest <= 1  # and not much smaller than it need be


def test_an_object_alone_stands_in_the_middle():
    aim = view_of_grasp([], None, 0, 0.4).aim(1.5)
    assert np.allclose(aim.target, 0, atol=1e-9)
    cube = 0.2 / np.sqrt(3) * np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    assert np.abs(projected(cube, aim, 1.5)).max() <= 1


class Client:
    """What of a browser's client a page's camera uses: it says what the browser said last."""

    def __init__(self, width, height):
        self.camera = SimpleNamespace(position=np.full(3, 3.0), look_at=np.zeros(3), fov=1.3)
        self.camera.on_update = lambda act: setattr(self, "told", act)
        self.says(width, height)

    def atomic(self):
        return contextlib.nullcontext()

    def says(self, width, height, position=None):
        self.camera.image_width, self.camera.image_height = width, height
        if position is not None:
            self.camera.position = np.asarray(position)
        if hasattr(self, "told"):
            self.told(None)


POINTS = np.array([[-1.0, 0.0, 0.2], [1.0, 0.0, 0.0], [0.0, 0.3, 0.5]])


def seen(client, width, height):
    aim = Aim(client.camera.position, client.camera.look_at)
    return np.abs(projected(POINTS, aim, width / height)).max() <= 1


def test_the_view_fits_anew_into_what_a_window_leaves_it_until_a_person_turns_it():
    client = Client(1250, 650)
    camera = PageCamera(client)
    client.says(1250, 650)  # nothing is to be seen yet
    assert np.allclose(client.camera.position, 3)
    camera.show(View(POINTS, np.array([0.0, -1.0, 0.0])))
    assert seen(client, 1250, 650)
    client.says(860, 650, [3, 3, 3])  # docked, before the browser heard where to look
    assert seen(client, 860, 650)
    client.says(860, 650, client.camera.position + 1e-6)
    client.says(300, 650)
    assert seen(client, 300, 650)
    client.says(300, 650)
    client.says(300, 650, [0, -9, 0])  # turned
    client.says(860, 650)
    assert np.allclose(client.camera.position, [0, -9, 0])
    camera.show(View(POINTS, np.array([1.0, 0.0, 0.0])))
    assert seen(client, 860, 650)


def test_a_window_without_a_picture_breaks_nothing():
    client = Client(0, 0)
    camera = PageCamera(client)
    camera.show(View(POINTS, np.array([0.0, -1.0, 0.0])))
    assert seen(client, 1, 1)
    client.says(200, 600)
    assert seen(client, 200, 600)
