"""Warp functions of a chain: rotations, their logarithm, frames, and the 6 x 6 solve.

Rotations are matrices and everything is in the world frame, float32. Chains have at most ten joints
(`spec.MOST_JOINTS`), kept in the registers of a thread.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

MOST = wp.constant(10)
Angles = wp.types.vector(length=10, dtype=float)
Triples = wp.types.matrix(shape=(10, 3), dtype=float)
Slope = wp.types.matrix(shape=(10, 6), dtype=float)
Six = wp.types.vector(length=6, dtype=float)
Square = wp.types.matrix(shape=(6, 6), dtype=float)
NEAR_HALF_TURN = wp.constant(-0.99)
"""Cosine of the angle below which the axis comes from the symmetric part of a rotation [-]."""


@wp.struct
class ChainArrays:
    """One chain on a device; shapes and units as in `Chain`, float32."""

    before_pos: wp.array(dtype=wp.vec3)
    before_rot: wp.array(dtype=wp.mat33)
    axis: wp.array(dtype=wp.vec3)
    end_pos: wp.vec3
    end_rot: wp.mat33
    count: int


@wp.struct
class TwistedArrays:
    """One chain on a device, as `TwistedChain` has it, float32."""

    first_x: wp.vec3
    first_y: wp.vec3
    first_z: wp.vec3
    before_pos: wp.array(dtype=wp.vec3)
    twist: wp.array(dtype=wp.vec2)
    """Cosines and sines."""
    offset: wp.array(dtype=wp.vec2)
    lower: wp.array(dtype=float)
    upper: wp.array(dtype=float)
    rest: wp.array(dtype=float)
    end_pos: wp.vec3
    end_rot: wp.mat33
    count: int


@wp.func
def turn_about(axis: wp.vec3, angle: float) -> wp.mat33:
    """Rotation matrix about a unit axis (Rodrigues)."""
    s = wp.sin(angle)
    c = wp.cos(angle)
    k = wp.skew(axis)
    return wp.identity(n=3, dtype=float) + s * k + (1.0 - c) * (k * k)


@wp.func
def so3_log(R: wp.mat33) -> wp.vec3:
    """Axis times angle in [0, pi]; at an exact half turn of either sign of the axis.

    Near half turns the skew part vanishes, and the axis is the largest column of (R + I) / 2.
    """
    skew = 0.5 * wp.vec3(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    sine = wp.length(skew)
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = wp.atan2(sine, cosine)
    scale = 1.0 + sine * sine / 6.0
    if sine > 1.0e-3:
        scale = angle / sine
    log = scale * skew
    if cosine < NEAR_HALF_TURN:
        column = wp.vec3(1.0 + R[0, 0], 0.5 * (R[0, 1] + R[1, 0]), 0.5 * (R[0, 2] + R[2, 0]))
        if R[1, 1] > R[0, 0] and R[1, 1] >= R[2, 2]:
            column = wp.vec3(0.5 * (R[0, 1] + R[1, 0]), 1.0 + R[1, 1], 0.5 * (R[1, 2] + R[2, 1]))
        elif R[2, 2] > R[0, 0] and R[2, 2] > R[1, 1]:
            column = wp.vec3(0.5 * (R[0, 2] + R[2, 0]), 0.5 * (R[1, 2] + R[2, 1]), 1.0 + R[2, 2])
        # (R + R^T) / 2 = cos I + (1 - cos) n n^T, so the diagonal carries 1 + cos too much.
        i = wp.int32(0)
        if R[1, 1] > R[0, 0] and R[1, 1] >= R[2, 2]:
            i = 1
        elif R[2, 2] > R[0, 0] and R[2, 2] > R[1, 1]:
            i = 2
        column[i] = column[i] - 1.0 - cosine
        column = wp.normalize(column)
        if wp.dot(column, skew) < 0.0:
            column = -column
        log = angle * column
    return log


@wp.func
def chain_end(chain: ChainArrays, q: Angles):
    """Origin and rotation of the hand frame."""
    pos = wp.vec3(0.0, 0.0, 0.0)
    rot = wp.identity(n=3, dtype=float)
    for j in range(chain.count):
        pos = pos + rot * chain.before_pos[j]
        rot = rot * chain.before_rot[j] * turn_about(chain.axis[j], q[j])
    return pos + rot * chain.end_pos, rot * chain.end_rot


@wp.func
def solve_square(A: Square, damping: float, b: Six):
    """Solve (A + damping I) x = b for a symmetric positive matrix by elimination, A = U^T D U.

    Returns x and the root of the determinant.
    """
    left = A
    upper = Square()
    right = b
    x = Six()
    det = float(1.0)
    for k in range(6):
        row = left[k]
        pivot = wp.max(row[k] + damping, 1.0e-12)
        det = det * pivot
        share = row / pivot
        x[k] = right[k] / pivot
        right = right - right[k] * share
        left = left - wp.outer(row, share)
        upper[k] = share
    for back in range(1, 6):
        k = 5 - back
        total = x[k]
        for i in range(k + 1, 6):
            total = total - upper[k, i] * x[i]
        x[k] = total
    return x, wp.sqrt(det)


@wp.kernel
def place_ends(
    # Chain:
    chain: ChainArrays,
    # Postures in:
    q_in: wp.array2d(dtype=float),
    # Hand frames out:
    pos_out: wp.array(dtype=wp.vec3),
    rot_out: wp.array(dtype=wp.mat33),
):
    """Forward kinematics of each posture."""
    n = wp.tid()
    q = Angles()
    for j in range(chain.count):
        q[j] = q_in[n, j]
    pos, rot = chain_end(chain, q)
    pos_out[n] = pos
    rot_out[n] = rot


@wp.kernel
def take_logarithms(
    # Rotations in:
    rot_in: wp.array(dtype=wp.mat33),
    # Vectors out:
    log_out: wp.array(dtype=wp.vec3),
):
    """`so3_log` of each rotation, for its test."""
    n = wp.tid()
    log_out[n] = so3_log(rot_in[n])
