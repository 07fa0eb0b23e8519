"""Where a light object comes to rest while the hands close on it.

Axes: N grasps, S places of the object, M contact points of both hands (left first). A contact point is
a sphere on a spring whose other end goes where the hands are told to. It cannot enter the object; it
sticks by friction or slides. Inertia counts for nothing: after every move the object goes to where
the springs balance. Spheres are kept in the object's frame, so that those that stick move with it;
forces are in units of a spring's stiffness, so they are lengths [m]. The float64 reference is
`tests/synthesis/settling_reference.py`.
"""

import warp as wp

from bidexdata.objects.distance_field_kernels import DistanceField, signed_distance

wp.set_module_options({"enable_backward": False})

TOUCH = wp.constant(2.0e-4)
"""A sphere nearer than this touches [m]."""
HELD = wp.constant(0.1)
"""What holds an object that nothing else does, as a share of one spring [-]."""
HELD_ARM = wp.constant(0.01)
"""The arm at which it holds against turning [m]."""


@wp.func
def _at_most(x: wp.vec3, most: float) -> wp.vec3:
    return x * wp.min(1.0, most / wp.max(wp.length(x), 1.0e-9))


@wp.func
def _clearance(field: DistanceField, size: float, x: wp.vec3, radius: float) -> wp.vec4:
    """Gap between a sphere and the object [m], and the outward unit normal under it."""
    d = signed_distance(field, size, x)
    n = wp.normalize(wp.vec3(d[1], d[2], d[3]))
    return wp.vec4(d[0] - radius, n[0], n[1], n[2])


@wp.func
def _spread(x: wp.vec3) -> wp.mat33:
    """How stiff a unit spring at x is against turns about the origin."""
    return wp.dot(x, x) * wp.identity(n=3, dtype=float) - wp.outer(x, x)


@wp.func
def _target(
    stages: wp.array3d[wp.vec3], grasp: int, i: int, move: int, closing: int, pressing: int
) -> wp.vec3:
    """Where contact point i is told to be after a move: on to the grasp, on to the squeeze, or there."""
    if move < closing:
        u = float(move + 1) / float(closing)
        return wp.lerp(stages[grasp, 0, i], stages[grasp, 1, i], u)
    u = wp.min(float(move + 1 - closing) / float(pressing), 1.0)
    return wp.lerp(stages[grasp, 1, i], stages[grasp, 2, i], u)


@wp.func
def _step(way: wp.vec3, clearance: wp.vec4, friction: float, stride: float) -> wp.vec3:
    """How far a sphere goes: one that presses slides until friction holds it."""
    if clearance[0] < TOUCH:
        n = wp.vec3(clearance[1], clearance[2], clearance[3])
        depth = -wp.dot(way, n)
        if depth > 0.0:
            along = way + depth * n
            way = along - _at_most(along, friction * depth)
    return _at_most(way, stride)


@wp.func
def _after(
    field: DistanceField, size: float, x: wp.vec3, radius: float, before: wp.vec4, way: float
) -> wp.vec4:
    """Clearance of a sphere after a step; one that overlaps is to be put out of the object."""
    # A distance changes by no more than the way, so most are not looked up.
    before[0] = before[0] - way
    if before[0] < TOUCH:
        return _clearance(field, size, x, radius)
    return before


@wp.func
def _turned(R: wp.mat33, turn: wp.vec3) -> wp.mat33:
    """R after a turn in its own frame, a rotation vector."""
    angle = wp.length(turn)
    if angle > 0.0:
        return R * wp.quat_to_matrix(wp.quat_from_axis_angle(turn / angle, angle))
    return R


@wp.kernel
def settle(
    # Object:
    field: DistanceField,
    size: wp.array[float],
    places: wp.array[wp.vec3],
    # Hand:
    side: wp.array[int],
    radius: wp.array[float],
    # Settings:
    friction: float,
    closing: int,
    pressing: int,
    waiting: int,
    repeats: int,
    stride: float,
    # Problem in:
    stages_in: wp.array3d[wp.vec3],
    # Problem out:
    spheres_inout: wp.array3d[wp.vec3],
    clearance_inout: wp.array3d[wp.vec4],
    pressed_out: wp.array2d[wp.vec2],
    touching_out: wp.array2d[float],
    turned_out: wp.array2d[float],
):
    """Follow the targets from pre-grasp over grasp to squeeze, (N, 3, M), and wait there."""
    grasp, place = wp.tid()
    s = size[grasp]
    R = wp.identity(n=3, dtype=float)
    t = places[place]
    pressed = wp.vec2(0.0)
    touching = float(0.0)
    for i in range(radius.shape[0]):
        y = stages_in[grasp, 0, i] - t
        spheres_inout[grasp, place, i] = y
        clearance_inout[grasp, place, i] = _clearance(field, s, y, radius[i])
    for k in range((closing + pressing + waiting) * repeats):
        pressed = wp.vec2(0.0)
        touching = float(0.0)
        force = wp.vec3(0.0)
        torque = wp.vec3(0.0)
        centre = wp.vec3(0.0)
        arms = wp.mat33(0.0)
        for i in range(radius.shape[0]):
            goal = _target(stages_in, grasp, i, k / repeats, closing, pressing)
            goal = wp.transpose(R) * (goal - t)
            y = spheres_inout[grasp, place, i]
            c = clearance_inout[grasp, place, i]
            step = _step(goal - y, c, friction, stride)
            y = y + step
            c = _after(field, s, y, radius[i], c, wp.length(step))
            y = y + wp.max(-c[0], 0.0) * wp.vec3(c[1], c[2], c[3])
            spheres_inout[grasp, place, i] = y
            clearance_inout[grasp, place, i] = c
            n = wp.vec3(c[1], c[2], c[3])
            way = goal - y
            depth = -wp.dot(way, n)
            if c[0] < TOUCH and depth > 0.0:
                pull = _at_most(way + depth * n, friction * depth) - depth * n
                p = y - radius[i] * n
                force += pull
                torque += wp.cross(p, pull)
                centre += p
                arms += _spread(p)
                touching += 1.0
                pressed[side[i]] += depth
        if touching > 0.0:
            # About the middle of the contacts shifts and turns do not mix.
            middle = centre / touching
            about = arms - touching * _spread(middle)
            about += HELD * HELD_ARM * HELD_ARM * wp.identity(n=3, dtype=float)
            shift = _at_most(force / (touching + HELD), stride)
            turn = wp.inverse(about) * (torque - wp.cross(middle, force))
            ahead = _turned(R, _at_most(turn, 10.0 * stride))
            t = t + R * (middle + shift) - ahead * middle
            R = ahead
    pressed_out[grasp, place] = pressed
    touching_out[grasp, place] = touching
    turned_out[grasp, place] = wp.acos(wp.clamp(0.5 * (wp.trace(R) - 1.0), -1.0, 1.0))
