"""A hand alone, to look at its spec: postures, contact points, spheres and palm frame.

Frame: the hand lies in its palm frame, fingers along +x, the palm facing up.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bidexdata import frames
from bidexdata.hands.kinematics import hand_points
from bidexdata.hands.model import Hand
from bidexdata.pictures.camera import framed
from bidexdata.pictures.drawing import (
    CONTACT_COLOUR,
    HAND_COLOURS,
    NORMAL_LENGTH,
    hand_part,
)
from bidexdata.pictures.picture import Pixels
from bidexdata.pictures.raycast import RayScene
from bidexdata.pictures.scene import Colour, Part, arrow, sphere
from bidexdata.pictures.sheet import Caption, Tile
from bidexdata.pictures.views import subject_points

Shown = Literal["meshes", "spheres"]

DIRECTIONS: dict[str, tuple[float, float, float]] = {
    "palm": (0.0, -0.15, 1.0),
    "thumb side": (0.0, -1.0, 0.15),
    "fingertips": (1.0, -0.35, 0.35),
    "back": (-0.3, 0.4, -1.0),
}
"""To the camera, in the palm frame of a right hand; a left hand is seen from the mirrored side."""
_AXES: tuple[tuple[str, Colour], ...] = (
    ("x", (0.85, 0.2, 0.2)),
    ("y", (0.2, 0.65, 0.2)),
    ("z", (0.2, 0.3, 0.9)),
)
_AXIS_LENGTH = 0.05
_AXIS_RADIUS = 0.0015
_ARROW_RADIUS = 0.001


def hand_view_parts(hand: Hand, joints: NDArray[np.float64], shown: Shown) -> list[Part]:
    """Draw a hand in its palm frame with contact points, their normals and the frame's axes.

    Args:
        hand: The hand.
        joints: Joint angles [rad], (J,).
        shown: The shapes that are drawn, or the collision spheres of the optimiser.
    """
    T = frames.invert(hand.T_hand_palm)
    quat = frames.quat_from_matrix(T[:3, :3])
    points = hand_points(hand, joints, T[:3, 3], quat)
    count = hand.fingertips
    if shown == "meshes":
        parts = [hand_part(hand, T[:3, 3], quat, joints)]
    else:
        colour = HAND_COLOURS[hand.side]
        balls = zip(points.sphere[count:], hand.sphere_radius[count:], strict=True)
        parts = [sphere(at, float(radius), colour, hand.side) for at, radius in balls]
    for at, normal, radius in zip(points.contact, points.normal, hand.contact_radius, strict=True):
        parts.append(sphere(at, float(radius), CONTACT_COLOUR, "contact"))
        tip = at + (radius + NORMAL_LENGTH) * normal
        shaft = arrow(at, tip, _ARROW_RADIUS, CONTACT_COLOUR, "contact")
        assert shaft is not None
        parts.append(shaft)
    for axis, (_, colour) in enumerate(_AXES):
        shaft = arrow(np.zeros(3), _AXIS_LENGTH * np.eye(3)[axis], _AXIS_RADIUS, colour, "axis")
        assert shaft is not None
        parts.append(shaft)
    return parts


def hand_tiles(hand: Hand) -> list[Tile]:
    """Draw a hand from all sides, open as it looks and curved as spheres, with captions."""
    rows: tuple[tuple[str, Shown, NDArray[np.float64]], ...] = (
        ("open posture", "meshes", hand.posture_open),
        ("curved posture, spheres", "spheres", hand.posture_curved),
    )
    return [
        Tile(draw_hand(hand, joints, view, shown=shown), Caption(f"{hand.side}, {view}", (words,)))
        for words, shown, joints in rows
        for view in DIRECTIONS
    ]


def draw_hand(
    hand: Hand,
    joints: NDArray[np.float64],
    view: str,
    *,
    shown: Shown = "meshes",
    width: int = 360,
    height: int = 270,
    device: str = "cpu",
) -> Pixels:
    """Draw a hand alone.

    Args:
        hand: The hand.
        joints: Joint angles [rad], (J,).
        view: A key of `DIRECTIONS`.
        shown: Shapes or collision spheres.
        width: Pixels.
        height: Pixels.
        device: A Warp device.

    Returns:
        sRGB pixels, (height, width, 3).
    """
    parts = hand_view_parts(hand, joints, shown)
    direction = np.array(DIRECTIONS[view])
    if hand.side == "left":
        direction[1] *= -1.0
    direction /= np.linalg.norm(direction)
    camera = framed(subject_points(parts), direction, width / height)
    return RayScene(parts, device).draw(camera, width, height)
