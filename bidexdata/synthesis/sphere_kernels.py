"""Energies of the collision spheres: object, table, the same hand, the other hand.

Axes: N grasps, K spheres of one hand. Every thread writes only its own grasp, so the sums have one
order and the bytes repeat. The float64 reference is in `energies.py`.
"""

import warp as wp

from bidexdata.objects.distance_field_kernels import DistanceField, signed_distance

wp.set_module_options({"enable_backward": False})

# A sphere that has moved less than this share of its clearance cannot touch. Interpolated
# distances of an exact field change by less than sqrt(3) times the way; 0.5 leaves room.
SAFE = wp.constant(0.5)
FAR_OFF = wp.constant(1.0e9)


@wp.struct
class Box:
    """Corners of an axis-aligned box."""

    low: wp.vec3
    high: wp.vec3


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
    # Problem out: where each sphere was last measured and its clearance there
    measured_inout: wp.array2d[wp.vec4],
    energy_out: wp.array2d[float],
    gradient_out: wp.array2d[wp.vec3],
):
    """Squared depth of each sphere in the object's margin; starts the sphere gradient.

    Most spheres are far from the object, so the field is read again only when a sphere may have
    come near it since it was last measured. That changes the cost, not the result. One thread per
    grasp: a thread costs as much as a sphere that stays clear.
    """
    grasp = wp.tid()
    for i in range(centres_in.shape[1]):
        c = centres_in[grasp, i]
        last = measured_inout[grasp, i]
        energy = float(0.0)
        gradient = wp.vec3(0.0, 0.0, 0.0)
        moved = c - wp.vec3(last[0], last[1], last[2])
        if last[3] <= 0.0 or wp.length_sq(moved) > last[3] * last[3]:
            s = signed_distance(field, size[grasp], c)
            clear = s[0] - radius[i] - margin
            if clear < 0.0:
                energy = clear * clear
                gradient = (2.0 * weight * clear) * wp.vec3(s[1], s[2], s[3])
            measured_inout[grasp, i] = wp.vec4(c[0], c[1], c[2], SAFE * clear)
        energy_out[grasp, i] = energy
        gradient_out[grasp, i] = gradient


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
    grasp = wp.tid()
    n = wp.vec3(plane[grasp][0], plane[grasp][1], plane[grasp][2])
    if wp.length_sq(n) > 0.0:
        for i in range(centres_in.shape[1]):
            d = wp.dot(n, centres_in[grasp, i]) + plane[grasp][3]
            h = radius[i] + margin - d
            if h > 0.0:
                energy_inout[grasp, i] = energy_inout[grasp, i] + h * h
                gradient_inout[grasp, i] = gradient_inout[grasp, i] - (2.0 * weight * h) * n


@wp.kernel
def sphere_self(
    # Hand:
    radius: wp.array[float],
    pairs: wp.array2d[int],
    groups: wp.array[wp.vec4i],
    group_reach: wp.array[float],
    # Energy:
    weight: float,
    margin: float,
    # Problem in:
    centres_in: wp.array2d[wp.vec3],
    # Problem out:
    energy_out: wp.array[float],
    gradient_inout: wp.array2d[wp.vec3],
):
    """Squared overlaps of a hand's sphere pairs, one thread per grasp.

    A group holds the pairs of two bodies; where the balls around their spheres are apart, so are
    all its pairs. That changes the cost, not the result.
    """
    grasp = wp.tid()
    energy = float(0.0)
    for g in range(groups.shape[0]):
        group = groups[g]
        between = centres_in[grasp, group[0]] - centres_in[grasp, group[1]]
        far = group_reach[g] + margin
        if wp.length_sq(between) < far * far:
            for p in range(group[2], group[3]):
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
def hand_box(
    # Hand:
    radius: wp.array[float],
    # Problem in:
    centres_in: wp.array2d[wp.vec3],
    # Problem out:
    low_out: wp.array[wp.vec3],
    high_out: wp.array[wp.vec3],
):
    """The axis-aligned box around all spheres of a hand, (N,)."""
    grasp = wp.tid()
    low = wp.vec3(FAR_OFF, FAR_OFF, FAR_OFF)
    high = -low
    for i in range(centres_in.shape[1]):
        c = centres_in[grasp, i]
        r = wp.vec3(radius[i], radius[i], radius[i])
        low = wp.min(low, c - r)
        high = wp.max(high, c + r)
    low_out[grasp] = low
    high_out[grasp] = high


@wp.func
def balls_box(
    hub: wp.array[int], radius: wp.array[float], centres: wp.array2d[wp.vec3], grasp: int
) -> Box:
    """The box around the balls that hold the spheres of a hand's bodies."""
    box = Box()
    box.low = wp.vec3(FAR_OFF, FAR_OFF, FAR_OFF)
    box.high = -box.low
    for b in range(hub.shape[0]):
        c = centres[grasp, hub[b]]
        r = wp.vec3(radius[b], radius[b], radius[b])
        box.low = wp.min(box.low, c - r)
        box.high = wp.max(box.high, c + r)
    return box


@wp.func
def outside(c: wp.vec3, box: Box) -> float:
    """Squared distance of a point from a box."""
    return wp.length_sq(c - wp.min(wp.max(c, box.low), box.high))


@wp.kernel
def hands_between(
    # Hands:
    radius: wp.array[float],
    other_radius: wp.array[float],
    ball_hub: wp.array[int],
    ball_radius: wp.array[float],
    other_ball_hub: wp.array[int],
    other_ball_radius: wp.array[float],
    # Energy:
    weight: float,
    margin: float,
    # Problem in:
    centres_in: wp.array2d[wp.vec3],
    other_in: wp.array2d[wp.vec3],
    # Problem out:
    energy_out: wp.array[float],
    gradient_inout: wp.array2d[wp.vec3],
    other_gradient_inout: wp.array2d[wp.vec3],
):
    """Squared overlaps of the spheres of one hand with those of the other, one thread per grasp.

    Most hands are apart: only where the boxes around them meet, spheres near a box are tested.
    """
    grasp = wp.tid()
    box = balls_box(ball_hub, ball_radius, centres_in, grasp)
    other_box = balls_box(other_ball_hub, other_ball_radius, other_in, grasp)
    beside = wp.max(box.low - other_box.high, other_box.low - box.high)
    energy = float(0.0)
    if wp.max(beside) < margin:
        for i in range(centres_in.shape[1]):
            c = centres_in[grasp, i]
            near = radius[i] + margin
            if outside(c, other_box) < near * near:
                for j in range(other_in.shape[1]):
                    offset = c - other_in[grasp, j]
                    reach = near + other_radius[j]
                    squared = wp.length_sq(offset)
                    if squared < reach * reach:
                        d = wp.sqrt(squared)
                        h = reach - d
                        energy += h * h
                        push = (-2.0 * weight * h / wp.max(d, 1.0e-9)) * offset
                        gradient_inout[grasp, i] = gradient_inout[grasp, i] + push
                        other_gradient_inout[grasp, j] = other_gradient_inout[grasp, j] - push
    energy_out[grasp] = energy
