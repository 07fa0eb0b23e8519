"""Signed distance, its gradient and smoothed surface normals from a unit-size grid.

One grid at unit diagonal serves every size s: sdf_s(x) = s sdf_1(x / s), so each query takes the
size of its grasp. Points are in the object frame [m]; distances are negative inside.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class DistanceField:
    """The grid: node (i, j, k) lies at origin + cell (i, j, k), unit diagonal."""

    values: wp.array3d[float]
    origin: wp.vec3
    per_cell: float
    last: wp.vec3
    """Index of the last node along each axis, as floats."""


@wp.func
def _nearest_in_grid(field: DistanceField, g: wp.vec3) -> wp.vec3:
    """Continuous node indices of the grid point closest to indices g."""
    return wp.vec3(
        wp.clamp(g[0], 0.0, field.last[0]),
        wp.clamp(g[1], 0.0, field.last[1]),
        wp.clamp(g[2], 0.0, field.last[2]),
    )


@wp.func
def _cell(g: float, last: float):
    """The node below continuous index g along one axis, and the share of the cell beyond it.

    The index says itself that it is not negative, which spares a test in every access.
    """
    i = wp.max(wp.min(int(g), int(last) - 1), 0)
    return i, g - float(i)


@wp.func
def _interpolate(field: DistanceField, g: wp.vec3) -> wp.vec4:
    """Trilinear value and its gradient per unit of length at continuous indices g."""
    i, u = _cell(g[0], field.last[0])
    j, v = _cell(g[1], field.last[1])
    k, w = _cell(g[2], field.last[2])
    a000 = field.values[i, j, k]
    a001 = field.values[i, j, k + 1]
    a010 = field.values[i, j + 1, k]
    a011 = field.values[i, j + 1, k + 1]
    a100 = field.values[i + 1, j, k]
    a101 = field.values[i + 1, j, k + 1]
    a110 = field.values[i + 1, j + 1, k]
    a111 = field.values[i + 1, j + 1, k + 1]
    b00 = a000 + u * (a100 - a000)
    b01 = a001 + u * (a101 - a001)
    b10 = a010 + u * (a110 - a010)
    b11 = a011 + u * (a111 - a011)
    c0 = b00 + v * (b10 - b00)
    c1 = b01 + v * (b11 - b01)
    d00 = (a100 - a000) + w * ((a101 - a001) - (a100 - a000))
    d10 = (a110 - a010) + w * ((a111 - a011) - (a110 - a010))
    dx = d00 + v * (d10 - d00)
    dy = (b10 - b00) + w * ((b11 - b01) - (b10 - b00))
    return wp.vec4(
        c0 + w * (c1 - c0), dx * field.per_cell, dy * field.per_cell, (c1 - c0) * field.per_cell
    )


@wp.func
def signed_distance(field: DistanceField, size: float, x: wp.vec3) -> wp.vec4:
    """Signed distance [m] of x and its gradient, as (d, dx, dy, dz).

    Outside the grid the distance is that to the surface point closest to the grid's nearest point.
    """
    y = x / size
    wanted = (y - field.origin) * field.per_cell
    g = _nearest_in_grid(field, wanted)
    s = _interpolate(field, g)
    slope = wp.vec3(s[1], s[2], s[3])
    if wp.length_sq(wanted - g) > 0.0:
        offset = (wanted - g) / field.per_cell + s[0] * wp.normalize(slope)
        length = wp.length(offset)
        slope = offset / wp.max(length, 1.0e-9)
        return wp.vec4(size * length, slope[0], slope[1], slope[2])
    return wp.vec4(size * s[0], slope[0], slope[1], slope[2])


@wp.func
def _value(field: DistanceField, i: int, j: int, k: int, u: float, v: float, w: float) -> float:
    """Trilinear value alone, shares (u, v, w) of a cell beyond node (i, j, k)."""
    b00 = wp.lerp(field.values[i, j, k], field.values[i + 1, j, k], u)
    b01 = wp.lerp(field.values[i, j, k + 1], field.values[i + 1, j, k + 1], u)
    b10 = wp.lerp(field.values[i, j + 1, k], field.values[i + 1, j + 1, k], u)
    b11 = wp.lerp(field.values[i, j + 1, k + 1], field.values[i + 1, j + 1, k + 1], u)
    return wp.lerp(wp.lerp(b00, b10, v), wp.lerp(b01, b11, v), w)


@wp.func
def surface_normal(field: DistanceField, size: float, x: wp.vec3, step: float) -> wp.vec3:
    """Outward unit normal at x from central differences of half width `step` [m].

    The six points share their coordinates across the step, so the cells are found once per axis.
    """
    y = x / size
    h = wp.vec3(1.0, 1.0, 1.0) * (step / size)
    at = _nearest_in_grid(field, (y - field.origin) * field.per_cell)
    ahead = _nearest_in_grid(field, (y + h - field.origin) * field.per_cell)
    behind = _nearest_in_grid(field, (y - h - field.origin) * field.per_cell)
    i, u = _cell(at[0], field.last[0])
    j, v = _cell(at[1], field.last[1])
    k, w = _cell(at[2], field.last[2])
    i1, u1 = _cell(ahead[0], field.last[0])
    j1, v1 = _cell(ahead[1], field.last[1])
    k1, w1 = _cell(ahead[2], field.last[2])
    i0, u0 = _cell(behind[0], field.last[0])
    j0, v0 = _cell(behind[1], field.last[1])
    k0, w0 = _cell(behind[2], field.last[2])
    n = wp.vec3(
        _value(field, i1, j, k, u1, v, w) - _value(field, i0, j, k, u0, v, w),
        _value(field, i, j1, k, u, v1, w) - _value(field, i, j0, k, u, v0, w),
        _value(field, i, j, k1, u, v, w1) - _value(field, i, j, k0, u, v, w0),
    )
    return wp.normalize(n)


@wp.kernel
def closest_surface(
    # Object:
    field: DistanceField,
    size: wp.array[float],
    step: float,
    # Problem in:
    centres_in: wp.array2d[wp.vec3],
    # Problem out:
    distance_out: wp.array2d[float],
    gradient_out: wp.array2d[wp.vec3],
    points_out: wp.array2d[wp.vec3],
    normals_in_out: wp.array2d[wp.vec3],
):
    """Distance, closest surface point and inward unit normal there of contact centres, (N, M)."""
    grasp, i = wp.tid()
    c = centres_in[grasp, i]
    s = signed_distance(field, size[grasp], c)
    slope = wp.vec3(s[1], s[2], s[3])
    p = c - s[0] * wp.normalize(slope)
    distance_out[grasp, i] = s[0]
    gradient_out[grasp, i] = slope
    points_out[grasp, i] = p
    normals_in_out[grasp, i] = -surface_normal(field, size[grasp], p, step)


@wp.kernel
def surface_chain(
    # Object:
    field: DistanceField,
    size: wp.array[float],
    step: float,
    # Problem in:
    points_in: wp.array2d[wp.vec3],
    normals_in_in: wp.array2d[wp.vec3],
    point_gradient_in: wp.array2d[wp.vec3],
    normal_gradient_in: wp.array2d[wp.vec3],
    # Problem out:
    centre_gradient_inout: wp.array2d[wp.vec3],
):
    """Carry gradients at surface points and inward normals back to the contact centres.

    A centre moves its closest point along the tangent plane, and the normal turns with the point.
    The normal's Jacobian is symmetric, so its transpose times g is the normal's change along g.
    """
    grasp, i = wp.tid()
    p = points_in[grasp, i]
    n = normals_in_in[grasp, i]
    along = normal_gradient_in[grasp, i]
    along = along - wp.dot(along, n) * n
    total = point_gradient_in[grasp, i]
    length = wp.length(along)
    if length > 1.0e-12:
        shift = along * (step / length)
        ahead = surface_normal(field, size[grasp], p + shift, step)
        behind = surface_normal(field, size[grasp], p - shift, step)
        total = total - (ahead - behind) * (length / (2.0 * step))
    centre_gradient_inout[grasp, i] = centre_gradient_inout[grasp, i] + total - wp.dot(total, n) * n
