"""Warp kernels of clearance: spheres of arms against all around them and against each other.

One thread per configuration. Everything is in the world frame [m]; clearances are negative where
spheres overlap.
"""

import warp as wp

from bidexdata.arms.chain_kernels import ChainArrays, turn_about
from bidexdata.objects.distance_field_kernels import DistanceField, signed_distance

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(1.0e3)


@wp.struct
class SphereArrays:
    """The spheres of one arm on a device; shapes and units as in `ArmSpheres`."""

    joint: wp.array(dtype=int)
    pos: wp.array(dtype=wp.vec3)
    radius: wp.array(dtype=float)
    pairs: wp.array2d(dtype=int)
    fixture_pos: wp.array(dtype=wp.vec3)
    fixture_half: wp.array(dtype=wp.vec3)
    first_moving: int
    """First sphere that a second joint of the chain, or a later one, moves."""


@wp.kernel
def place_arm_spheres(
    # Arm:
    chain: ChainArrays,
    spheres: SphereArrays,
    # Configurations in:
    q_in: wp.array2d(dtype=float),
    # Centres out:
    centre_out: wp.array2d(dtype=wp.vec3),
):
    """Place the spheres, which lie in the order of the chain."""
    m = wp.tid()
    at = wp.vec3(0.0, 0.0, 0.0)
    turn = wp.identity(n=3, dtype=float)
    k = wp.int32(0)
    count = spheres.radius.shape[0]
    while k < count and spheres.joint[k] < 0:
        centre_out[m, k] = spheres.pos[k]
        k = k + 1
    for j in range(chain.count):
        at = at + turn * chain.before_pos[j]
        turn = turn * chain.before_rot[j] * turn_about(chain.axis[j], q_in[m, j])
        while k < count and spheres.joint[k] == j:
            centre_out[m, k] = at + turn * spheres.pos[k]
            k = k + 1


@wp.func
def box_distance(half: wp.vec3, p: wp.vec3) -> float:
    """Signed distance from a point to an upright box round the origin."""
    out = wp.vec3(wp.abs(p[0]) - half[0], wp.abs(p[1]) - half[1], wp.abs(p[2]) - half[2])
    beyond = wp.vec3(wp.max(out[0], 0.0), wp.max(out[1], 0.0), wp.max(out[2], 0.0))
    return wp.length(beyond) + wp.min(wp.max(out[0], wp.max(out[1], out[2])), 0.0)


@wp.kernel
def clear_alone(
    # Arm:
    spheres: SphereArrays,
    # Object, one pose per row of configurations:
    field: DistanceField,
    with_object: int,
    object_size_in: wp.array(dtype=float),
    object_pos_in: wp.array(dtype=wp.vec3),
    object_rot_in: wp.array(dtype=wp.mat33),
    per_row: int,
    # Configurations in:
    centre_in: wp.array2d(dtype=wp.vec3),
    # Clearances out:
    table_out: wp.array(dtype=float),
    object_out: wp.array(dtype=float),
    self_out: wp.array(dtype=float),
):
    """Least clearance of one arm from table, object, and itself with the fixtures."""
    m = wp.tid()
    n = m / per_row
    table = float(FAR)
    near = float(FAR)
    itself = float(FAR)
    for k in range(spheres.first_moving, spheres.radius.shape[0]):
        p = centre_in[m, k]
        r = spheres.radius[k]
        table = wp.min(table, p[2] - r)
        if with_object == 1:
            x = wp.transpose(object_rot_in[n]) * (p - object_pos_in[n])
            near = wp.min(near, signed_distance(field, object_size_in[n], x)[0] - r)
        for f in range(spheres.fixture_pos.shape[0]):
            gap = box_distance(spheres.fixture_half[f], p - spheres.fixture_pos[f]) - r
            itself = wp.min(itself, gap)
    for i in range(spheres.pairs.shape[0]):
        a = spheres.pairs[i, 0]
        b = spheres.pairs[i, 1]
        gap = wp.length(centre_in[m, a] - centre_in[m, b]) - spheres.radius[a] - spheres.radius[b]
        itself = wp.min(itself, gap)
    table_out[m] = table
    object_out[m] = near
    self_out[m] = itself


@wp.kernel
def clear_of_each_other(
    # Arms:
    left: SphereArrays,
    right: SphereArrays,
    # Configurations in:
    left_in: wp.array2d(dtype=wp.vec3),
    right_in: wp.array2d(dtype=wp.vec3),
    # Which of each arm's are taken together:
    pair_in: wp.array2d(dtype=int),
    # Clearances out:
    gap_out: wp.array(dtype=float),
):
    """Least clearance between two arms."""
    m = wp.tid()
    a = pair_in[m, 0]
    b = pair_in[m, 1]
    least = float(FAR)
    for i in range(left.radius.shape[0]):
        p = left_in[a, i]
        r = left.radius[i]
        for j in range(right.radius.shape[0]):
            least = wp.min(least, wp.length(p - right_in[b, j]) - r - right.radius[j])
    gap_out[m] = least
