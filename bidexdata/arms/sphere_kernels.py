"""Spheres of an arm and its hand on a device: where they are, and the balls that they lie in.

Spheres come in groups that lie in a ball each. Poses are in the world frame [m].
"""

import warp as wp

from bidexdata.arms.chain_kernels import ChainArrays, turn_about

wp.set_module_options({"enable_backward": False})


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


@wp.func
def place_spheres(
    chain: ChainArrays,
    spheres: SphereArrays,
    hand: HandArrays,
    q_in: wp.array2d(dtype=float),
    m: int,
    n: int,
    centre_out: wp.array2d(dtype=wp.vec3),
):
    """Place spheres and balls, which lie in the order of the chain, and those of the hand of row n."""
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


@wp.kernel
def place_arm_spheres(
    # Arm:
    chain: ChainArrays,
    spheres: SphereArrays,
    hand: HandArrays,
    # Configurations in, and the row of hands that each is of:
    q_in: wp.array2d(dtype=float),
    row_in: wp.array(dtype=int),
    # Centres out:
    centre_out: wp.array2d(dtype=wp.vec3),
):
    """Place the spheres and balls of an arm and its hand."""
    m = wp.tid()
    place_spheres(chain, spheres, hand, q_in, m, row_in[m], centre_out)


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
def whole_ball(
    spheres: SphereArrays,
    hand: HandArrays,
    centre_in: wp.array2d(dtype=wp.vec3),
    m: int,
    n: int,
    g: int,
):
    """Ball round group g of an arm, or round its whole hand where g is the number of those."""
    if g < spheres.group_joint.shape[0]:
        return part_ball(spheres, hand, centre_in, m, n, g)
    if hand.radius.shape[0] > 0:
        return hand_centre(centre_in, m), hand.whole_radius[n]
    return centre_in[m, 0], float(-1.0e3)  # no hand: nothing comes near


@wp.func
def end_of_parts(spheres: SphereArrays, hand: HandArrays, g: int) -> int:
    """Behind the last part of group g of an arm, or of its hand where g is the number of those."""
    if g < spheres.group_joint.shape[0]:
        return g + 1
    return part_total(spheres, hand)


@wp.func
def way_of_spheres(centre_in: wp.array2d(dtype=wp.vec3), m: int) -> float:
    """Largest way of a sphere or ball from configuration m to the next."""
    longest = float(0.0)
    for k in range(centre_in.shape[1]):
        longest = wp.max(longest, wp.length_sq(centre_in[m + 1, k] - centre_in[m, k]))
    return wp.sqrt(longest)


@wp.kernel
def ways_of_spheres(
    # Centres of two arms at configurations that follow each other:
    left_in: wp.array2d(dtype=wp.vec3),
    right_in: wp.array2d(dtype=wp.vec3),
    # Largest ways to the next configuration out:
    way_out: wp.array2d(dtype=float),
):
    """How far the spheres of each arm and its hand go from one configuration to the next."""
    m = wp.tid()
    way_out[0, m] = way_of_spheres(left_in, m)
    way_out[1, m] = way_of_spheres(right_in, m)
