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


@wp.func
def _beside(p: wp.vec3, n: wp.vec3, base: wp.vec3, shift: float, turn: float) -> wp.vec3:
    """The point `shift` away from p in the plane across n, `turn` of a circle from the hand's base.

    Turned or mirrored hands have turned or mirrored points, a mirrored one with -turn.
    """
    u = base - p
    u = wp.normalize(u - wp.dot(u, n) * n)
    angle = 2.0 * wp.pi * turn
    return p + shift * (wp.cos(angle) * u + wp.sin(angle) * wp.cross(n, u))


@wp.func
def _base_of(side: int, left: wp.vec3, right: wp.vec3) -> wp.vec3:
    if side == 0:
        return left
    return right


@wp.kernel
def circling_centres(
    # Hand:
    side: wp.array[int],
    # Closure:
    shift: float,
    turns: float,
    # Problem in:
    left_in: wp.array[wp.vec3],
    right_in: wp.array[wp.vec3],
    points_in: wp.array2d[wp.vec3],
    normals_in_in: wp.array2d[wp.vec3],
    # Problem out:
    centres_out: wp.array2d[wp.vec3],
):
    """Move every contact along a circle about its place: `turns` are those since the start.

    Each finger draws its start, a pace of 0.5 to 1.5 and a sense; hands are mirror images.
    """
    grasp, i = wp.tid()
    h = side[i]
    lot = wp.rand_init(0, i % (points_in.shape[1] // 2))
    turn = wp.randf(lot)
    pace = 0.5 + wp.randf(lot)
    if wp.randf(lot) < 0.5:
        pace = -pace
    turn = turn + pace * turns
    if h == 1:
        turn = -turn
    base = _base_of(h, left_in[grasp], right_in[grasp])
    centres_out[grasp, i] = _beside(points_in[grasp, i], normals_in_in[grasp, i], base, shift, turn)


@wp.kernel
def shifted_centres(
    # Hand:
    side: wp.array[int],
    # Problem in:
    sets: int,
    shift: float,
    left_in: wp.array[wp.vec3],
    right_in: wp.array[wp.vec3],
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
    base = _base_of(side[i], left_in[grasp], right_in[grasp])
    turn = wp.randf(wp.rand_init(row % sets, i))
    p, n = points_in[grasp, i], normals_in_in[grasp, i]
    centres_out[row, i] = _beside(p, n, base, shift, turn)
    if i == 0:
        size_out[row] = size_in[grasp]
        length_out[row] = length_in[grasp]
