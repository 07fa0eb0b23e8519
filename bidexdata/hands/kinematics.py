"""Forward kinematics of a hand in float64: the reference of the kernels.

Frames: every pose is given in the hand frame (the root body's) and moved by the base pose where a
function takes one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.frames import matrix_from_quat

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand


class HandPoints(NamedTuple):
    """Where a hand's contact points and spheres are; same frame as the base pose."""

    contact: Float[np.ndarray, "*b C 3"]
    """Centres of the contact spheres [m]."""
    normal: Float[np.ndarray, "*b C 3"]
    """Outward unit normals of the pads."""
    sphere: Float[np.ndarray, "*b K 3"]
    """Centres of the collision spheres [m]."""


def forward_kinematics(
    hand: Hand, joints: Float[np.ndarray, "*b J"]
) -> tuple[Float[np.ndarray, "*b B 3"], Float[np.ndarray, "*b B 3 3"]]:
    """Place every body in the hand frame.

    Args:
        hand: The hand.
        joints: Joint angles [rad].

    Returns:
        Positions of the bodies' origins [m], and their rotations.
    """
    joints = np.asarray(joints, np.float64)
    batch = joints.shape[:-1]
    fixed = matrix_from_quat(hand.body_quat_wxyz)
    pos = np.zeros((*batch, len(hand.body_names), 3))
    rot = np.zeros((*batch, len(hand.body_names), 3, 3))
    rot[..., 0, :, :] = np.eye(3)
    for b in range(1, len(hand.body_names)):
        parent, joint = hand.body_parent[b], hand.body_joint[b]
        pos[..., b, :] = pos[..., parent, :] + rot[..., parent, :, :] @ hand.body_pos[b]
        rot[..., b, :, :] = rot[..., parent, :, :] @ fixed[b]
        if joint >= 0:
            rot[..., b, :, :] @= _turn(hand.joint_axis[joint], joints[..., joint])
    return pos, rot


def hand_points(
    hand: Hand,
    joints: Float[np.ndarray, "*b J"],
    base_pos: Float[np.ndarray, "*b 3"] | None = None,
    base_quat_wxyz: Float[np.ndarray, "*b 4"] | None = None,
) -> HandPoints:
    """Place contact points, pad normals and spheres; in the hand frame without a base pose.

    Args:
        hand: The hand.
        joints: Joint angles [rad].
        base_pos: Origin of the hand frame in the frame wanted [m].
        base_quat_wxyz: Its orientation there.
    """
    pos, rot = forward_kinematics(hand, joints)
    contact = _place(pos, rot, hand.contact_body, hand.contact_pos)
    normal = _place(0 * pos, rot, hand.contact_body, hand.contact_normal)
    sphere = _place(pos, rot, hand.sphere_body, hand.sphere_pos)
    if base_pos is None or base_quat_wxyz is None:
        return HandPoints(contact, normal, sphere)
    R_t = np.swapaxes(matrix_from_quat(base_quat_wxyz), -1, -2)
    base = np.asarray(base_pos, np.float64)[..., None, :]
    return HandPoints(contact @ R_t + base, normal @ R_t, sphere @ R_t + base)


def _place(pos: np.ndarray, rot: np.ndarray, body: np.ndarray, local: np.ndarray) -> np.ndarray:
    return pos[..., body, :] + np.einsum("...kij,kj->...ki", rot[..., body, :, :], local)


def _turn(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotation matrices about a unit axis (Rodrigues), (*b, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.eye(3) + s * cross + (1 - c) * (cross @ cross)
