"""Warp kernels of inverse kinematics: Levenberg-Marquardt, one thread per target or per start.

Error of a posture: e = (target - position, length * log(R_target R^T)), world frame, so that a
rotation of one radian weighs as `length` metres. Threads share nothing: what a target gives does not
depend on the others.
"""

import warp as wp

from bidexdata.arms.chain_kernels import (
    Angles,
    Six,
    Slope,
    Square,
    Triples,
    TwistedArrays,
    so3_log,
    solve_square,
)

wp.set_module_options({"enable_backward": False})

LARGEST_DAMPING = wp.constant(10.0)
"""A start ends where damping is larger: ten times the squares of a Jacobian's entries, so that what
failed was a small step straight down, as at a local minimum [m^2/rad^2]."""
PULL_FADES = wp.constant(0.1)
"""Error below which the pull to the rest posture fades, so that the last steps are Newton's [m]."""
LOOK_EVERY = wp.constant(4)
"""A start is looked at after so many steps again [-]."""
STALLED = wp.constant(0.95)
"""It ends where the error is larger than this share of what it was at the look before [-]. Starts that
come to no good end take most steps; without this, and without the bound above, 725 and 564 of 925
grasps find a motion on two rigs, with them 724 and 565."""
NEARLY = wp.constant(0.01)
"""But not below this error [m]."""


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
    slope: Slope
    """Per joint the velocity of the hand's origin, and the angular velocity times length [m/rad]."""


@wp.func
def linearise(
    chain: TwistedArrays, length: float, q: Angles, pos: wp.vec3, rot: wp.mat33
) -> Linear:
    """Error of posture q against a target, and the Jacobian."""
    out = Linear()
    at = wp.vec3(0.0, 0.0, 0.0)
    x = chain.first_x
    y = chain.first_y
    z = chain.first_z
    origins = Triples()
    axes = Triples()
    for j in range(chain.count):
        before = chain.before_pos[j]
        at = at + before[0] * x + before[1] * y + before[2] * z
        twist = chain.twist[j]
        up = twist[0] * y + twist[1] * z
        z = twist[0] * z - twist[1] * y
        along = wp.cos(q[j])
        across = wp.sin(q[j])
        offset = chain.offset[j]
        c = offset[0] * along - offset[1] * across
        s = offset[1] * along + offset[0] * across
        y = c * up - s * x
        x = c * x + s * up
        origins[j] = at
        axes[j] = z
    end = at + chain.end_pos[0] * x + chain.end_pos[1] * y + chain.end_pos[2] * z
    for j in range(chain.count):
        axis = axes[j]
        moved = wp.cross(axis, end - origins[j])
        out.slope[j] = Six(
            moved[0], moved[1], moved[2], length * axis[0], length * axis[1], length * axis[2]
        )
    off = pos - end
    turn = wp.matrix_from_cols(x, y, z) * chain.end_rot
    log = length * so3_log(rot * wp.transpose(turn))
    out.error = Six(off[0], off[1], off[2], log[0], log[1], log[2])
    return out


@wp.func
def missed(here: Linear, length: float):
    """By how much a posture misses: metres and radians."""
    off = wp.length(wp.vec3(here.error[0], here.error[1], here.error[2]))
    twist = wp.length(wp.vec3(here.error[3], here.error[4], here.error[5])) / length
    return off, twist


@wp.func
def damped_step(
    chain: TwistedArrays, rules: IkRules, q: Angles, here: Linear, damping: float, pull: float
) -> Angles:
    """The step that lowers the error: J^T (J J^T + damping I)^-1 (e - J r) + r, r the pull to rest.

    Joints at a limit that the error pushes outward stand still.
    """
    A = Square()
    wanted = here.error
    slope = here.slope
    rest = Angles()
    for j in range(chain.count):
        c = slope[j]
        slant = wp.dot(c, here.error)
        outward = (q[j] <= chain.lower[j] and slant < 0.0) or (
            q[j] >= chain.upper[j] and slant > 0.0
        )
        if outward:
            slope[j] = Six()
        else:
            rest[j] = pull * (chain.rest[j] - q[j])
            wanted = wanted - rest[j] * c
            A = A + wp.outer(c, c)
    x, _root = solve_square(A, damping, wanted)
    step = slope * x + rest
    most = float(0.0)
    for j in range(chain.count):
        most = wp.max(most, wp.abs(step[j]))
    if most > rules.largest_step:
        step = (rules.largest_step / most) * step
    return step


