"""Warp kernels of the batched contact QP: projected gradient with exact projections.

Problem (p, k, t): grasp p, contact group k (one hand, or both), target wrench t. One thread per
problem; forces are world-fixed vectors, so no tangent frames are needed.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

# The pressure is piecewise linear in its multiplier, with 3 kinks a contact: at most so many Newton
# steps in one iteration, the last one from an error of at most this share of gamma.
PRESSURE_STEPS = wp.constant(24)
PRESSURE_TOLERANCE = wp.constant(1.0e-2)
TINY = wp.constant(1.0e-12)


@wp.func
def side_outward(n: wp.vec3, tangent: wp.vec3, sides: int) -> wp.vec3:
    """Tangential unit normal of the pyramid's side that a tangential force leans on.

    Sides lie at the multiples of 2 pi / sides from the first axis of `frames.rotation_with_z`.
    """
    least = wp.min(wp.abs(n))
    axis = wp.vec3(0.0, 0.0, 1.0)
    if wp.abs(n[0]) == least:
        axis = wp.vec3(1.0, 0.0, 0.0)
    elif wp.abs(n[1]) == least:
        axis = wp.vec3(0.0, 1.0, 0.0)
    d = wp.normalize(wp.cross(axis, n))
    e = wp.cross(n, d)
    width = 2.0 * wp.pi / float(sides)
    angle = width * wp.round(wp.atan2(wp.dot(tangent, e), wp.dot(tangent, d)) / width)
    return wp.cos(angle) * d + wp.sin(angle) * e


@wp.func
def split(y: wp.vec3, n: wp.vec3, sides: int) -> wp.vec3:
    """Parts of a force: along n, across a side of the pyramid, and along that side (at least 0).

    A round cone has its side wherever the force leans, so nothing is left along it.
    """
    along = wp.dot(y, n)
    tangent = y - along * n
    if sides == 0:
        return wp.vec3(along, wp.length(tangent), 0.0)
    outward = side_outward(n, tangent, sides)
    across = wp.dot(tangent, outward)
    return wp.vec3(along, across, wp.length(tangent - across * outward))


@wp.func
def pressure_and_slope(part: wp.vec3, shift: float, cone: wp.vec2, cap: float) -> wp.vec2:
    """Normal part of the projection of (along + shift, across, beside), and its derivative by shift.

    At height 1 a side is cone[0] from the axis and 2 cone[1] wide: mu and 0 for a round cone.
    """
    along = part[0] + shift
    if along + cone[0] * part[1] + cone[1] * part[2] <= 0.0:
        return wp.vec2(0.0, 0.0)  # nearest is the tip
    pressed = along
    slope = float(1.0)
    if part[1] > cone[0] * along:
        slope = 1.0 / (1.0 + cone[0] * cone[0])
        pressed = (along + cone[0] * part[1]) * slope
        if part[2] > cone[1] * pressed:  # beyond the side: nearest is an edge
            slope = 1.0 / (1.0 + cone[0] * cone[0] + cone[1] * cone[1])
            pressed = (along + cone[0] * part[1] + cone[1] * part[2]) * slope
    if pressed >= cap:
        return wp.vec2(cap, 0.0)
    return wp.vec2(pressed, slope)


@wp.func
def projected(
    n: wp.vec3, tangent: wp.vec3, part: wp.vec3, shift: float, cone: wp.vec2, cap: float, sides: int
) -> wp.vec3:
    """Closest force to tangent + (part[0] + shift) n in the capped cone or pyramid."""
    pressed = pressure_and_slope(part, shift, cone, cap)[0]
    if sides == 0:
        return pressed * n + wp.min(1.0, cone[0] * pressed / wp.max(part[1], TINY)) * tangent
    outward = side_outward(n, tangent, sides)
    beside = tangent - part[1] * outward
    kept = wp.min(1.0, cone[1] * pressed / wp.max(part[2], TINY))
    return pressed * n + wp.min(part[1], cone[0] * pressed) * outward + kept * beside


@wp.func
def hand_pressure(
    parts: wp.array[wp.vec3], start: int, stop: int, shift: float, cone: wp.vec2, cap: float
) -> wp.vec2:
    """Sum over a hand of the normal parts of the projections of y + shift n, and its derivative."""
    total = wp.vec2(0.0, 0.0)
    for c in range(start, stop):
        total += pressure_and_slope(parts[c], shift, cone, cap)
    return total


@wp.func
def pressure_shift(
    parts: wp.array[wp.vec3],
    start: int,
    stop: int,
    guess: float,
    pressure_at_guess: wp.vec2,
    cone: wp.vec2,
    cap: float,
    gamma: float,
) -> float:
    """Shift along the normals at which a hand's projected forces press with gamma.

    It is the multiplier of the pressure bound: projecting y + shift n onto the cones is then the
    exact projection onto cones and bound together. Newton, kept between the shifts known to press
    too little and too much; where nothing answers (all released, or all at the cap) it doubles.
    """
    shift = guess
    pressure = pressure_at_guess
    low = float(-1.0)
    high = float(-1.0)
    for _ in range(PRESSURE_STEPS):
        missing = gamma - pressure[0]
        if shift == 0.0 and missing <= 0.0:
            break
        if missing > 0.0:
            low = shift
        else:
            high = shift
        if pressure[1] > 0.0:
            shift = wp.max(shift + missing / pressure[1], 0.0)
            if wp.abs(missing) < PRESSURE_TOLERANCE * gamma:
                break
        elif missing > 0.0:
            shift = 2.0 * shift + gamma
        else:
            shift = 0.0
        if high >= 0.0 and (shift <= low or shift >= high):
            shift = 0.5 * (wp.max(low, 0.0) + high)
        pressure = hand_pressure(parts, start, stop, shift, cone, cap)
    return shift


@wp.kernel
def contact_qp_kernel(
    # Contacts in:
    points_in: wp.array2d[wp.vec3],
    normals_in: wp.array2d[wp.vec3],
    length_in: wp.array[float],
    # Problem in:
    group_first_hand: wp.array[int],
    group_hands: wp.array[int],
    group_layer: wp.array[int],
    hand_start: wp.array[int],
    hand_stop: wp.array[int],
    targets: wp.array3d[wp.vec3],
    mu: float,
    sides: int,
    gamma: float,
    cap: float,
    beta: float,
    iterations: int,
    # In and out: start and result
    forces: wp.array4d[wp.vec3],
    # Scratch: parts of each y, as `split` gives them
    parts_out: wp.array4d[wp.vec3],
    # Out:
    residual_out: wp.array3d[float],
    residual_force_out: wp.array3d[wp.vec3],
    residual_torque_out: wp.array3d[wp.vec3],
):
    """Improve the forces of one problem and write its residual."""
    p, k, t = wp.tid()
    layer = group_layer[k]
    h0 = group_first_hand[k]
    h1 = h0 + group_hands[k]
    inv_length = 1.0 / length_in[p]
    mine = p % targets.shape[0]
    target_f = beta * targets[mine, t, 0]
    target_t = beta * targets[mine, t, 1]
    points = points_in[p]
    normals = normals_in[p]
    force = forces[p, layer, t]
    parts = parts_out[p, layer, t]
    cone = wp.vec2(mu, 0.0)
    if sides > 0:
        cone[1] = mu * wp.tan(wp.pi / float(sides))

    # Residual of the start, and the step: 1.6 over a bound of the largest eigenvalue of G G^T.
    r_f = -target_f
    r_t = -target_t
    bound = float(0.0)
    for h in range(h0, h1):
        for c in range(hand_start[h], hand_stop[h]):
            q = points[c] * inv_length
            f = force[c]
            r_f += f
            r_t += wp.cross(q, f)
            bound += 1.0 + wp.dot(q, q)
    step = 1.6 / wp.max(bound, 1.0)
    shifts = wp.vec2(0.0, 0.0)

    for _ in range(iterations):
        next_f = -target_f
        next_t = -target_t
        for h in range(h0, h1):
            start = hand_start[h]
            stop = hand_stop[h]
            # The multiplier of the pressure bound shifts y along n; it moves little from one
            # iteration to the next, so Newton continues from there.
            shift = shifts[h - h0]
            pressure = wp.vec2(0.0, 0.0)
            for c in range(start, stop):
                n = normals[c]
                y = force[c] - step * (r_f + wp.cross(r_t, points[c] * inv_length))
                part = split(y, n, sides)
                force[c] = y - part[0] * n
                parts[c] = part
                pressure += pressure_and_slope(part, shift, cone, cap)
            if shift > 0.0 or pressure[0] < gamma:
                shift = pressure_shift(parts, start, stop, shift, pressure, cone, cap, gamma)
                shifts[h - h0] = shift
            for c in range(start, stop):
                f = projected(normals[c], force[c], parts[c], shift, cone, cap, sides)
                force[c] = f
                next_f += f
                next_t += wp.cross(points[c] * inv_length, f)
        r_f = next_f
        r_t = next_t

    residual_out[p, k, t] = wp.dot(r_f, r_f) + wp.dot(r_t, r_t)
    residual_force_out[p, k, t] = r_f
    residual_torque_out[p, k, t] = r_t


@wp.kernel
def contact_qp_gradient_kernel(
    # Contacts in:
    points_in: wp.array2d[wp.vec3],
    normals_in: wp.array2d[wp.vec3],
    length_in: wp.array[float],
    # Problem in:
    group_first_hand: wp.array[int],
    group_hands: wp.array[int],
    group_layer: wp.array[int],
    group_weight: wp.array[float],
    contact_hand: wp.array[int],
    # Solution in:
    forces_in: wp.array4d[wp.vec3],
    residual_force_in: wp.array3d[wp.vec3],
    residual_torque_in: wp.array3d[wp.vec3],
    # Out:
    grad_points_out: wp.array2d[wp.vec3],
    grad_normals_out: wp.array2d[wp.vec3],
):
    """Sum one contact's envelope gradient over the groups of its hand and the targets."""
    p, c = wp.tid()
    d_point = wp.vec3(0.0)
    d_normal = wp.vec3(0.0)
    hand = contact_hand[c]
    if hand >= 0:
        n = normals_in[p, c]
        inv_length = 1.0 / length_in[p]
        q = points_in[p, c] * inv_length
        for k in range(group_layer.shape[0]):
            h0 = group_first_hand[k]
            if hand >= h0 and hand < h0 + group_hands[k]:
                w = 2.0 * group_weight[k]
                layer = group_layer[k]
                for t in range(forces_in.shape[2]):
                    f = forces_in[p, layer, t, c]
                    r_t = residual_torque_in[p, k, t]
                    g = residual_force_in[p, k, t] + wp.cross(r_t, q)
                    d_point += w * inv_length * wp.cross(f, r_t)
                    d_normal += w * (wp.dot(f, n) * g - wp.dot(g, n) * f)
    grad_points_out[p, c] = d_point
    grad_normals_out[p, c] = d_normal
