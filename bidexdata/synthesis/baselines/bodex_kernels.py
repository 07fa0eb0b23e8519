"""BODex's step rule: gradients of unit length per group of variables, with momentum."""

import warp as wp

from bidexdata.synthesis.update_kernels import rotation_exponential

wp.set_module_options({"enable_backward": False})

TINY = wp.constant(1.0e-12)


@wp.kernel
def normalised_step(
    # Hand: limits and group (finger) of each free variable
    lower: wp.array[float],
    upper: wp.array[float],
    group: wp.array[int],
    # Rule:
    momentum: float,
    step_position: float,
    step_rotation: float,
    step_joints: float,
    # Schedule: share of the first step length
    fraction: float,
    # Problem in:
    gradient_in: wp.array2d[float],
    # Problem out:
    velocity_inout: wp.array2d[float],
    position_inout: wp.array[wp.vec3],
    rotation_inout: wp.array[wp.mat33],
    joints_inout: wp.array2d[float],
):
    """Move one hand of each grasp; groups are the translation, the rotation and each finger."""
    grasp = wp.tid()
    for part in range(2):
        squared = float(0.0)
        for k in range(3):
            g = gradient_in[grasp, 3 * part + k]
            squared += g * g
        scale = 1.0 / wp.max(wp.sqrt(squared), TINY)
        v = wp.vec3(0.0, 0.0, 0.0)
        for k in range(3):
            g = scale * gradient_in[grasp, 3 * part + k]
            v[k] = 0.5 * (momentum * velocity_inout[grasp, 3 * part + k] + g)
            velocity_inout[grasp, 3 * part + k] = v[k]
        if part == 0:
            position_inout[grasp] = position_inout[grasp] - (fraction * step_position) * v
        else:
            turn = rotation_exponential((-fraction * step_rotation) * v)
            rotation_inout[grasp] = turn * rotation_inout[grasp]
    for d in range(joints_inout.shape[1]):
        squared = float(0.0)
        for other in range(joints_inout.shape[1]):
            if group[other] == group[d]:
                squared += gradient_in[grasp, 6 + other] * gradient_in[grasp, 6 + other]
        g = gradient_in[grasp, 6 + d] / wp.max(wp.sqrt(squared), TINY)
        v_joint = 0.5 * (momentum * velocity_inout[grasp, 6 + d] + g)
        velocity_inout[grasp, 6 + d] = v_joint
        u = joints_inout[grasp, d] - fraction * step_joints * v_joint
        joints_inout[grasp, d] = wp.clamp(u, lower[d], upper[d])
