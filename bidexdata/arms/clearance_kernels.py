"""Warp kernels of clearance: spheres of arms and hands against all around them and each other.

One thread per configuration. Everything is in the world frame [m]; clearances are negative where
spheres overlap, and `most` where everything is at least that far away. A group whose ball is farther
away than what is nearest so far is passed over, which changes no result.
"""

import warp as wp

from bidexdata.arms.chain_kernels import ChainArrays
from bidexdata.arms.sphere_kernels import (
    HandArrays,
    SphereArrays,
    end_of_parts,
    hand_centre,
    part_ball,
    part_count,
    part_first,
    part_radius,
    part_total,
    place_spheres,
    whole_ball,
)
from bidexdata.objects.distance_field_kernels import DistanceField, signed_distance

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(1.0e3)


@wp.struct
class ObjectArrays:
    """The object of each row of configurations."""

    present: int
    low: wp.vec3
    """Corners of a box round the solid, object frame at unit diagonal."""
    high: wp.vec3
    size: wp.array(dtype=float)
    pos: wp.array(dtype=wp.vec3)
    rot: wp.array(dtype=wp.mat33)


@wp.func
def box_distance(half: wp.vec3, p: wp.vec3) -> float:
    """Signed distance from a point to an upright box round the origin."""
    out = wp.vec3(wp.abs(p[0]) - half[0], wp.abs(p[1]) - half[1], wp.abs(p[2]) - half[2])
    beyond = wp.vec3(wp.max(out[0], 0.0), wp.max(out[1], 0.0), wp.max(out[2], 0.0))
    return wp.length(beyond) + wp.min(wp.max(out[0], wp.max(out[1], out[2])), 0.0)


@wp.func
def fixture_gap(spheres: SphereArrays, p: wp.vec3, r: float) -> float:
    """Least distance from a sphere to the fixtures."""
    gap = float(FAR)
    for f in range(spheres.fixture_pos.shape[0]):
        gap = wp.min(gap, box_distance(spheres.fixture_half[f], p - spheres.fixture_pos[f]) - r)
    return gap


@wp.func
def object_gap(field: DistanceField, around: ObjectArrays, n: int, p: wp.vec3, r: float) -> float:
    """Distance from a sphere to the object of row n."""
    x = wp.transpose(around.rot[n]) * (p - around.pos[n])
    return signed_distance(field, around.size[n], x)[0] - r


@wp.func
def object_bound(around: ObjectArrays, n: int, p: wp.vec3, r: float) -> float:
    """What the distance from a sphere to the object of row n is not below: that to the box round it."""
    x = wp.transpose(around.rot[n]) * (p - around.pos[n])
    half = 0.5 * around.size[n] * (around.high - around.low)
    return box_distance(half, x - around.size[n] * around.low - half) - r


@wp.func
def self_gap(
    spheres: SphereArrays,
    hand: HandArrays,
    centre_in: wp.array2d(dtype=wp.vec3),
    m: int,
    n: int,
    least: float,
) -> float:
    """Least distance between links of the arm, and from its hand to them, or `least` if smaller."""
    count = spheres.radius.shape[0]
    groups = spheres.group_joint.shape[0]
    if hand.radius.shape[0] > 0:
        for g in range(spheres.far_groups):
            q = centre_in[m, count + g]
            broad = spheres.group_radius[g]
            if wp.length(hand_centre(centre_in, m) - q) - hand.whole_radius[n] - broad < least:
                for part in range(groups, part_total(spheres, hand)):
                    ball, wide = part_ball(spheres, hand, centre_in, m, n, part)
                    if wp.length(ball - q) - wide - broad < least:
                        first = part_first(spheres, hand, part)
                        for k in range(spheres.group_first[g], spheres.group_first[g + 1]):
                            p = centre_in[m, k]
                            r = spheres.radius[k]
                            if wp.length(ball - p) - wide - r < least:
                                for i in range(first, first + part_count(spheres, hand, part)):
                                    gap = wp.length(p - centre_in[m, i]) - r
                                    least = wp.min(least, gap - part_radius(spheres, hand, i))
    for c in range(spheres.pair_groups.shape[0]):
        g = spheres.pair_groups[c, 0]
        h = spheres.pair_groups[c, 1]
        apart = wp.length(centre_in[m, count + g] - centre_in[m, count + h])
        if apart - spheres.group_radius[g] - spheres.group_radius[h] < least:
            for i in range(spheres.pair_first[c], spheres.pair_first[c + 1]):
                a = spheres.pairs[i, 0]
                b = spheres.pairs[i, 1]
                gap = wp.length(centre_in[m, a] - centre_in[m, b])
                least = wp.min(least, gap - spheres.radius[a] - spheres.radius[b])
    return least


