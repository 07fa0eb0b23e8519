"""A hand's kinematic tree as URDF text, for engines that read no MJCF.

Kinematics only: links without mass or shape. Names, limits and frames are those of `Hand`, so a
joint vector means the same in both.
"""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from bidexdata.frames import matrix_from_quat
from bidexdata.hands.model import FloatArray, Hand


def hand_urdf(hand: Hand) -> str:
    """Write the tree: one link per body, one joint (revolute or fixed) per body but the root."""
    robot = ElementTree.Element("robot", name=f"{hand.name}_{hand.side}")
    for name in hand.body_names:
        ElementTree.SubElement(robot, "link", name=name)
    for body in range(1, len(hand.body_names)):
        _add_joint(robot, hand, body)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode")


def _add_joint(robot: ElementTree.Element, hand: Hand, body: int) -> None:
    index = hand.body_joint[body]
    name = hand.body_names[body]
    kind = "revolute" if index >= 0 else "fixed"
    joint_name = hand.joint_names[index] if index >= 0 else f"{name}_fixed"
    joint = ElementTree.SubElement(robot, "joint", name=joint_name, type=kind)
    ElementTree.SubElement(joint, "parent", link=hand.body_names[hand.body_parent[body]])
    ElementTree.SubElement(joint, "child", link=name)
    rpy = roll_pitch_yaw(matrix_from_quat(hand.body_quat_wxyz[body]))
    ElementTree.SubElement(joint, "origin", xyz=_text(hand.body_pos[body]), rpy=_text(rpy))
    if index >= 0:
        ElementTree.SubElement(joint, "axis", xyz=_text(hand.joint_axis[index]))
        limits = {"lower": hand.joint_lower[index], "upper": hand.joint_upper[index]}
        limits = {key: repr(float(value)) for key, value in limits.items()}
        ElementTree.SubElement(joint, "limit", effort="1", velocity="1", **limits)


def roll_pitch_yaw(R: FloatArray) -> FloatArray:
    """Angles [rad] with R = Rz(yaw) Ry(pitch) Rx(roll), as URDF means them, (3,)."""
    flat = np.hypot(R[0, 0], R[1, 0])
    pitch = np.arctan2(-R[2, 0], flat)
    if flat < 1e-9:
        # Pitch of a quarter turn: roll and yaw turn about one axis, so yaw may be zero.
        return np.array([np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def _text(values: FloatArray) -> str:
    return " ".join(repr(float(v)) for v in values)
