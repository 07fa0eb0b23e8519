"""Warp kernels of inverse kinematics: Levenberg-Marquardt, one thread per target or per start.

Error of a posture: e = (target - position, length * log(R_target R^T)), world frame, so that a
rotation of one radian weighs as `length` metres. Threads share nothing: what a target gives does not
depend on the others.
"""

import warp as wp

from bidexdata.arms.chain_kernels import (
    Angles,
    ChainArrays,
    Six,
    Square,
    Triples,
    so3_log,
    solve_square,
    turn_about,
)

wp.set_module_options({"enable_backward": False})

LARGEST_DAMPING = wp.constant(1.0e6)
PULL_FADES = wp.constant(0.1)
"""Error below which the pull to the rest posture fades, so that the last steps are Newton's [m]."""


@wp.struct
class IkRules:
    """Numbers of `IkConfig`; units as there."""

    iterations: int
    tolerance_pos: float
    tolerance_rot: float
    accept_pos: float
    accept_rot: float
    length: float
    damping: float
    damp_less: float
    damp_more: float
    largest_step: float
    rest_gain: float


@wp.struct
class Linear:
    """A posture's error and its slope."""

    error: Six
    moved: Triples
    """Velocity of the hand's origin per joint speed [m/rad], (A, 3)."""
    turned: Triples
    """Angular velocity per joint speed, times length [m/rad], (A, 3)."""


@wp.func
def linearise(chain: ChainArrays, length: float, q: Angles, pos: wp.vec3, rot: wp.mat33) -> Linear:
    """Error of posture q against a target, and the columns of the Jacobian."""
    out = Linear()
    at = wp.vec3(0.0, 0.0, 0.0)
    turn = wp.identity(n=3, dtype=float)
    for j in range(chain.count):
        at = at + turn * chain.before_pos[j]
        turn = turn * chain.before_rot[j] * turn_about(chain.axis[j], q[j])
        axis = turn * chain.axis[j]
        for i in range(3):
            out.moved[j, i] = at[i]
            out.turned[j, i] = axis[i]
    end = at + turn * chain.end_pos
    turn = turn * chain.end_rot
    for j in range(chain.count):
        axis = wp.vec3(out.turned[j, 0], out.turned[j, 1], out.turned[j, 2])
        origin = wp.vec3(out.moved[j, 0], out.moved[j, 1], out.moved[j, 2])
        column = wp.cross(axis, end - origin)
        for i in range(3):
            out.moved[j, i] = column[i]
            out.turned[j, i] = length * axis[i]
    off = pos - end
    log = length * so3_log(rot * wp.transpose(turn))
    for i in range(3):
        out.error[i] = off[i]
        out.error[3 + i] = log[i]
    return out


@wp.func
def column_of(slope: Linear, j: int) -> Six:
    """One column of the Jacobian."""
    c = Six()
    for i in range(3):
        c[i] = slope.moved[j, i]
        c[3 + i] = slope.turned[j, i]
    return c


@wp.func
def damped_step(
    chain: ChainArrays, rules: IkRules, q: Angles, slope: Linear, damping: float, pull: float
) -> Angles:
    """The step that lowers the error: J^T (J J^T + damping I)^-1 (e - J r) + r, r the pull to rest.

    Joints at a limit that the error pushes outward stand still.
    """
    A = Square()
    wanted = slope.error
    step = Angles()
    active = Angles()
    for j in range(chain.count):
        c = column_of(slope, j)
        slant = wp.dot(c, slope.error)
        outward = (q[j] <= chain.lower[j] and slant < 0.0) or (
            q[j] >= chain.upper[j] and slant > 0.0
        )
        if not outward:
            active[j] = 1.0
            rest = pull * (chain.rest[j] - q[j])
            step[j] = rest
            wanted = wanted - rest * c
            for i in range(6):
                for k in range(i + 1):
                    A[i, k] = A[i, k] + c[i] * c[k]
    x, _root = solve_square(A, damping, wanted)
    most = float(0.0)
    for j in range(chain.count):
        step[j] = step[j] + active[j] * wp.dot(column_of(slope, j), x)
        most = wp.max(most, wp.abs(step[j]))
    if most > rules.largest_step:
        step = (rules.largest_step / most) * step
    return step


