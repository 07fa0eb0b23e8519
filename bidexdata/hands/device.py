"""A hand as Warp arrays, and its two kernels as recorded launches.

A recorded launch is a callable that repeats itself on the arrays it was recorded with: it
allocates nothing and does not wait for the device.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bidexdata.errors import BadConfig
from bidexdata.frames import matrix_from_quat
from bidexdata.hands.model import Hand


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DeviceHand:
    """Arrays of one hand on one device, named and shaped as in `Hand`; float32."""

    device: str
    body_parent: Any
    body_pos: Any
    body_rot: Any
    """Orientation in the parent's frame at zero joint angle, (B,) mat33."""
    body_joint: Any
    joint_axis: Any
    joint_variable: Any
    """The free variable that moves each joint, (J,)."""
    joint_factor: Any
    """joint = factor * variable, (J,)."""
    contact_body: Any
    contact_pos: Any
    contact_normal: Any
    contact_radius: Any
    sphere_body: Any
    sphere_pos: Any
    sphere_radius: Any
    self_pairs: Any
    """(P, 2) int."""

    @property
    def bodies(self) -> int:
        """Number of bodies B."""
        return self.body_parent.shape[0]


def device_hand(hand: Hand, device: str = "cpu") -> DeviceHand:
    """Copy a hand's arrays to a device.

    Raises:
        BadConfig: A joint depends on more or less than one free variable.
    """
    import warp as wp

    wp.init()
    if np.any(np.count_nonzero(hand.coupling, axis=1) != 1):
        raise BadConfig(f"hand {hand.name!r}: each joint must follow exactly one free variable")
    variable = np.argmax(hand.coupling != 0, axis=1)
    factor = hand.coupling[np.arange(len(variable)), variable]

    def array(values: np.ndarray, dtype: Any) -> Any:
        kind = np.int32 if dtype is int else np.float32
        return wp.array(np.ascontiguousarray(values, dtype=kind), dtype=dtype, device=device)

    return DeviceHand(
        device=device,
        body_parent=array(hand.body_parent, int),
        body_pos=array(hand.body_pos, wp.vec3),
        body_rot=array(matrix_from_quat(hand.body_quat_wxyz), wp.mat33),
        body_joint=array(hand.body_joint, int),
        joint_axis=array(hand.joint_axis, wp.vec3),
        joint_variable=array(variable, int),
        joint_factor=array(factor, float),
        contact_body=array(hand.contact_body, int),
        contact_pos=array(hand.contact_pos, wp.vec3),
        contact_normal=array(hand.contact_normal, wp.vec3),
        contact_radius=array(hand.contact_radius, float),
        sphere_body=array(hand.sphere_body, int),
        sphere_pos=array(hand.sphere_pos, wp.vec3),
        sphere_radius=array(hand.sphere_radius, float),
        self_pairs=array(hand.self_pairs, int),
    )


def record_hand_forward(
    hand: DeviceHand,
    position: Any,
    rotation: Any,
    variables: Any,
    *,
    body_position: Any,
    body_rotation: Any,
    contact: Any,
    normal: Any,
    sphere: Any,
) -> Callable[[], Any]:
    """Record forward kinematics of N grasps.

    Args:
        hand: The hand.
        position: Origins of the hand frame [m], (N,) vec3.
        rotation: Its orientations, (N,) mat33.
        variables: Free variables u [rad], (N, D).
        body_position: Written: origins of the bodies [m], (N, B) vec3.
        body_rotation: Written: orientations of the bodies, (N, B) mat33.
        contact: Written: centres of the contact spheres [m], (N, C) vec3.
        normal: Written: outward pad normals, (N, C) vec3.
        sphere: Written: centres of the collision spheres [m], (N, K) vec3.

    Returns:
        The launch; all arrays are in the frame of the base pose.
    """
    import warp as wp

    from bidexdata.hands.kinematics_kernels import hand_forward

    inputs = [
        hand.body_parent, hand.body_pos, hand.body_rot, hand.body_joint,
        hand.joint_axis, hand.joint_variable, hand.joint_factor,
        hand.contact_body, hand.contact_pos, hand.contact_normal,
        hand.sphere_body, hand.sphere_pos,
        position, rotation, variables,
    ]  # fmt: skip
    outputs = [body_position, body_rotation, contact, normal, sphere]
    command = wp.launch(
        hand_forward, dim=len(position), inputs=inputs, outputs=outputs,
        device=hand.device, record_cmd=True,
    )  # fmt: skip
    return command.launch


def record_hand_backward(
    hand: DeviceHand,
    *,
    body_position: Any,
    body_rotation: Any,
    contact_gradient: Any,
    normal_gradient: Any,
    sphere_gradient: Any,
    gradient: Any,
) -> Callable[[], Any]:
    """Record the transposed Jacobian: gradients at points become gradients of the variables.

    Args:
        hand: The hand.
        body_position: As written by forward kinematics, (N, B) vec3.
        body_rotation: As written by forward kinematics, (N, B) mat33.
        contact_gradient: dE / d contact centre, (N, C) vec3.
        normal_gradient: dE / d pad normal, (N, C) vec3.
        sphere_gradient: dE / d sphere centre, (N, K) vec3.
        gradient: Written: dE with respect to translation (3), infinitesimal rotation about the
            base origin in the base pose's frame (3) and u (D), (N, 6 + D).

    Returns:
        The launch.
    """
    import warp as wp

    from bidexdata.hands.kinematics_kernels import hand_backward

    count = gradient.shape[0]
    scratch = [wp.empty((count, hand.bodies), dtype=wp.vec3, device=hand.device) for _ in range(2)]
    inputs = [
        hand.body_parent, hand.body_joint,
        hand.joint_axis, hand.joint_variable, hand.joint_factor,
        hand.contact_body, hand.contact_pos, hand.contact_normal,
        hand.sphere_body, hand.sphere_pos,
        body_position, body_rotation,
        contact_gradient, normal_gradient, sphere_gradient,
    ]  # fmt: skip
    command = wp.launch(
        hand_backward, dim=count, inputs=inputs, outputs=[*scratch, gradient],
        device=hand.device, record_cmd=True,
    )  # fmt: skip
    return command.launch
