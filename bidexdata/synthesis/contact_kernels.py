"""Energies of the contact points: distance, region, pad angle, fixed targets.

Axes: N grasps, M contact points of both hands (left first). A hand's contact is a sphere; the
paper's contact point c_iw is the sphere's point that faces the surface, centre + radius x inward
normal, in every term. Gradients are with respect to contact centres, pad normals and inward
surface normals; `distance_field_kernels.surface_chain` carries the last to the centres. The float64
reference is in `energies.py`.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def region_penalty(d: float, a: float) -> wp.vec2:
    """Penalty phi(d) with b = 2 a and its derivative (paper, appendix B)."""
    if d <= a:
        return wp.vec2(0.0, 0.0)
    x = d - a
    if d > 2.0 * a:
        return wp.vec2(x, 1.0)
    t = x / a
    return wp.vec2((3.0 - 2.0 * t) * t * t * x, (9.0 - 8.0 * t) * t * t)


@wp.kernel
def contact_distance(
    # Hand:
    radius: wp.array[float],
    # Energy:
    weight: float,
    target: float,
    # Problem in:
    distance_in: wp.array2d[float],
    gradient_in: wp.array2d[wp.vec3],
    # Problem out:
    energy_out: wp.array2d[float],
    centre_gradient_out: wp.array2d[wp.vec3],
):
    """Squared deviation of each pad's distance from its target; starts the centre gradient."""
    grasp, i = wp.tid()
    e = distance_in[grasp, i] - radius[i] - target
    energy_out[grasp, i] = e * e
    centre_gradient_out[grasp, i] = (2.0 * weight * e) * gradient_in[grasp, i]


@wp.kernel
def contact_target(
    # Hand:
    radius: wp.array[float],
    # Energy:
    weight: float,
    target: float,
    # Problem in:
    centres_in: wp.array2d[wp.vec3],
    points_in: wp.array2d[wp.vec3],
    normals_in_in: wp.array2d[wp.vec3],
    # Problem out:
    energy_out: wp.array2d[float],
    centre_gradient_out: wp.array2d[wp.vec3],
):
    """Squared distance of each centre to its place above a frozen surface point."""
    grasp, i = wp.tid()
    goal = points_in[grasp, i] - (radius[i] + target) * normals_in_in[grasp, i]
    e = centres_in[grasp, i] - goal
    energy_out[grasp, i] = wp.length_sq(e)
    centre_gradient_out[grasp, i] = (2.0 * weight) * e


@wp.kernel
def contact_region(
    # Hand:
    side: wp.array[int],
    radius: wp.array[float],
    # Energy:
    weight: float,
    threshold: float,
    # Problem in:
    regions_in: wp.array3d[wp.vec3],
    centres_in: wp.array2d[wp.vec3],
    normals_in_in: wp.array2d[wp.vec3],
    # Problem out:
    energy_out: wp.array2d[float],
    centre_gradient_inout: wp.array2d[wp.vec3],
    normal_gradient_inout: wp.array2d[wp.vec3],
):
    """Penalty of each contact point's distance to the nearest of its hand's region, (N, H, k)."""
    grasp, i = wp.tid()
    c = centres_in[grasp, i] + radius[i] * normals_in_in[grasp, i]
    h = side[i]
    nearest = c - regions_in[grasp, h, 0]
    best = wp.length_sq(nearest)
    for j in range(1, regions_in.shape[2]):
        offset = c - regions_in[grasp, h, j]
        squared = wp.length_sq(offset)
        if squared < best:
            best = squared
            nearest = offset
    d = wp.sqrt(best)
    phi = region_penalty(d, threshold)
    energy_out[grasp, i] = phi[0]
    if phi[1] > 0.0:
        slope = (weight * phi[1] / d) * nearest
        centre_gradient_inout[grasp, i] = centre_gradient_inout[grasp, i] + slope
        normal_gradient_inout[grasp, i] = normal_gradient_inout[grasp, i] + radius[i] * slope


@wp.kernel
def contact_pad(
    # Energy:
    weight: float,
    cosine: float,
    # Problem in:
    pads_in: wp.array2d[wp.vec3],
    normals_in_in: wp.array2d[wp.vec3],
    # Problem out:
    energy_out: wp.array2d[float],
    pad_gradient_out: wp.array2d[wp.vec3],
    normal_gradient_inout: wp.array2d[wp.vec3],
):
    """Squared hinge of the angle between pad and surface; adds to the surface normal's gradient."""
    grasp, i = wp.tid()
    pad = pads_in[grasp, i]
    n = normals_in_in[grasp, i]
    h = wp.max(cosine - wp.dot(pad, n), 0.0)
    energy_out[grasp, i] = h * h
    pad_gradient_out[grasp, i] = (-2.0 * weight * h) * n
    normal_gradient_inout[grasp, i] = normal_gradient_inout[grasp, i] - (2.0 * weight * h) * pad


@wp.kernel
def shifted_centres(
    # Problem in:
    sets: int,
    shift: float,
    points_in: wp.array2d[wp.vec3],
    normals_in_in: wp.array2d[wp.vec3],
    size_in: wp.array[float],
    length_in: wp.array[float],
    # Problem out, `sets` rows for each grasp:
    centres_out: wp.array2d[wp.vec3],
    size_out: wp.array[float],
    length_out: wp.array[float],
):
    """Move every contact by `shift` in its tangent plane; set s moves all grasps' contacts alike."""
    row, i = wp.tid()
    grasp = row // sets
    n = normals_in_in[grasp, i]
    # The axis that is least along n gives the longest cross product.
    axis = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(n[1]) < wp.abs(n[0]):
        axis = wp.vec3(0.0, 1.0, 0.0)
    if wp.abs(n[2]) < wp.min(wp.abs(n[0]), wp.abs(n[1])):
        axis = wp.vec3(0.0, 0.0, 1.0)
    u = wp.normalize(wp.cross(n, axis))
    angle = 2.0 * wp.pi * wp.randf(wp.rand_init(row % sets, i))
    away = wp.cos(angle) * u + wp.sin(angle) * wp.cross(n, u)
    centres_out[row, i] = points_in[grasp, i] + shift * away
    if i == 0:
        size_out[row] = size_in[grasp]
        length_out[row] = length_in[grasp]
