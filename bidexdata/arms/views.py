"""Pictures of a robot: its arms and hands at joint angles, fixtures and table, and where it reaches.

World frame, metres.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.arms.assembly import arm_prefix, arm_spec, mounted_hand
from bidexdata.arms.generic_pairs import GenericPairs, generic_shapes
from bidexdata.arms.inverse_kinematics import IkConfig, solve_first
from bidexdata.arms.robot import Robot
from bidexdata.frames import invert
from bidexdata.hands.geometry import body_shapes, tessellate
from bidexdata.pictures.camera import framed
from bidexdata.pictures.picture import Pixels
from bidexdata.pictures.raycast import RayScene
from bidexdata.pictures.scene import Colour, Part, disc, mesh_part, moved, sphere
from bidexdata.simulation.assembly import hand_prefix

ARM_COLOURS: dict[str, Colour] = {"left": (0.62, 0.70, 0.82), "right": (0.66, 0.78, 0.70)}
HAND_COLOURS: dict[str, Colour] = {"left": (0.25, 0.50, 0.85), "right": (0.30, 0.68, 0.45)}
FIXTURE_COLOUR: Colour = (0.45, 0.45, 0.48)
TABLE_COLOUR: Colour = (0.80, 0.80, 0.79)
OBJECT_COLOUR: Colour = (0.93, 0.78, 0.50)
DIRECTIONS: dict[str, tuple[float, float, float]] = {
    "front": (1.0, 0.25, 0.45),
    "side": (0.1, 1.0, 0.35),
    "top": (0.02, 0.0, 1.0),
}
"""To the camera."""
MAP_HEIGHTS = (0.1, 0.3, 0.5)
"""Heights of the map of reach over the table [m]."""
FIXTURE = "fixture"
_TABLE = 0.95


class _Drawn(NamedTuple):
    """One arm as MuJoCo moves it, and what is drawn of its bodies."""

    model: Any
    arm_qpos: NDArray[np.int64]
    hand_qpos: NDArray[np.int64]
    shapes: tuple[tuple[int, Part], ...]
    """Body and part in its frame."""


def robot_parts(
    robot: Robot, q: NDArray[np.float64], joints: NDArray[np.float64] | None = None
) -> list[Part]:
    """Draw both arms with their hands.

    Args:
        robot: The robot.
        q: Joint angles of the arms [rad], (2, A); what is behind a shorter chain does not matter.
        joints: Of the hands [rad], (2, J); their open postures when omitted.

    Returns:
        Parts labelled `left_arm`, `left`, `right_arm`, `right`.
    """
    parts = []
    for h in range(2):
        angles = robot.hands[h].posture_open if joints is None else joints[h]
        parts += _arm_parts(robot, h, q[h], angles)
    return parts


def arm_parts(robot: Robot, q: NDArray[np.float64]) -> list[Part]:
    """Draw both arms, with what of the hands' models moves with them, without the hands.

    Args:
        robot: The robot.
        q: Joint angles of the arms [rad], (2, A).

    Returns:
        Parts labelled `left_arm` and `right_arm`.
    """
    return [part for part in robot_parts(robot, q) if part.label.endswith("_arm")]


def room_parts(robot: Robot) -> list[Part]:
    """Draw the fixtures and the table."""
    parts = [disc((0.0, 0.0, 0.0), _TABLE, TABLE_COLOUR, "table")]
    for box in robot.rig.spec.fixtures:
        vertices, faces = tessellate("box", np.array(box.half))
        low = max(-0.02, box.pos[2] - box.half[2])
        placed = vertices + np.array(box.pos)
        placed[:, 2] = np.maximum(placed[:, 2], low)
        parts.append(mesh_part(placed, faces, FIXTURE_COLOUR, FIXTURE, smooth=False))
    return parts


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
    width: int = 420,
    height: int = 320,
    device: str = "cpu",
) -> Pixels:
    """Draw from above where the palms can be brought at one height over the table.

    Args:
        robot: The robot.
        at: The height [m].
        config: Of the inverse kinematics.
        width: Pixels.
        height: Pixels.
        device: A Warp device.
    """
    parts = [*reach_parts(robot, at, config, device), *room_parts(robot)]
    return _draw(parts, "top", width, height, device)


def reach_parts(robot: Robot, height: float, config: IkConfig, device: str = "cpu") -> list[Part]:
    """Balls on a grid over the table that say which palms can be brought there, facing inward.

    Blue: the left one; green: the right one; dark: both; red: neither.
    """
    grid = np.arange(-0.5, 0.51, 0.1)
    points = np.array([[x, y, height] for x in grid for y in np.arange(-0.6, 0.61, 0.1)])
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


def _draw(parts: list[Part], view: str, width: int, height: int, device: str) -> Pixels:
    direction = np.array(DIRECTIONS[view])
    direction /= np.linalg.norm(direction)
    seen = np.concatenate([part.vertices for part in parts])
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


def _arm_parts(
    robot: Robot, h: int, q: NDArray[np.float64], joints: NDArray[np.float64]
) -> list[Part]:
    import mujoco

    drawn = _drawn(robot, h)
    data = mujoco.MjData(drawn.model)
    data.qpos[drawn.arm_qpos] = q[: len(drawn.arm_qpos)]
    data.qpos[drawn.hand_qpos] = joints[: len(drawn.hand_qpos)]
    mujoco.mj_kinematics(drawn.model, data)
    return [
        moved(part, data.xmat[body].reshape(3, 3), data.xpos[body]) for body, part in drawn.shapes
    ]


@lru_cache(maxsize=8)
def _drawn(robot: Robot, h: int) -> _Drawn:
    arm, hand = robot.arms[h], robot.hands[h]
    model = arm_spec(robot.rig.spec, h, arm.model, hand, arm.mount).compile()
    names = {model.joint(j).name.rpartition("/")[2]: j for j in range(model.njnt)}
    shapes = []
    # Each from its own model: one of them may have no visual geometry.
    own = {hand_prefix(h) + name for name in hand.body_names}
    sources = (
        (arm_prefix(h), arm.model.make_spec().compile()),
        (hand_prefix(h), mounted_hand(hand, arm.mount).compile()),
    )
    for prefix, source in sources:
        for k, geoms in enumerate(body_shapes(source, visual=True), start=1):
            name = prefix + source.body(k).name
            colours, label = (HAND_COLOURS, "") if name in own else (ARM_COLOURS, "_arm")
            body = int(model.body(name).id)
            for geom in geoms:
                part = mesh_part(geom.vertices, geom.faces, colours[arm.side], arm.side + label)
                shapes.append((body, moved(part, geom.R, geom.pos)))
    return _Drawn(
        model,
        np.array([model.jnt_qposadr[names[n]] for n in arm.chain.joint_names]),
        np.array([model.jnt_qposadr[names[n]] for n in hand.joint_names], np.int64),
        tuple(shapes),
    )
