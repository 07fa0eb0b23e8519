"""Warp kernels of clearance: spheres of arms and hands against all around them and each other.

One thread per configuration. Everything is in the world frame [m]; clearances are negative where
spheres overlap, and `most` where everything is at least that far away. Spheres come in groups that lie
in a ball each, and a group whose ball is farther away than what is nearest so far is passed over, which
changes no result.
"""

import warp as wp

from bidexdata.arms.chain_kernels import ChainArrays, turn_about
from bidexdata.objects.distance_field_kernels import DistanceField, signed_distance

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(1.0e3)


@wp.struct
class SphereArrays:
    """The spheres of one arm on a device; shapes and units as in `ArmSpheres`.

    The ball of group g is number K + g among the centres, behind those of the spheres; the hand's
    spheres follow, the balls round their groups, and the ball round them all.
    """

    joint: wp.array(dtype=int)
    pos: wp.array(dtype=wp.vec3)
    radius: wp.array(dtype=float)
    pairs: wp.array2d(dtype=int)
    pair_groups: wp.array2d(dtype=int)
    """Groups whose spheres may meet, (P', 2)."""
    pair_first: wp.array(dtype=int)
    """First pair of each of them, and the number of pairs, (P' + 1)."""
    group_first: wp.array(dtype=int)
    """First sphere of each group, and the number of spheres, (G + 1)."""
    group_joint: wp.array(dtype=int)
    group_pos: wp.array(dtype=wp.vec3)
    group_radius: wp.array(dtype=float)
    fixture_pos: wp.array(dtype=wp.vec3)
    fixture_half: wp.array(dtype=wp.vec3)
    first_group: int
    """First group that a second joint of the chain, or a later one, moves."""
    far_groups: int
    """Groups, from the first on, that the hand of this arm may meet."""


@wp.struct
class HandArrays:
    """Spheres of a hand at N postures, balls round groups of them, (N, B), and one round all; hand frame."""

    pos: wp.array2d(dtype=wp.vec3)
    radius: wp.array(dtype=float)
    group_first: wp.array(dtype=int)
    """First sphere of each group, and the number of spheres, (B + 1)."""
    ball_pos: wp.array2d(dtype=wp.vec3)
    ball_radius: wp.array2d(dtype=float)
    whole_pos: wp.array(dtype=wp.vec3)
    whole_radius: wp.array(dtype=float)


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


@wp.kernel
def place_arm_spheres(
    # Arm:
    chain: ChainArrays,
    spheres: SphereArrays,
    hand: HandArrays,
    # Configurations in, and the row of hands and objects that each is of:
    q_in: wp.array2d(dtype=float),
    row_in: wp.array(dtype=int),
    # Centres out:
    centre_out: wp.array2d(dtype=wp.vec3),
):
    """Place spheres and balls, which lie in the order of the chain, and those of the hand."""
    m = wp.tid()
    n = row_in[m]
    at = wp.vec3(0.0, 0.0, 0.0)
    turn = wp.identity(n=3, dtype=float)
    k = wp.int32(0)
    g = wp.int32(0)
    count = spheres.radius.shape[0]
    groups = spheres.group_joint.shape[0]
    while k < count and spheres.joint[k] < 0:
        centre_out[m, k] = spheres.pos[k]
        k = k + 1
    while g < groups and spheres.group_joint[g] < 0:
        centre_out[m, count + g] = spheres.group_pos[g]
        g = g + 1
    for j in range(chain.count):
        at = at + turn * chain.before_pos[j]
        turn = turn * chain.before_rot[j] * turn_about(chain.axis[j], q_in[m, j])
        while k < count and spheres.joint[k] == j:
            centre_out[m, k] = at + turn * spheres.pos[k]
            k = k + 1
        while g < groups and spheres.group_joint[g] == j:
            centre_out[m, count + g] = at + turn * spheres.group_pos[g]
            g = g + 1
    held = hand.radius.shape[0]
    if held > 0:
        at = at + turn * chain.end_pos
        turn = turn * chain.end_rot
        first = count + groups
        for i in range(held):
            centre_out[m, first + i] = at + turn * hand.pos[n, i]
        for b in range(hand.ball_radius.shape[1]):
            centre_out[m, first + held + b] = at + turn * hand.ball_pos[n, b]
        last = centre_out.shape[1] - 1
        centre_out[m, last] = at + turn * hand.whole_pos[n]


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
def part_first(spheres: SphereArrays, hand: HandArrays, g: int) -> int:
    """First centre of group g; the groups behind the arm's are the hand's."""
    groups = spheres.group_joint.shape[0]
    if g < groups:
        return spheres.group_first[g]
    return spheres.radius.shape[0] + groups + hand.group_first[g - groups]


@wp.func
def part_count(spheres: SphereArrays, hand: HandArrays, g: int) -> int:
    """Spheres of group g."""
    groups = spheres.group_joint.shape[0]
    if g < groups:
        return spheres.group_first[g + 1] - spheres.group_first[g]
    return hand.group_first[g - groups + 1] - hand.group_first[g - groups]


