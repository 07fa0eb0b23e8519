"""Forward kinematics of a hand and the transposed Jacobian, one thread per grasp.

Bodies come parents first, so forward is one pass up the indices and backward one pass down.
Nothing is added atomically: the same input gives the same bytes.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def turn(axis: wp.vec3, angle: float) -> wp.mat33:
    """Rotation about a unit axis (Rodrigues)."""
    s = wp.sin(angle)
    c = wp.cos(angle)
    t = 1.0 - c
    x = axis[0]
    y = axis[1]
    z = axis[2]
    return wp.mat33(
        c + t * x * x, t * x * y - s * z, t * x * z + s * y,
        t * x * y + s * z, c + t * y * y, t * y * z - s * x,
        t * x * z - s * y, t * y * z + s * x, c + t * z * z,
    )  # fmt: skip


@wp.kernel
def hand_forward(
    # Hand:
    body_parent: wp.array[int],
    body_pos: wp.array[wp.vec3],
    body_rot: wp.array[wp.mat33],
    body_joint: wp.array[int],
    joint_axis: wp.array[wp.vec3],
    joint_variable: wp.array[int],
    joint_factor: wp.array[float],
    contact_body: wp.array[int],
    contact_pos: wp.array[wp.vec3],
    contact_normal: wp.array[wp.vec3],
    sphere_body: wp.array[int],
    sphere_pos: wp.array[wp.vec3],
    # Pose in:
    position_in: wp.array[wp.vec3],
    rotation_in: wp.array[wp.mat33],
    variables_in: wp.array2d[float],
    # Points out:
    body_position_out: wp.array2d[wp.vec3],
    body_rotation_out: wp.array2d[wp.mat33],
    contact_out: wp.array2d[wp.vec3],
    normal_out: wp.array2d[wp.vec3],
    sphere_out: wp.array2d[wp.vec3],
):
    """Base pose and free variables -> body poses, contact centres, pad normals, spheres."""
    grasp = wp.tid()
    body_position_out[grasp, 0] = position_in[grasp]
    body_rotation_out[grasp, 0] = rotation_in[grasp]
    for b in range(1, body_parent.shape[0]):
        parent = body_parent[b]
        R = body_rotation_out[grasp, parent]
        body_position_out[grasp, b] = body_position_out[grasp, parent] + R * body_pos[b]
        R = R * body_rot[b]
        j = body_joint[b]
        if j >= 0:
            angle = joint_factor[j] * variables_in[grasp, joint_variable[j]]
            R = R * turn(joint_axis[j], angle)
        body_rotation_out[grasp, b] = R
    for c in range(contact_body.shape[0]):
        b = contact_body[c]
        R = body_rotation_out[grasp, b]
        contact_out[grasp, c] = body_position_out[grasp, b] + R * contact_pos[c]
        normal_out[grasp, c] = R * contact_normal[c]
    for k in range(sphere_body.shape[0]):
        b = sphere_body[k]
        sphere_out[grasp, k] = (
            body_position_out[grasp, b] + body_rotation_out[grasp, b] * sphere_pos[k]
        )


@wp.kernel
def hand_backward(
    # Hand:
    body_parent: wp.array[int],
    body_joint: wp.array[int],
    joint_axis: wp.array[wp.vec3],
    joint_variable: wp.array[int],
    joint_factor: wp.array[float],
    contact_body: wp.array[int],
    contact_pos: wp.array[wp.vec3],
    contact_normal: wp.array[wp.vec3],
    sphere_body: wp.array[int],
    sphere_pos: wp.array[wp.vec3],
    # Pose in:
    body_position_in: wp.array2d[wp.vec3],
    body_rotation_in: wp.array2d[wp.mat33],
    # Gradients in:
    contact_gradient_in: wp.array2d[wp.vec3],
    normal_gradient_in: wp.array2d[wp.vec3],
    sphere_gradient_in: wp.array2d[wp.vec3],
    # Scratch: what acts on a body and all that hangs from it
    force: wp.array2d[wp.vec3],
    moment: wp.array2d[wp.vec3],
    # Gradient out:
    gradient_out: wp.array2d[float],
):
    """Gradients at contacts, pads and spheres -> gradient of translation, rotation and u."""
    grasp = wp.tid()
    base = body_position_in[grasp, 0]
    for b in range(body_parent.shape[0]):
        force[grasp, b] = wp.vec3(0.0, 0.0, 0.0)
        moment[grasp, b] = wp.vec3(0.0, 0.0, 0.0)
    # Moments are about the base origin: small numbers, and the root's is the rotation gradient.
    for c in range(contact_body.shape[0]):
        b = contact_body[c]
        R = body_rotation_in[grasp, b]
        arm = body_position_in[grasp, b] - base + R * contact_pos[c]
        g = contact_gradient_in[grasp, c]
        force[grasp, b] = force[grasp, b] + g
        turning = wp.cross(R * contact_normal[c], normal_gradient_in[grasp, c])
        moment[grasp, b] = moment[grasp, b] + wp.cross(arm, g) + turning
    for k in range(sphere_body.shape[0]):
        b = sphere_body[k]
        g = sphere_gradient_in[grasp, k]
        arm = body_position_in[grasp, b] - base + body_rotation_in[grasp, b] * sphere_pos[k]
        force[grasp, b] = force[grasp, b] + g
        moment[grasp, b] = moment[grasp, b] + wp.cross(arm, g)
    for d in range(gradient_out.shape[1]):
        gradient_out[grasp, d] = 0.0
    last = body_parent.shape[0] - 1
    for i in range(last):
        b = last - i
        j = body_joint[b]
        if j >= 0:
            axis = body_rotation_in[grasp, b] * joint_axis[j]
            arm = body_position_in[grasp, b] - base
            slope = wp.dot(axis, moment[grasp, b] - wp.cross(arm, force[grasp, b]))
            d = 6 + joint_variable[j]
            gradient_out[grasp, d] = gradient_out[grasp, d] + joint_factor[j] * slope
        parent = body_parent[b]
        force[grasp, parent] = force[grasp, parent] + force[grasp, b]
        moment[grasp, parent] = moment[grasp, parent] + moment[grasp, b]
    for i in range(3):
        gradient_out[grasp, i] = force[grasp, 0][i]
        gradient_out[grasp, 3 + i] = moment[grasp, 0][i]
