"""The step rule: Adam on a rigid base and joints, one hand, one thread per grasp.

Gradient layout, (N, 6 + D): base translation, base rotation (infinitesimal, object frame, about
the base's origin), free joint variables. One second moment serves all of the translation, one the
rotation and one each joint, so directions in space are not distorted.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

TINY = wp.constant(1.0e-7)


@wp.func
def rotation_exponential(w: wp.vec3) -> wp.mat33:
    """Rotation matrix of the rotation vector w [rad]."""
    angle = wp.length(w)
    return wp.quat_to_matrix(wp.quat_from_axis_angle(w / wp.max(angle, TINY), angle))


@wp.kernel
def adam_step(
    # Hand:
    lower: wp.array[float],
    upper: wp.array[float],
    # Rule:
    beta1: float,
    beta2: float,
    step_position: float,
    step_rotation: float,
    step_joints: float,
    # Schedule: share of the first step length, and 1 / (1 - beta^t) of both moments
    fraction: float,
    correct1: float,
    correct2: float,
    # Problem in:
    gradient_in: wp.array2d[float],
    # Problem out:
    first_inout: wp.array2d[float],
    second_inout: wp.array2d[float],
    position_inout: wp.array[wp.vec3],
    rotation_inout: wp.array[wp.mat33],
    joints_inout: wp.array2d[float],
):
    """Move one hand of each grasp; joints stay within their limits."""
    grasp = wp.tid()
    mean = wp.vec3(0.0, 0.0, 0.0)
    for part in range(2):
        squared = float(0.0)
        for k in range(3):
            g = gradient_in[grasp, 3 * part + k]
            squared += g * g
            m = beta1 * first_inout[grasp, 3 * part + k] + (1.0 - beta1) * g
            first_inout[grasp, 3 * part + k] = m
            mean[k] = m
        v = beta2 * second_inout[grasp, part] + (1.0 - beta2) * squared
        second_inout[grasp, part] = v
        move = (-fraction * correct1 / (wp.sqrt(correct2 * v) + TINY)) * mean
        if part == 0:
            position_inout[grasp] = position_inout[grasp] + step_position * move
        else:
            turn = rotation_exponential(step_rotation * move)
            rotation_inout[grasp] = turn * rotation_inout[grasp]
    for d in range(joints_inout.shape[1]):
        g = gradient_in[grasp, 6 + d]
        m = beta1 * first_inout[grasp, 6 + d] + (1.0 - beta1) * g
        v = beta2 * second_inout[grasp, 2 + d] + (1.0 - beta2) * g * g
        first_inout[grasp, 6 + d] = m
        second_inout[grasp, 2 + d] = v
        u = joints_inout[grasp, d] - step_joints * fraction * correct1 * m / (
            wp.sqrt(correct2 * v) + TINY
        )
        joints_inout[grasp, d] = wp.clamp(u, lower[d], upper[d])
