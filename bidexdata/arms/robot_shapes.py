"""What a robot looks like: its arms, hands and fixtures as parts, and which bodies they belong to.

World frame, metres.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.arms.assembly import arm_prefix, arm_spec, fixture_name, mounted_hand
from bidexdata.arms.robot import Robot
from bidexdata.hands.geometry import body_shapes, tessellate
from bidexdata.pictures.drawing import HAND_COLOURS, joined
from bidexdata.pictures.scene import Colour, Part, disc, mesh_part, moved
from bidexdata.simulation.assembly import hand_prefix

ARM_COLOURS: dict[str, Colour] = {"left": (0.62, 0.70, 0.82), "right": (0.66, 0.78, 0.70)}
FIXTURE_COLOUR: Colour = (0.45, 0.45, 0.48)
TABLE_COLOUR: Colour = (0.80, 0.80, 0.79)
MARKED_COLOUR: Colour = (0.85, 0.12, 0.10)
"""Of bodies that are to be seen, such as those that collide."""
FIXTURE_LABEL, MARKED = "fixture", "marked"
"""Labels of parts."""
_TABLE = 1.3
"""Radius of the table that is drawn; arms reach as far [m]."""
_LOWEST = -0.02
"""Fixtures are drawn from a little under the table up [m]."""


class DrawnBody(NamedTuple):
    """One body of an arm or of its hand."""

    number: int
    """In MuJoCo's model of the arm with its hand."""
    name: str
    """As in scenes: `arm0/...`, `hand1/...`."""
    label: str
    """`left_arm`, `left`, `right_arm`, `right`."""
    parts: tuple[Part, ...]
    """In the body's frame."""


class Places(NamedTuple):
    """Where MuJoCo has the bodies of an arm with its hand, by their numbers."""

    pos: NDArray[np.float64]
    """(B, 3) [m]."""
    rot: NDArray[np.float64]
    """(B, 3, 3)."""


class _Drawn(NamedTuple):
    """One arm as MuJoCo moves it, and what is drawn of its bodies."""

    model: Any
    arm_qpos: NDArray[np.int64]
    hand_qpos: NDArray[np.int64]
    bodies: tuple[DrawnBody, ...]


def robot_parts(
    robot: Robot,
    q: NDArray[np.float64],
    joints: NDArray[np.float64] | None = None,
    *,
    marked: Collection[str] = (),
) -> list[Part]:
    """Draw both arms with their hands.

    Args:
        robot: The robot.
        q: Joint angles of the arms [rad], (2, A); what is behind a shorter chain does not matter.
        joints: Of the hands [rad], (2, J); their open postures when omitted.
        marked: Names of bodies to draw in red.

    Returns:
        Parts labelled `left_arm`, `left`, `right_arm`, `right` and `marked`, one of each at most.
    """
    return _parts(robot, q, joints, marked, with_hands=True)


def arm_parts(robot: Robot, q: NDArray[np.float64]) -> list[Part]:
    """Draw both arms, with what of the hands' models moves with them, without the hands.

    Args:
        robot: The robot.
        q: Joint angles of the arms [rad], (2, A).

    Returns:
        Parts labelled `left_arm` and `right_arm`.
    """
    return _parts(robot, q, None, (), with_hands=False)


def room_parts(robot: Robot, *, marked: Collection[str] = ()) -> list[Part]:
    """Draw the table, labelled as ground, and the fixtures; those with marked names in red."""
    parts = [disc((0.0, 0.0, 0.0), _TABLE, TABLE_COLOUR)]
    for number, box in enumerate(robot.rig.spec.fixtures):
        vertices, faces = tessellate("box", np.array(box.half))
        placed = vertices + np.array(box.pos)
        placed[:, 2] = np.maximum(placed[:, 2], max(_LOWEST, box.pos[2] - box.half[2]))
        colour = MARKED_COLOUR if fixture_name(number) in marked else FIXTURE_COLOUR
        parts.append(mesh_part(placed, faces, colour, FIXTURE_LABEL, smooth=False))
    return parts


def drawn_bodies(robot: Robot, h: int) -> tuple[DrawnBody, ...]:
    """What is drawn of arm number `h` and its hand, body by body."""
    return _drawn(robot, h).bodies


def body_places(
    robot: Robot, h: int, q: NDArray[np.float64], joints: NDArray[np.float64]
) -> Places:
    """Place the bodies of one arm with its hand in the world.

    Args:
        robot: The robot.
        h: Number of the arm.
        q: Its joint angles [rad]; what is behind its chain does not matter.
        joints: Of the hand [rad], likewise.
    """
    import mujoco

    drawn = _drawn(robot, h)
    data = mujoco.MjData(drawn.model)
    data.qpos[drawn.arm_qpos] = q[: len(drawn.arm_qpos)]
    data.qpos[drawn.hand_qpos] = joints[: len(drawn.hand_qpos)]
    mujoco.mj_kinematics(drawn.model, data)
    return Places(np.array(data.xpos), np.array(data.xmat).reshape(-1, 3, 3))


def _parts(
    robot: Robot,
    q: NDArray[np.float64],
    joints: NDArray[np.float64] | None,
    marked: Collection[str],
    *,
    with_hands: bool,
) -> list[Part]:
    found: dict[str, list[Part]] = {}
    for h in range(2):
        angles = robot.hands[h].posture_open if joints is None else joints[h]
        pos, rot = body_places(robot, h, q[h], angles)
        for body in drawn_bodies(robot, h):
            if with_hands or body.label.endswith("_arm"):
                label = MARKED if body.name in marked else body.label
                placed = [moved(p, rot[body.number], pos[body.number]) for p in body.parts]
                found.setdefault(label, []).extend(placed)
    return [
        joined(parts, MARKED_COLOUR if label == MARKED else parts[0].colour, label)
        for label, parts in found.items()
        if parts
    ]


@lru_cache(maxsize=8)
def _drawn(robot: Robot, h: int) -> _Drawn:
    arm, hand = robot.arms[h], robot.hands[h]
    model = arm_spec(robot.rig.spec, h, arm.model, hand, arm.mount).compile()
    names = {model.joint(j).name.rpartition("/")[2]: j for j in range(model.njnt)}
    bodies = []
    # Each from its own model: one of them may have no visual geometry.
    own = {hand_prefix(h) + name for name in hand.body_names}
    sources = (
        (arm_prefix(h), arm.model.make_spec().compile()),
        (hand_prefix(h), mounted_hand(hand, arm.mount).compile()),
    )
    for prefix, source in sources:
        for k, geoms in enumerate(body_shapes(source, visual=True), start=1):
            name = prefix + source.body(k).name
            of_hand = name in own
            label = arm.side if of_hand else f"{arm.side}_arm"
            colour = (HAND_COLOURS if of_hand else ARM_COLOURS)[arm.side]
            parts = tuple(
                moved(mesh_part(geom.vertices, geom.faces, colour, label), geom.R, geom.pos)
                for geom in geoms
            )
            bodies.append(DrawnBody(int(model.body(name).id), name, label, parts))
    return _Drawn(
        model,
        np.array([model.jnt_qposadr[names[n]] for n in arm.chain.joint_names]),
        np.array([model.jnt_qposadr[names[n]] for n in hand.joint_names], np.int64),
        tuple(bodies),
    )