@wp.func
def descend(
    chain: ChainArrays,
    rules: IkRules,
    start: Angles,
    pos: wp.vec3,
    rot: wp.mat33,
    pull: float,
):
    """Lower the error from a start; returns q, its error of position and rotation, iterations."""
    q = start
    slope = linearise(chain, rules.length, q, pos, rot)
    size = wp.length(slope.error)
    damping = rules.damping
    used = wp.int32(0)
    for step_number in range(rules.iterations):
        off = wp.length(wp.vec3(slope.error[0], slope.error[1], slope.error[2]))
        twist = wp.length(wp.vec3(slope.error[3], slope.error[4], slope.error[5])) / rules.length
        if (off <= rules.tolerance_pos and twist <= rules.tolerance_rot) or (
            damping > LARGEST_DAMPING
        ):
            break
        used = step_number + 1
        gain = pull * wp.min(size / PULL_FADES, 1.0)
        step = damped_step(chain, rules, q, slope, damping, gain)
        tried = Angles()
        for j in range(chain.count):
            tried[j] = wp.clamp(q[j] + step[j], chain.lower[j], chain.upper[j])
        there = linearise(chain, rules.length, tried, pos, rot)
        length = wp.length(there.error)
        if length < size:
            q = tried
            slope = there
            size = length
            damping = wp.max(damping * rules.damp_less, 1.0e-7)
        else:
            damping = damping * rules.damp_more
    off = wp.length(wp.vec3(slope.error[0], slope.error[1], slope.error[2]))
    twist = wp.length(wp.vec3(slope.error[3], slope.error[4], slope.error[5])) / rules.length
    return q, off, twist, used


@wp.func
def dexterity(chain: ChainArrays, length: float, q: Angles) -> float:
    """Manipulability: root of det(J J^T), turns weighted by `length`."""
    slope = linearise(chain, length, q, wp.vec3(0.0, 0.0, 0.0), wp.identity(n=3, dtype=float))
    A = Square()
    for j in range(chain.count):
        c = column_of(slope, j)
        for i in range(6):
            for k in range(i + 1):
                A[i, k] = A[i, k] + c[i] * c[k]
    _x, root = solve_square(A, 0.0, Six())
    return root


@wp.kernel
def pick_starts(
    # Postures to start from:
    end_pos_in: wp.array(dtype=wp.vec3),
    end_rot_in: wp.array(dtype=wp.mat33),
    length: float,
    # Targets in:
    pos_in: wp.array(dtype=wp.vec3),
    rot_in: wp.array(dtype=wp.mat33),
    # Scratch, (N, S):
    gap_out: wp.array2d(dtype=float),
    # Numbers of postures out:
    pick_out: wp.array2d(dtype=int),
):
    """Pick the postures whose hands are nearest to each target, nearest first."""
    n = wp.tid()
    most = pick_out.shape[1]
    have = wp.int32(0)
    for p in range(end_pos_in.shape[0]):
        turned = rot_in[n] - end_rot_in[p]
        gap = wp.length_sq(pos_in[n] - end_pos_in[p])
        gap = gap + 0.5 * length * length * wp.ddot(turned, turned)
        if have < most or gap < gap_out[n, most - 1]:
            k = wp.min(have, most - 1)
            while k > 0 and gap < gap_out[n, wp.max(k - 1, 0)]:
                gap_out[n, k] = gap_out[n, k - 1]
                pick_out[n, k] = pick_out[n, k - 1]
                k = k - 1
            gap_out[n, k] = gap
            pick_out[n, k] = p
            have = wp.min(have + 1, most)


@wp.kernel
def solve_every_start(
    # Chain and rules:
    chain: ChainArrays,
    rules: IkRules,
    # Problem in:
    start_in: wp.array2d(dtype=float),
    pick_in: wp.array2d(dtype=int),
    pos_in: wp.array(dtype=wp.vec3),
    rot_in: wp.array(dtype=wp.mat33),
    # Solutions out:
    q_out: wp.array3d(dtype=float),
    error_pos_out: wp.array2d(dtype=float),
    error_rot_out: wp.array2d(dtype=float),
    manipulability_out: wp.array2d(dtype=float),
    iterations_out: wp.array2d(dtype=int),
):
    """Solve every target from every start that was picked for it."""
    n, s = wp.tid()
    start = Angles()
    for j in range(chain.count):
        start[j] = start_in[pick_in[n, s], j]
    q, off, twist, used = descend(chain, rules, start, pos_in[n], rot_in[n], rules.rest_gain)
    for j in range(chain.count):
        q_out[n, s, j] = q[j]
    error_pos_out[n, s] = off
    error_rot_out[n, s] = twist
    manipulability_out[n, s] = dexterity(chain, rules.length, q)
    iterations_out[n, s] = used


