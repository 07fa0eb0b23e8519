"""Pictures of a robot with an object: a motion as a film, and what stopped one that there is not.

World frame, metres.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.arms.furthest import Furthest
from bidexdata.arms.motion import Moment, Motion
from bidexdata.arms.robot import Robot
from bidexdata.arms.robot_shapes import (
    MARKED,
    MARKED_COLOUR,
    body_places,
    drawn_bodies,
    robot_parts,
    room_parts,
)
from bidexdata.objects.prepared import Solid
from bidexdata.pictures.camera import framed
from bidexdata.pictures.drawing import hand_part, joined, solid_parts
from bidexdata.pictures.picture import Pixels, side_by_side
from bidexdata.pictures.raycast import RayScene
from bidexdata.pictures.scene import Part, moved
from bidexdata.pictures.views import OBJECT, SUBJECTS, choose_views, subject_points

_TELE = float(np.radians(5.0))
"""Opening angle that fills a picture with an object and its hands from behind the robot [rad]."""
_LOOKS = 24
"""Moments of a motion that a camera must see."""
_SAME = 1e-6
"""Bodies that are nearer to where they were stand still [m, -]."""
_POINTS = 1500
"""As many of a moment's points are enough to place a camera."""


class Held(NamedTuple):
    """The object of a grasp; where it is says the moment."""

    solid: Solid
    size: float
    """Diagonal of its box [m]."""
    quat_wxyz: NDArray[np.float64]
    """(4,)."""

    def parts(self, moment: Moment) -> list[Part]:
        """It at a moment."""
        return solid_parts(self.solid, self.size, moment.object_pos, self.quat_wxyz)


def motion_parts(robot: Robot, held: Held, moment: Moment) -> list[Part]:
    """Everything at one moment of a motion."""
    robots = robot_parts(robot, moment.arms, moment.joints)
    return [*held.parts(moment), *robots, *room_parts(robot)]


def furthest_parts(robot: Robot, held: Held, found: Furthest) -> list[Part]:
    """Everything at the posture that says what stopped the arms; what did is red.

    Red are bodies that collide; hands where they should be and are not; an arm where it would have to be.
    """
    at = found.moment
    parts = [
        *held.parts(at),
        *robot_parts(robot, at.arms, at.joints, marked=found.touching),
        *room_parts(robot, marked=found.touching),
    ]
    if found.wanted is not None:
        poses, sides = found.wanted
        for h in sides:
            hand = hand_part(robot.hands[h], poses.pos[h], poses.quat_wxyz[h], poses.joints[h])
            parts.append(hand._replace(colour=MARKED_COLOUR, label=MARKED))
    if found.after is not None:
        parts += _moved_parts(robot, at, found.after)
    return parts


def _moved_parts(robot: Robot, before: Moment, after: Moment) -> list[Part]:
    """Draw in red the bodies that are elsewhere at another moment, where they are then."""
    parts: list[Part] = []
    for h in range(2):
        first, then = (body_places(robot, h, m.arms[h], m.joints[h]) for m in (before, after))
        for body in drawn_bodies(robot, h):
            k = body.number
            if np.abs(then.rot[k] - first.rot[k]).max() > _SAME or (
                np.abs(then.pos[k] - first.pos[k]).max() > _SAME
            ):
                parts += [moved(part, then.rot[k], then.pos[k]) for part in body.parts]
    return [joined(parts, MARKED_COLOUR, MARKED)] if parts else []


def draw_motion(
    robot: Robot,
    motion: Motion,
    held: Held,
    times: Sequence[float],
    *,
    width: int,
    height: int,
    device: str = "cpu",
) -> Iterator[Pixels]:
    """Draw a motion at some times [s] from where it is seen best while the grasp is closed.

    The camera stands still, and everything stays in the picture from home to the lift.

    Args:
        robot: The robot.
        motion: Of its arms.
        held: The object.
        times: Since home; the last picture stands still where they go on behind the end.
        width: Pixels.
        height: Pixels.
        device: A Warp device.
    """
    looks = np.concatenate([motion.key_time, np.linspace(0.0, motion.seconds, _LOOKS)])
    shown = [motion_parts(robot, held, motion.at(float(time))) for time in looks]
    middle = shown[3]  # the grasp
    scene = RayScene(middle, device)
    direction = _directions(middle, device)[0]
    points = np.concatenate([_few(subject_points(parts)) for parts in shown])
    camera = framed(points, direction, width / height)
    last, drawn = -1.0, None
    for time in times:
        at = min(time, motion.seconds)
        if drawn is None or at != last:
            scene.move(motion_parts(robot, held, motion.at(at)))
            last, drawn = at, scene.draw(camera, width, height)
        yield drawn


def draw_furthest(
    robot: Robot,
    found: Furthest,
    held: Held,
    *,
    views: int,
    width: int,
    height: int,
    device: str = "cpu",
) -> Pixels:
    """Draw what stopped the arms from the directions that show most of both hands, side by side."""
    parts = furthest_parts(robot, held, found)
    scene, points = RayScene(parts, device), _few(subject_points(parts))
    return side_by_side(
        [
            scene.draw(framed(points, direction, width / height), width, height)
            for direction in _directions(parts, device, views)
        ]
    )


def _directions(parts: list[Part], device: str, count: int = 1) -> list[NDArray[np.float64]]:
    """Directions that show most of the hands and no more, from beyond all that may hide them."""
    seen = sorted(parts, key=lambda part: part.label not in (OBJECT, *SUBJECTS))
    close = [part for part in seen if part.label in (OBJECT, *SUBJECTS)]
    return choose_views(close, RayScene(seen, device), count, fov=_TELE)


def _few(points: NDArray[np.float64]) -> NDArray[np.float64]:
    box = np.stack([points.min(axis=0), points.max(axis=0)])
    return np.concatenate([points[:: 1 + len(points) // _POINTS], box])
