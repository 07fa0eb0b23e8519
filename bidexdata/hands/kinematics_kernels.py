"""Warp kernels: a hand's points from base pose and free variables, and the way back for gradients.

One thread per grasp; the tree is walked in body order, so sums have one order and no atomics.
Rotations are matrices. `wp.tid()` is the grasp n in all kernels.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class HandArrays:
    """One hand on a device; shapes and units as in `Hand`, float32."""

    body_parent: wp.array(dtype=int)
    body_pos: wp.array(dtype=wp.vec3)
    body_rot: wp.array(dtype=wp.mat33)
    body_joint: wp.array(dtype=int)
    joint_axis: wp.array(dtype=wp.vec3)
    joint_free: wp.array(dtype=int)
    """Free variable that drives each joint, (J,)."""
    joint_ratio: wp.array(dtype=float)
    """Joint angle per free variable, (J,)."""
    contact_body: wp.array(dtype=int)
    contact_pos: wp.array(dtype=wp.vec3)
    contact_normal: wp.array(dtype=wp.vec3)
    sphere_body: wp.array(dtype=int)
    sphere_pos: wp.array(dtype=wp.vec3)
    sphere_radius: wp.array(dtype=float)


@wp.func
def turn_about(axis: wp.vec3, angle: float) -> wp.mat33:
    """Rotation matrix about a unit axis (Rodrigues)."""
    s = wp.sin(angle)
    c = wp.cos(angle)
    k = wp.skew(axis)
    return wp.identity(n=3, dtype=float) + s * k + (1.0 - c) * (k * k)


@wp.kernel
def hand_forward(
    # Hand:
    hand: HandArrays,
    # Grasps in:
    base_pos_in: wp.array(dtype=wp.vec3),
    base_rot_in: wp.array(dtype=wp.mat33),
    free_in: wp.array2d(dtype=float),
    # Grasps out:
    body_pos_out: wp.array2d(dtype=wp.vec3),
    body_rot_out: wp.array2d(dtype=wp.mat33),
    contact_out: wp.array2d(dtype=wp.vec3),
    normal_out: wp.array2d(dtype=wp.vec3),
    sphere_out: wp.array2d(dtype=wp.vec3),
):
    """Place bodies, contact spheres, pad normals and collision spheres in the base's frame."""
    n = wp.tid()
    body_pos_out[n, 0] = base_pos_in[n]
    body_rot_out[n, 0] = base_rot_in[n]
    for b in range(1, hand.body_parent.shape[0]):
        parent = hand.body_parent[b]
        parent_rot = body_rot_out[n, parent]
        rot = parent_rot * hand.body_rot[b]
        joint = hand.body_joint[b]
        if joint >= 0:
            angle = hand.joint_ratio[joint] * free_in[n, hand.joint_free[joint]]
            rot = rot * turn_about(hand.joint_axis[joint], angle)
        body_pos_out[n, b] = body_pos_out[n, parent] + parent_rot * hand.body_pos[b]
        body_rot_out[n, b] = rot
    for c in range(hand.contact_body.shape[0]):
        carrier = hand.contact_body[c]
        carrier_rot = body_rot_out[n, carrier]
        contact_out[n, c] = body_pos_out[n, carrier] + carrier_rot * hand.contact_pos[c]
        normal_out[n, c] = carrier_rot * hand.contact_normal[c]
    for k in range(hand.sphere_body.shape[0]):
        holder = hand.sphere_body[k]
        sphere_out[n, k] = body_pos_out[n, holder] + body_rot_out[n, holder] * hand.sphere_pos[k]


@wp.kernel
def hand_backward(
    # Hand:
    hand: HandArrays,
    # State in, as hand_forward gave it:
    body_pos_in: wp.array2d(dtype=wp.vec3),
    body_rot_in: wp.array2d(dtype=wp.mat33),
    contact_in: wp.array2d(dtype=wp.vec3),
    normal_in: wp.array2d(dtype=wp.vec3),
    sphere_in: wp.array2d(dtype=wp.vec3),
    # Gradients in:
    contact_grad_in: wp.array2d(dtype=wp.vec3),
    normal_grad_in: wp.array2d(dtype=wp.vec3),
    sphere_grad_in: wp.array2d(dtype=wp.vec3),
    # Scratch, (N, B):
    force_out: wp.array2d(dtype=wp.vec3),
    torque_out: wp.array2d(dtype=wp.vec3),
    # Gradient out:
    gradient_out: wp.array2d(dtype=float),
):
    """Pull gradients at points back to the free variables, as forces pull on a mechanism.

    gradient_out[n] = base translation (3), base rotation about the base's origin in the frame of
    the base pose (3, infinitesimal), free variables (D). It is overwritten, not added to.
    """
    n = wp.tid()
    bodies = hand.body_parent.shape[0]
    base = body_pos_in[n, 0]
    for b in range(bodies):
        force_out[n, b] = wp.vec3(0.0, 0.0, 0.0)
        torque_out[n, b] = wp.vec3(0.0, 0.0, 0.0)
    for c in range(hand.contact_body.shape[0]):
        carrier = hand.contact_body[c]
        pull = contact_grad_in[n, c]
        twist = wp.cross(contact_in[n, c] - base, pull)
        twist += wp.cross(normal_in[n, c], normal_grad_in[n, c])
        force_out[n, carrier] = force_out[n, carrier] + pull
        torque_out[n, carrier] = torque_out[n, carrier] + twist
    for k in range(hand.sphere_body.shape[0]):
        holder = hand.sphere_body[k]
        push = sphere_grad_in[n, k]
        force_out[n, holder] = force_out[n, holder] + push
        torque_out[n, holder] = torque_out[n, holder] + wp.cross(sphere_in[n, k] - base, push)
    for i in range(gradient_out.shape[1]):
        gradient_out[n, i] = 0.0
    # Children come after their parents: walking down the list sums every subtree.
    for back in range(bodies - 1):
        body = bodies - 1 - back
        force = force_out[n, body]
        torque = torque_out[n, body]
        parent = hand.body_parent[body]
        force_out[n, parent] = force_out[n, parent] + force
        torque_out[n, parent] = torque_out[n, parent] + torque
        joint = hand.body_joint[body]
        if joint >= 0:
            axis = body_rot_in[n, body] * hand.joint_axis[joint]
            about = torque - wp.cross(body_pos_in[n, body] - base, force)
            column = 6 + hand.joint_free[joint]
            slope = hand.joint_ratio[joint] * wp.dot(axis, about)
            gradient_out[n, column] = gradient_out[n, column] + slope
    total = force_out[n, 0]
    moment = torque_out[n, 0]
    for j in range(3):
        gradient_out[n, j] = total[j]
        gradient_out[n, 3 + j] = moment[j]