@wp.kernel
def solve_until_first(
    # Chain and rules:
    chain: ChainArrays,
    rules: IkRules,
    # Problem in:
    start_in: wp.array2d(dtype=float),
    pick_in: wp.array2d(dtype=int),
    pos_in: wp.array(dtype=wp.vec3),
    rot_in: wp.array(dtype=wp.mat33),
    # Solutions out:
    q_out: wp.array2d(dtype=float),
    error_pos_out: wp.array(dtype=float),
    error_rot_out: wp.array(dtype=float),
    manipulability_out: wp.array(dtype=float),
    iterations_out: wp.array(dtype=int),
    tried_out: wp.array(dtype=int),
):
    """Solve every target from one start after the other until one is good; else keep the nearest."""
    n = wp.tid()
    best = Angles()
    best_off = float(1.0e9)
    best_twist = float(1.0e9)
    least = float(1.0e9)
    total = wp.int32(0)
    tried = wp.int32(0)
    for s in range(pick_in.shape[1]):
        start = Angles()
        for j in range(chain.count):
            start[j] = start_in[pick_in[n, s], j]
        q, off, twist, used = descend(chain, rules, start, pos_in[n], rot_in[n], rules.rest_gain)
        tried = s + 1
        total = total + used
        size = off + rules.length * twist
        if size < least:
            least = size
            best = q
            best_off = off
            best_twist = twist
        if off <= rules.accept_pos and twist <= rules.accept_rot:
            best = q
            best_off = off
            best_twist = twist
            break
    for j in range(chain.count):
        q_out[n, j] = best[j]
    error_pos_out[n] = best_off
    error_rot_out[n] = best_twist
    manipulability_out[n] = dexterity(chain, rules.length, best)
    iterations_out[n] = total
    tried_out[n] = tried


@wp.kernel
def follow_path(
    # Chain and rules:
    chain: ChainArrays,
    rules: IkRules,
    # Problem in:
    start_in: wp.array3d(dtype=float),
    pos_in: wp.array2d(dtype=wp.vec3),
    rot_in: wp.array2d(dtype=wp.mat33),
    # Paths out:
    q_out: wp.array4d(dtype=float),
    error_pos_out: wp.array3d(dtype=float),
    error_rot_out: wp.array3d(dtype=float),
    step_out: wp.array3d(dtype=float),
    reached_out: wp.array2d(dtype=int),
):
    """Go through the waypoints of each row from each posture; stop where one is not reached.

    Each begins where the step before would lead once more, from where most need one iteration less.
    """
    n, s = wp.tid()
    q = Angles()
    for j in range(chain.count):
        q[j] = start_in[n, s, j]
    guess = Angles()
    onward = Angles()
    reached = wp.int32(0)
    going = wp.int32(1)
    for t in range(pos_in.shape[1]):
        if going == 1:
            for j in range(chain.count):
                guess[j] = wp.clamp(q[j] + onward[j], chain.lower[j], chain.upper[j])
            there, off, twist, _used = descend(chain, rules, guess, pos_in[n, t], rot_in[n, t], 0.0)
            onward = there - q
            most = float(0.0)
            for j in range(chain.count):
                most = wp.max(most, wp.abs(there[j] - q[j]))
                q_out[n, s, t, j] = there[j]
            error_pos_out[n, s, t] = off
            error_rot_out[n, s, t] = twist
            step_out[n, s, t] = most
            q = there
            if off <= rules.accept_pos and twist <= rules.accept_rot:
                reached = reached + 1
            else:
                going = 0
        else:
            for j in range(chain.count):
                q_out[n, s, t, j] = wp.nan
            error_pos_out[n, s, t] = wp.nan
            error_rot_out[n, s, t] = wp.nan
            step_out[n, s, t] = wp.nan
    reached_out[n, s] = reached