@wp.func
def descend(
    chain: TwistedArrays,
    rules: IkRules,
    start: Angles,
    pos: wp.vec3,
    rot: wp.mat33,
    pull: float,
):
    """Lower the error from a start; returns q, its error and slope, iterations."""
    q = start
    here = linearise(chain, rules.length, q, pos, rot)
    size = wp.length(here.error)
    damping = rules.damping
    before = float(1.0e9)
    used = wp.int32(0)
    for step_number in range(rules.iterations):
        off, twist = missed(here, rules.length)
        if (off <= rules.tolerance_pos and twist <= rules.tolerance_rot) or (
            damping > LARGEST_DAMPING
        ):
            break
        if step_number > 0 and step_number % LOOK_EVERY == 0:
            if size > wp.max(NEARLY, STALLED * before):
                break
            before = size
        used = step_number + 1
        gain = pull * wp.min(size / PULL_FADES, 1.0)
        step = damped_step(chain, rules, q, here, damping, gain)
        tried = Angles()
        for j in range(chain.count):
            tried[j] = wp.clamp(q[j] + step[j], chain.lower[j], chain.upper[j])
        there = linearise(chain, rules.length, tried, pos, rot)
        length = wp.length(there.error)
        if length < size:
            q = tried
            here = there
            size = length
            damping = wp.max(damping * rules.damp_less, 1.0e-7)
        else:
            damping = damping * rules.damp_more
    return q, here, used


@wp.func
def dexterity(here: Linear) -> float:
    """Manipulability: root of det(J J^T), turns weighted by the length."""
    _x, root = solve_square(wp.transpose(here.slope) * here.slope, 0.0, Six())
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
    chain: TwistedArrays,
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
    q, here, used = descend(chain, rules, start, pos_in[n], rot_in[n], rules.rest_gain)
    off, twist = missed(here, rules.length)
    for j in range(chain.count):
        q_out[n, s, j] = q[j]
    error_pos_out[n, s] = off
    error_rot_out[n, s] = twist
    manipulability_out[n, s] = dexterity(here)
    iterations_out[n, s] = used


@wp.kernel
def solve_until_first(
    # Chain and rules:
    chain: TwistedArrays,
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
    ease = float(0.0)
    total = wp.int32(0)
    tried = wp.int32(0)
    for s in range(pick_in.shape[1]):
        start = Angles()
        for j in range(chain.count):
            start[j] = start_in[pick_in[n, s], j]
        q, here, used = descend(chain, rules, start, pos_in[n], rot_in[n], rules.rest_gain)
        off, twist = missed(here, rules.length)
        tried = s + 1
        total = total + used
        size = off + rules.length * twist
        good = off <= rules.accept_pos and twist <= rules.accept_rot
        if good or size < least:
            least = size
            best = q
            best_off = off
            best_twist = twist
            ease = dexterity(here)
        if good:
            break
    for j in range(chain.count):
        q_out[n, j] = best[j]
    error_pos_out[n] = best_off
    error_rot_out[n] = best_twist
    manipulability_out[n] = ease
    iterations_out[n] = total
    tried_out[n] = tried


@wp.kernel
def follow_path(
    # Chain and rules:
    chain: TwistedArrays,
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

    There is no path from a posture that is NaN. Each begins where the step before would lead once more, from where most need one iteration less.
    """
    n, s = wp.tid()
    q = Angles()
    for j in range(chain.count):
        q[j] = start_in[n, s, j]
    guess = Angles()
    onward = Angles()
    reached = wp.int32(0)
    going = wp.where(wp.isnan(q[0]), 0, 1)
    for t in range(pos_in.shape[1]):
        if going == 1:
            for j in range(chain.count):
                guess[j] = wp.clamp(q[j] + onward[j], chain.lower[j], chain.upper[j])
            there, here, _used = descend(chain, rules, guess, pos_in[n, t], rot_in[n, t], 0.0)
            off, twist = missed(here, rules.length)
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