@wp.func
def alone_gaps(
    spheres: SphereArrays,
    hand: HandArrays,
    field: DistanceField,
    around: ObjectArrays,
    centre_in: wp.array2d(dtype=wp.vec3),
    m: int,
    n: int,
    most: float,
    enough: float,
) -> wp.vec3:
    """Least clearance of one arm from table, object, and itself with the fixtures."""
    table = most
    near = most
    itself = most
    parts = part_total(spheres, hand)
    if hand.radius.shape[0] > 0:
        whole = hand_centre(centre_in, m)
        size = hand.whole_radius[n]
        apart = whole[2] - size >= table and fixture_gap(spheres, whole, size) >= itself
        if around.present == 1:
            apart = apart and object_bound(around, n, whole, size) >= near
        if apart:
            parts = spheres.group_joint.shape[0]
    for back in range(parts - spheres.first_group):
        g = parts - 1 - back
        ball, wide = part_ball(spheres, hand, centre_in, m, n, g)
        by_table = ball[2] - wide < table
        by_object = around.present == 1 and object_bound(around, n, ball, wide) < near
        by_fixture = fixture_gap(spheres, ball, wide) < itself
        if by_table or by_object or by_fixture:
            first = part_first(spheres, hand, g)
            for k in range(first, first + part_count(spheres, hand, g)):
                p = centre_in[m, k]
                r = part_radius(spheres, hand, k)
                table = wp.min(table, p[2] - r)
                if by_object and object_bound(around, n, p, r) < near:
                    near = wp.min(near, object_gap(field, around, n, p, r))
                if by_fixture:
                    itself = wp.min(itself, fixture_gap(spheres, p, r))
            if wp.min(table, wp.min(near, itself)) < enough:
                return wp.vec3(table, near, itself)
    return wp.vec3(table, near, self_gap(spheres, hand, centre_in, m, n, itself))


@wp.kernel
def clear_alone(
    # Arm and hand:
    chain: ChainArrays,
    spheres: SphereArrays,
    hand: HandArrays,
    # Object, one pose per row of configurations:
    field: DistanceField,
    around: ObjectArrays,
    # Configurations in, and the row of hands and objects that each is of:
    q_in: wp.array2d(dtype=float),
    row_in: wp.array(dtype=int),
    # Larger clearances are given as this, and one below this ends the look:
    most: float,
    enough: float,
    # Centres of spheres and balls, and clearances from table, object and itself out:
    centre_out: wp.array2d(dtype=wp.vec3),
    gap_out: wp.array(dtype=wp.vec3),
):
    """Least clearance of one arm from table, object, and itself with the fixtures."""
    m = wp.tid()
    n = row_in[m]
    place_spheres(chain, spheres, hand, q_in, m, n, centre_out)
    gap_out[m] = alone_gaps(spheres, hand, field, around, centre_out, m, n, most, enough)


@wp.func
def gap_of_parts(
    left: SphereArrays,
    right: SphereArrays,
    left_hand: HandArrays,
    right_hand: HandArrays,
    left_in: wp.array2d(dtype=wp.vec3),
    right_in: wp.array2d(dtype=wp.vec3),
    a: int,
    b: int,
    n: int,
    l: int,
    left_first: int,
    right_first: int,
    least: float,
) -> float:
    """Least distance between a link or hand of each arm, or `least` if smaller."""
    for g in range(left_first, end_of_parts(left, left_hand, left_first)):
        p, wide = part_ball(left, left_hand, left_in, a, n, g)
        for h in range(right_first, end_of_parts(right, right_hand, right_first)):
            x, broad = part_ball(right, right_hand, right_in, b, l, h)
            if wp.length(p - x) - wide - broad < least:
                first = part_first(left, left_hand, g)
                other = part_first(right, right_hand, h)
                for i in range(part_count(left, left_hand, g)):
                    y = left_in[a, first + i]
                    r = part_radius(left, left_hand, first + i)
                    if wp.length(y - x) - r - broad < least:
                        for j in range(part_count(right, right_hand, h)):
                            gap = wp.length(y - right_in[b, other + j]) - r
                            s = part_radius(right, right_hand, other + j)
                            least = wp.min(least, gap - s)
    return least


@wp.func
def gap_between(
    left: SphereArrays,
    right: SphereArrays,
    left_hand: HandArrays,
    right_hand: HandArrays,
    left_in: wp.array2d(dtype=wp.vec3),
    right_in: wp.array2d(dtype=wp.vec3),
    a: int,
    b: int,
    n: int,
    l: int,
    most: float,
    enough: float,
) -> float:
    """Least clearance between configurations a and b of two arms with their hands, of rows n and l."""
    left_arm = left.group_joint.shape[0]
    right_arm = right.group_joint.shape[0]
    least = most
    for part in range(left_arm + 1):
        # The hand first, as one, then links from the last on.
        g = left_arm - part
        p, wide = whole_ball(left, left_hand, left_in, a, n, g)
        for behind in range(right_arm + 1):
            h = right_arm - behind
            x, broad = whole_ball(right, right_hand, right_in, b, l, h)
            if wp.length(p - x) - wide - broad < least:
                least = gap_of_parts(
                    left,
                    right,
                    left_hand,
                    right_hand,
                    left_in,
                    right_in,
                    a,
                    b,
                    n,
                    l,
                    g,
                    h,
                    least,
                )
                if least < enough:
                    return least
    return least