@wp.func
def part_ball(
    spheres: SphereArrays,
    hand: HandArrays,
    centre_in: wp.array2d(dtype=wp.vec3),
    m: int,
    n: int,
    g: int,
):
    """Ball round group g."""
    at = spheres.radius.shape[0] + g
    groups = spheres.group_joint.shape[0]
    wide = float(0.0)
    if g < groups:
        wide = spheres.group_radius[g]
    else:
        at = at + hand.radius.shape[0]
        wide = hand.ball_radius[n, g - groups]
    return centre_in[m, at], wide


@wp.func
def part_radius(spheres: SphereArrays, hand: HandArrays, k: int) -> float:
    """Radius of the sphere whose centre is number k."""
    count = spheres.radius.shape[0]
    if k < count:
        return spheres.radius[k]
    return hand.radius[k - count - spheres.group_joint.shape[0]]


@wp.func
def part_total(spheres: SphereArrays, hand: HandArrays) -> int:
    """Groups of the arm, and of the hand if there is one."""
    return spheres.group_joint.shape[0] + hand.ball_radius.shape[1]


@wp.func
def hand_centre(centre_in: wp.array2d(dtype=wp.vec3), m: int) -> wp.vec3:
    """Centre of the ball round the whole hand, where there is one."""
    last = centre_in.shape[1] - 1
    return centre_in[m, last]


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


@wp.kernel
def clear_alone(
    # Arm and hand:
    spheres: SphereArrays,
    hand: HandArrays,
    # Object, one pose per row of configurations:
    field: DistanceField,
    around: ObjectArrays,
    # Configurations in, and the row of hands and objects that each is of:
    centre_in: wp.array2d(dtype=wp.vec3),
    row_in: wp.array(dtype=int),
    # Larger clearances are given as this:
    most: float,
    # Clearances out, from table, object and itself:
    gap_out: wp.array2d(dtype=float),
):
    """Least clearance of one arm from table, object, and itself with the fixtures."""
    m = wp.tid()
    n = row_in[m]
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
    gap_out[0, m] = table
    gap_out[1, m] = near
    gap_out[2, m] = self_gap(spheres, hand, centre_in, m, n, itself)


@wp.func
def whole_ball(
    spheres: SphereArrays,
    hand: HandArrays,
    centre_in: wp.array2d(dtype=wp.vec3),
    m: int,
    n: int,
    g: int,
):
    """Ball round group g of an arm, or round its whole hand where g is the number of those."""
    at = spheres.radius.shape[0] + g
    wide = float(-FAR)
    if g < spheres.group_joint.shape[0]:
        wide = spheres.group_radius[g]
    elif hand.radius.shape[0] > 0:
        at = centre_in.shape[1] - 1
        wide = hand.whole_radius[n]
    else:
        at = 0
    return centre_in[m, at], wide


@wp.func
def end_of_parts(spheres: SphereArrays, hand: HandArrays, g: int) -> int:
    """Behind the last part of group g of an arm, or of its hand where g is the number of those."""
    if g < spheres.group_joint.shape[0]:
        return g + 1
    return part_total(spheres, hand)


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


@wp.kernel
def clear_of_each_other(
    # Arms and hands:
    left: SphereArrays,
    right: SphereArrays,
    left_hand: HandArrays,
    right_hand: HandArrays,
    # Configurations in, and the row of hands that each is of:
    left_in: wp.array2d(dtype=wp.vec3),
    right_in: wp.array2d(dtype=wp.vec3),
    left_row_in: wp.array(dtype=int),
    right_row_in: wp.array(dtype=int),
    # Which of each arm's are taken together:
    pair_in: wp.array2d(dtype=int),
    # Larger clearances are given as this:
    most: float,
    # Clearances out:
    gap_out: wp.array(dtype=float),
):
    """Least clearance between two arms with their hands."""
    m = wp.tid()
    a = pair_in[m, 0]
    b = pair_in[m, 1]
    left_arm = left.group_joint.shape[0]
    right_arm = right.group_joint.shape[0]
    least = most
    for part in range(left_arm + 1):
        # The hand first, as one, then links from the last on.
        g = left_arm - part
        p, wide = whole_ball(left, left_hand, left_in, a, left_row_in[a], g)
        for behind in range(right_arm + 1):
            h = right_arm - behind
            x, broad = whole_ball(right, right_hand, right_in, b, right_row_in[b], h)
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
                    left_row_in[a],
                    right_row_in[b],
                    g,
                    h,
                    least,
                )
    gap_out[m] = least


@wp.kernel
def ways_of_spheres(
    # Centres of spheres and balls at configurations that follow each other:
    centre_in: wp.array2d(dtype=wp.vec3),
    # Largest way of one of them to the next configuration out:
    way_out: wp.array(dtype=float),
):
    """How far the spheres of an arm and its hand go from one configuration to the next."""
    m = wp.tid()
    longest = float(0.0)
    for k in range(centre_in.shape[1]):
        longest = wp.max(longest, wp.length_sq(centre_in[m + 1, k] - centre_in[m, k]))
    way_out[m] = wp.sqrt(longest)


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
