"""Arms in a page's scene: a mesh per body, sent to the browser once; a moment moves their frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.arms.robot_shapes import FIXTURE_LABEL, body_places, drawn_bodies, room_parts
from bidexdata.frames import quat_from_matrix
from bidexdata.pictures.drawing import joined
from bidexdata.viewer.nodes import add_part
from bidexdata.viewer.view import box_corners

if TYPE_CHECKING:
    import viser

    from bidexdata.arms.motion import Moment
    from bidexdata.arms.robot import Robot


class ArmNodes:
    """Both arms of a robot with what they stand on, hidden at first; the hands are nodes of their own."""

    def __init__(self, scene: viser.SceneApi, robot: Robot):
        self.robot = robot
        self.base = scene.add_frame("/arms", show_axes=False)
        self.bodies: list[dict[int, Any]] = []
        for h in range(2):
            nodes: dict[int, Any] = {}
            for body in drawn_bodies(robot, h):
                if body.label.endswith("_arm") and body.parts:
                    whole = joined(body.parts, body.parts[0].colour, body.label)
                    nodes[body.number] = add_part(scene, f"/arms/{body.name}", whole)
            self.bodies.append(nodes)
        self.fixtures = [
            add_part(scene, f"/arms/{FIXTURE_LABEL}{number}", part)
            for number, part in enumerate(room_parts(robot))
            if part.label == FIXTURE_LABEL
        ]
        self.show(False)

    def move(self, moment: Moment) -> None:
        """Move the arms to a moment."""
        for h, nodes in enumerate(self.bodies):
            places = body_places(self.robot, h, moment.arms[h], moment.joints[h])
            quats = quat_from_matrix(places.rot)
            for number, node in nodes.items():
                node.position, node.wxyz = places.pos[number], quats[number]

    def show(self, visible: bool) -> None:
        """Show or hide all of it."""
        self.base.visible = visible


def arm_corners(robot: Robot, moment: Moment) -> NDArray[np.float64]:
    """Corners of boxes around the bodies of both arms, without the hands, (n, 3) [m]."""
    found = []
    for h in range(2):
        places = body_places(robot, h, moment.arms[h], moment.joints[h])
        for body in drawn_bodies(robot, h):
            if body.label.endswith("_arm") and body.parts:
                corners = box_corners(np.concatenate([part.vertices for part in body.parts]))
                found.append(places.pos[body.number] + corners @ places.rot[body.number].T)
    return np.concatenate(found)
