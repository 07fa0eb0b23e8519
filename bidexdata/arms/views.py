"""Pictures of a robot: its arms and hands at joint angles, fixtures and table, and where it reaches.

World frame, metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bidexdata.arms.generic_pairs import GenericPairs, generic_shapes
from bidexdata.arms.inverse_kinematics import IkConfig, solve_first
from bidexdata.arms.robot import Robot
from bidexdata.arms.robot_shapes import robot_parts, room_parts
from bidexdata.frames import invert
from bidexdata.hands.geometry import tessellate
from bidexdata.pictures.camera import framed
from bidexdata.pictures.drawing import HAND_COLOURS, OBJECT_COLOUR
from bidexdata.pictures.picture import Pixels
from bidexdata.pictures.raycast import RayScene
from bidexdata.pictures.scene import Part, disc, mesh_part, moved, sphere
from bidexdata.pictures.views import subject_points

DIRECTIONS: dict[str, tuple[float, float, float]] = {
    "front": (1.0, 0.25, 0.45),
    "side": (0.1, 1.0, 0.35),
    "top": (0.02, 0.0, 1.0),
}
"""To the camera."""
MAP_HEIGHTS = (0.1, 0.3, 0.5)
"""Heights of the map of reach over the table [m]."""
_GRID_X, _GRID_Y = np.linspace(-0.5, 0.5, 11), np.linspace(-0.6, 0.6, 13)
"""Where the map asks [m]."""
_AXIS_OFF, _THIN = 0.1, 0.006
"""Of the map's axes: distance from its outermost balls, and half their thickness [m]."""


def shape_part(pairs: GenericPairs, row: int) -> Part:
    """Draw the object of a generic pair."""
    shape, size = generic_shapes()[int(pairs.shape[row])], float(pairs.size[row])
    half = shape.half * size
    if shape.family == "box":
        vertices, faces = tessellate("box", half)
    elif shape.family == "ellipsoid":
        vertices, faces = tessellate("sphere", np.array([1.0, 0, 0]), 48)
        vertices = vertices * half
    else:
        vertices, faces = tessellate("cylinder", np.array([1.0, 1.0, 0]), 48)
        vertices = vertices * half
    part = mesh_part(vertices, faces, OBJECT_COLOUR, "object")
    return moved(part, pairs.object_rot[row], pairs.object_pos[row])


def draw_robot(
    robot: Robot,
    q: NDArray[np.float64],
    view: str,
    *,
    more: list[Part] | None = None,
    width: int = 420,
    height: int = 320,
    device: str = "cpu",
) -> Pixels:
    """Draw a robot.

    Args:
        robot: The robot.
        q: Joint angles of the arms [rad], (2, A).
        view: A key of `DIRECTIONS`.
        more: What else is there.
        width: Pixels.
        height: Pixels.
        device: A Warp device.
    """
    parts = [*robot_parts(robot, q), *room_parts(robot), *(more or [])]
    return _draw(parts, view, width, height, device)


def draw_reach(
    robot: Robot,
    at: float,
    config: IkConfig,
    *,
    footprint: float = 0.0,
    width: int = 420,
    height: int = 320,
    device: str = "cpu",
) -> Pixels:
    """Draw from above where the palms can be brought at one height over the table.

    Args:
        robot: The robot.
        at: The height [m].
        config: Of the inverse kinematics.
        footprint: Radius of a disc on the table that shows how far objects come [m]; 0: none.
        width: Pixels.
        height: Pixels.
        device: A Warp device.
    """
    parts = [*reach_parts(robot, at, config, device), *axis_parts(at), *room_parts(robot)]
    if footprint > 0:
        parts.append(disc((0.0, 0.0, 0.002), footprint, OBJECT_COLOUR))
    return _draw(parts, "top", width, height, device)


def reach_parts(robot: Robot, height: float, config: IkConfig, device: str = "cpu") -> list[Part]:
    """Balls on a grid over the table that say which palms can be brought there, facing inward.

    Blue: the left one; green: the right one; dark: both; red: neither.
    """
    points = np.array([[x, y, height] for x in _GRID_X for y in _GRID_Y])
    reached = [_reached(robot, h, points, config, device) for h in range(2)]
    parts = []
    for k, point in enumerate(points):
        left, right = bool(reached[0][k]), bool(reached[1][k])
        colour = (0.85, 0.2, 0.2)
        if left and right:
            colour = (0.15, 0.35, 0.35)
        elif left or right:
            colour = HAND_COLOURS["left" if left else "right"]
        parts.append(sphere(point, 0.035, colour, "reach"))
    return parts


def axis_parts(height: float) -> list[Part]:
    """The x axis below the grid of `reach_parts` and the y axis left of it, with ticks at its places."""
    low_x, low_y = _GRID_X[0] - _AXIS_OFF, _GRID_Y[0] - _AXIS_OFF
    bars = [
        ([_GRID_X.mean(), low_y], [np.ptp(_GRID_X) / 2, _THIN]),
        ([low_x, _GRID_Y.mean()], [_THIN, np.ptp(_GRID_Y) / 2]),
    ]
    for along, places in enumerate((_GRID_X, _GRID_Y)):
        for place in places:
            length = _THIN * (10 if abs(place) < 1e-9 else 4)
            middle = [place, low_y] if along == 0 else [low_x, place]
            bars.append((middle, [_THIN, length] if along == 0 else [length, _THIN]))
    parts = []
    for middle, half in bars:
        vertices, faces = tessellate("box", np.array([*half, _THIN]))
        placed = vertices + np.array([*middle, height])
        parts.append(mesh_part(placed, faces, (0.1, 0.1, 0.1), "axis", smooth=False))
    return parts


def footprint_radius(pairs: GenericPairs) -> float:
    """How far the objects of generic pairs come from the middle of the table [m]."""
    rows = np.flatnonzero(pairs.size == pairs.size.max())
    shapes = (shape_part(pairs, int(row)).vertices[:, :2] for row in rows)
    return max(float(np.linalg.norm(xy, axis=1).max()) for xy in shapes)


def _draw(parts: list[Part], view: str, width: int, height: int, device: str) -> Pixels:
    direction = np.array(DIRECTIONS[view])
    direction /= np.linalg.norm(direction)
    seen = subject_points(parts)
    camera = framed(seen[seen[:, 2] > -0.1], direction, width / height)
    return RayScene(parts, device).draw(camera, width, height)


def _reached(
    robot: Robot, h: int, points: NDArray[np.float64], config: IkConfig, device: str
) -> NDArray[np.bool_]:
    """Whether a palm can be at each point, facing inward with the fingers forward or down."""
    inward = np.array([0.0, -1.0 if h == 0 else 1.0, 0.0])
    T = invert(robot.hands[h].T_hand_palm)
    good = np.zeros(len(points), bool)
    for fingers in ((1.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)):
        x = np.array(fingers) / np.linalg.norm(fingers)
        R = np.stack([x, np.cross(inward, x), inward], axis=1)
        rot = np.repeat((R @ T[:3, :3])[None], len(points), axis=0)
        good |= solve_first(
            robot.arms[h].chain, points + R @ T[:3, 3], rot, config, device=device
        ).ok
    return good
