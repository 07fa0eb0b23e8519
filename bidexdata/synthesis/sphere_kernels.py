"""Energies of the collision spheres: object, table, the same hand, the other hand.

Axes: N grasps, K spheres of one hand. Every thread writes only its own grasp or sphere, so the
sums have one order and the bytes repeat. The float64 reference is in `energies.py`.
"""

import warp as wp

from bidexdata.synthesis.distance_field_kernels import DistanceField, signed_distance

wp.set_module_options({"enable_backward": False})


@wp.kernel
def sphere_object(
    # Hand:
    radius: wp.array[float],
    # Object:
    field: DistanceField,
    size: wp.array[float],
    # Energy:
    weight: float,
    margin: float,
    # Problem in:
    centres_in: wp.array2d[wp.vec3],
    # Problem out:
    energy_out: wp.array2d[float],
    gradient_out: wp.array2d[wp.vec3],
):
    """Squared depth of each sphere in the object's margin; starts the sphere gradient."""
    grasp, i = wp.tid()
    s = signed_distance(field, size[grasp], centres_in[grasp, i])
    h = wp.max(radius[i] + margin - s[0], 0.0)
    energy_out[grasp, i] = h * h
    gradient_out[grasp, i] = (-2.0 * weight * h) * wp.vec3(s[1], s[2], s[3])


@wp.kernel
def sphere_plane(
    # Hand:
    radius: wp.array[float],
    # Object:
    plane: wp.array[wp.vec4],
    # Energy:
    weight: float,
    margin: float,
    # Problem in:
    centres_in: wp.array2d[wp.vec3],
    # Problem out:
    energy_inout: wp.array2d[float],
    gradient_inout: wp.array2d[wp.vec3],
):
    """Squared depth of each sphere under the plane n.x + w = 0 of its grasp (n = 0: no plane)."""
    grasp, i = wp.tid()
    n = wp.vec3(plane[grasp][0], plane[grasp][1], plane[grasp][2])
    if wp.length_sq(n) > 0.0:
        d = wp.dot(n, centres_in[grasp, i]) + plane[grasp][3]
        h = wp.max(radius[i] + margin - d, 0.0)
        energy_inout[grasp, i] = energy_inout[grasp, i] + h * h
        gradient_inout[grasp, i] = gradient_inout[grasp, i] - (2.0 * weight * h) * n


@wp.kernel
def sphere_self(
    # Hand:
    radius: wp.array[float],
    pairs: wp.array2d[int],
    # Energy:
    weight: float,
    margin: float,
    # Problem in:
    centres_in: wp.array2d[wp.vec3],
    # Problem out:
    energy_out: wp.array[float],
    gradient_inout: wp.array2d[wp.vec3],
):
    """Squared overlaps of a hand's sphere pairs, one thread per grasp."""
    grasp = wp.tid()
    energy = float(0.0)
    for p in range(pairs.shape[0]):
        a = pairs[p, 0]
        b = pairs[p, 1]
        offset = centres_in[grasp, a] - centres_in[grasp, b]
        reach = radius[a] + radius[b] + margin
        squared = wp.length_sq(offset)
        if squared < reach * reach:
            d = wp.sqrt(squared)
            h = reach - d
            energy += h * h
            push = (-2.0 * weight * h / wp.max(d, 1.0e-9)) * offset
            gradient_inout[grasp, a] = gradient_inout[grasp, a] + push
            gradient_inout[grasp, b] = gradient_inout[grasp, b] - push
    energy_out[grasp] = energy


@wp.kernel
def hand_ball(
    # Hand:
    radius: wp.array[float],
    # Problem in:
    centres_in: wp.array2d[wp.vec3],
    # Problem out:
    ball_out: wp.array[wp.vec4],
):
    """A ball (centre, radius) around all spheres of a hand, (N,)."""
    grasp = wp.tid()
    low = centres_in[grasp, 0]
    high = low
    for i in range(1, centres_in.shape[1]):
        low = wp.min(low, centres_in[grasp, i])
        high = wp.max(high, centres_in[grasp, i])
    middle = 0.5 * (low + high)
    reach = float(0.0)
    for i in range(centres_in.shape[1]):
        reach = wp.max(reach, wp.length(centres_in[grasp, i] - middle) + radius[i])
    ball_out[grasp] = wp.vec4(middle[0], middle[1], middle[2], reach)


@wp.kernel
def sphere_other(
    # Hand:
    radius: wp.array[float],
    other_radius: wp.array[float],
    # Energy:
    weight: float,
    margin: float,
    # Problem in:
    centres_in: wp.array2d[wp.vec3],
    other_in: wp.array2d[wp.vec3],
    other_ball_in: wp.array[wp.vec4],
    # Problem out:
    energy_out: wp.array2d[float],
    gradient_inout: wp.array2d[wp.vec3],
):
    """Squared overlaps of each sphere with the other hand's; half of the energy is each hand's."""
    grasp, i = wp.tid()
    c = centres_in[grasp, i]
    ball = other_ball_in[grasp]
    near = radius[i] + margin + ball[3]
    energy = float(0.0)
    if wp.length_sq(c - wp.vec3(ball[0], ball[1], ball[2])) < near * near:
        push = wp.vec3(0.0, 0.0, 0.0)
        for j in range(other_in.shape[1]):
            offset = c - other_in[grasp, j]
            reach = radius[i] + other_radius[j] + margin
            squared = wp.length_sq(offset)
            if squared < reach * reach:
                d = wp.sqrt(squared)
                h = reach - d
                energy += 0.5 * h * h
                push += (-2.0 * weight * h / wp.max(d, 1.0e-9)) * offset
        gradient_inout[grasp, i] = gradient_inout[grasp, i] + push
    energy_out[grasp, i] = energy
