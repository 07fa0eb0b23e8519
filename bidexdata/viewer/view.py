"""What a page's camera has in view, and from where: all that moves and what it holds.

World frame, metres. How wide the picture is comes last: browsers' windows differ.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import matrix_from_quat
from bidexdata.hands.kinematics import forward_kinematics
from bidexdata.pictures.camera import framed, view_rotation
from bidexdata.pictures.posing import HandPoses, has_pose, poses_at
from bidexdata.pictures.views import side_direction
from bidexdata.record import GraspBatch
from bidexdata.viewer.nodes import body_meshes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bidexdata.arms.motion import Motion
    from bidexdata.hands.model import Hand

FloatArray = NDArray[np.float64]

FIELD_OF_VIEW = float(np.radians(35.0))
"""Vertical opening angle of the page's camera [rad]; viser's own is 75 degrees."""
_MARGIN = 0.04
"""Free border, as a fraction of the picture [-]."""
_HANDS_REACH = 0.2
"""How far hands of a scene's other grasps go beyond its object, about [m]."""
_BORDER = 0.05
"""Beside an object without hands [m]."""
_MOMENTS = 12
"""Of a motion, beside its key frames."""


class Aim(NamedTuple):
    """A camera that turns around a point."""

    position: FloatArray
    """(3,) [m]."""
    target: FloatArray
    """What it looks at, in the middle of the picture, (3,) [m]."""


class View(NamedTuple):
    """What must be in the picture, and the side it is seen from."""

    points: FloatArray
    """(n, 3) [m]."""
    direction: FloatArray
    """From them to the camera, unit, (3,)."""

    def aim(self, aspect: float) -> Aim:
        """Stand where all of it is in a picture of this width over height [-], as near as can be."""
        camera = framed(self.points, self.direction, aspect, margin=_MARGIN, fov=FIELD_OF_VIEW)
        back = camera.R_world_camera[:, 2]
        away = float((camera.position - self.points.mean(axis=0)) @ back)
        return Aim(camera.position, camera.position - away * back)


def view_of_grasp(hands: Sequence[Hand], batch: GraspBatch | None, row: int, size: float) -> View:
    """See object and hands from the side, with room for other grasps of the scene.

    Args:
        hands: In the order of the H axis.
        batch: Rows; none for an object alone at the origin.
        row: Which.
        size: Diagonal of the object [m].
    """
    centre = np.zeros(3) if batch is None else np.asarray(batch["object_pos"][row], np.float64)
    if batch is None or not has_pose(batch, row):
        return _around(centre, 0.5 * size + _BORDER, side_direction([]))
    middles = list(np.asarray(batch["hand_pos"][row, :, 1], np.float64))
    direction = side_direction([centre, *middles] if len(middles) == 1 else middles)
    room = _around(centre, 0.5 * size + _HANDS_REACH, direction)
    corners = [hand_corners(hands, poses_at(batch, row, stage)) for stage in range(3)]
    return View(np.concatenate([room.points, *corners]), direction)


def view_of_motion(motion: Motion) -> View:
    """See arms, hands and what the arms stand on, at every moment of a motion."""
    from bidexdata.arms.motion import hand_poses
    from bidexdata.arms.robot_shapes import FIXTURE_LABEL, room_parts
    from bidexdata.viewer.arm_nodes import arm_corners

    robot = motion.robot
    times = np.union1d(np.linspace(0.0, motion.seconds, _MOMENTS), motion.key_time)
    points = [p.vertices for p in room_parts(robot) if p.label == FIXTURE_LABEL]
    for time in times:
        moment = motion.at(float(time))
        points += [
            arm_corners(robot, moment),
            hand_corners(robot.hands, hand_poses(robot, moment)),
            moment.object_pos[None],
        ]
    middles = hand_poses(robot, motion.at(0.0)).pos
    return View(np.concatenate(points), side_direction(list(middles)))


def hand_corners(hands: Sequence[Hand], poses: HandPoses) -> FloatArray:
    """Corners of boxes around the bodies of posed hands, (n, 3) [m]."""
    found = []
    for hand, pos, quat, joints in zip(hands, *poses, strict=True):
        body_pos, body_rot = forward_kinematics(hand, joints[: len(hand.joint_names)])
        for body, corners in _body_corners(hand):
            in_hand = body_pos[body] + corners @ body_rot[body].T
            found.append(pos + in_hand @ matrix_from_quat(quat).T)
    return np.concatenate(found)


def box_corners(points: NDArray[Any]) -> FloatArray:
    """Corners of the box around points, along their axes, (8, 3) [m]."""
    ends = np.stack([points.min(axis=0), points.max(axis=0)])
    return np.stack(np.meshgrid(*ends.T), axis=-1).reshape(-1, 3).astype(np.float64)


@lru_cache(maxsize=8)
def _body_corners(hand: Hand) -> tuple[tuple[int, FloatArray], ...]:
    """Corners around each body that has a shape, in its frame: number, (8, 3)."""
    return tuple((body, box_corners(vertices)) for body, vertices, _ in body_meshes(hand))


def _around(centre: FloatArray, radius: float, direction: FloatArray) -> View:
    """A disc across the line of sight, by the ends of its width and height."""
    across = radius * view_rotation(direction)[:, :2].T
    return View(centre + np.concatenate([across, -across]), direction)