@wp.kernel
def clear_of_each_other(
    # Arms and hands:
    left: SphereArrays,
    right: SphereArrays,
    left_hand: HandArrays,
    right_hand: HandArrays,
    # Centres at configurations in, and the row of hands that each is of:
    left_in: wp.array2d(dtype=wp.vec3),
    right_in: wp.array2d(dtype=wp.vec3),
    left_row_in: wp.array(dtype=int),
    right_row_in: wp.array(dtype=int),
    # Which of each arm's are taken together:
    pair_in: wp.array2d(dtype=int),
    # Larger clearances are given as this, and one below this ends the look:
    most: float,
    enough: float,
    # Clearances out:
    gap_out: wp.array(dtype=float),
):
    """Least clearance between two arms with their hands."""
    m = wp.tid()
    a = pair_in[m, 0]
    b = pair_in[m, 1]
    n = left_row_in[a]
    l = right_row_in[b]
    gap_out[m] = gap_between(
        left, right, left_hand, right_hand, left_in, right_in, a, b, n, l, most, enough
    )


@wp.kernel
def clear_together(
    # Arms and hands:
    left_chain: ChainArrays,
    right_chain: ChainArrays,
    left: SphereArrays,
    right: SphereArrays,
    left_hand: HandArrays,
    right_hand: HandArrays,
    # Object, one pose per row of configurations:
    field: DistanceField,
    around: ObjectArrays,
    # Configurations in, and the row of hands and objects that each is of:
    left_q_in: wp.array2d(dtype=float),
    right_q_in: wp.array2d(dtype=float),
    row_in: wp.array(dtype=int),
    # Larger clearances are given as this, between the arms and of each alone:
    apart_most: float,
    alone_most: float,
    # Centres of spheres and balls out, and clearances between the arms, of the left and of the right:
    left_out: wp.array2d(dtype=wp.vec3),
    right_out: wp.array2d(dtype=wp.vec3),
    gap_out: wp.array(dtype=wp.vec3),
):
    """Least clearance between two arms with their hands, and of each from all else."""
    m = wp.tid()
    n = row_in[m]
    none = float(-FAR)
    place_spheres(left_chain, left, left_hand, left_q_in, m, n, left_out)
    place_spheres(right_chain, right, right_hand, right_q_in, m, n, right_out)
    apart = gap_between(
        left, right, left_hand, right_hand, left_out, right_out, m, m, n, n, apart_most, none
    )
    one = alone_gaps(left, left_hand, field, around, left_out, m, n, alone_most, none)
    other = alone_gaps(right, right_hand, field, around, right_out, m, n, alone_most, none)
    gap_out[m] = wp.vec3(apart, wp.min(one), wp.min(other))


@wp.kernel
def room_of_hands(
    # Hand and object, by row:
    hand: HandArrays,
    field: DistanceField,
    around: ObjectArrays,
    # Rows of the ways, poses in, and ways on from them:
    row_in: wp.array(dtype=int),
    pos_in: wp.array(dtype=wp.vec3),
    rot_in: wp.array(dtype=wp.mat33),
    way_in: wp.array2d(dtype=wp.vec3),
    checks: int,
    # Least clearances from the object out: along the ways, and where they begin:
    room_out: wp.array2d(dtype=float),
    start_out: wp.array2d(dtype=float),
):
    """Least clearance of an open hand that moves on without turning, in equal steps."""
    w, d = wp.tid()
    n = row_in[w]
    room = float(FAR)
    start = float(FAR)
    for step in range(checks + 1):
        at = pos_in[w] + (float(step) / float(checks)) * way_in[w, d]
        least = float(FAR)
        if step > 0:
            least = room
        for b in range(hand.ball_radius.shape[1]):
            ball = at + rot_in[w] * hand.ball_pos[n, b]
            if object_bound(around, n, ball, hand.ball_radius[n, b]) < least:
                for i in range(hand.group_first[b], hand.group_first[b + 1]):
                    p = at + rot_in[w] * hand.pos[n, i]
                    if object_bound(around, n, p, hand.radius[i]) < least:
                        least = wp.min(least, object_gap(field, around, n, p, hand.radius[i]))
        if step == 0:
            start = least
        else:
            room = least
    room_out[w, d] = room
    start_out[w, d] = start
