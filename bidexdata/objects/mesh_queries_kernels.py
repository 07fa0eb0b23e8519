"""Kernels over triangle meshes: distances, winding-number signs, half-space tests, short rays."""

import warp as wp

wp.set_module_options({"enable_backward": False})

CLOSE = wp.constant(4.0e-3)
"""Distance on a mesh of unit diagonal below which the search is repeated exactly."""

WINDING_ACCURACY = wp.constant(2.0)
"""Of Warp's estimate of winding numbers; its default."""


@wp.func
def closest_on_segment(a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Point of the segment a-b closest to the origin."""
    ab = b - a
    square = wp.length_sq(ab)
    t = float(0.0)
    if square > 0.0:
        t = wp.clamp(-wp.dot(a, ab) / square, 0.0, 1.0)
    return a + t * ab


@wp.func
def closest_on_triangle(a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Point of a triangle closest to the origin; exact to rounding, needles included.

    Corners are relative to the query point, so small distances do not cancel.
    """
    best = closest_on_segment(a, b)
    other = closest_on_segment(b, c)
    if wp.length_sq(other) < wp.length_sq(best):
        best = other
    other = closest_on_segment(c, a)
    if wp.length_sq(other) < wp.length_sq(best):
        best = other
    normal = wp.cross(b - a, c - a)
    square = wp.length_sq(normal)
    if square > 0.0:
        inside = wp.dot(wp.cross(a, b), normal) >= 0.0
        inside = inside and wp.dot(wp.cross(b, c), normal) >= 0.0
        inside = inside and wp.dot(wp.cross(c, a), normal) >= 0.0
        if inside:
            foot = (wp.dot(a, normal) / square) * normal
            if wp.length_sq(foot) < wp.length_sq(best):
                best = foot
    return best


@wp.func
def way_to_face(mesh: wp.uint64, face: int, p: wp.vec3) -> wp.vec3:
    """Vector from p to the closest point of a face."""
    a = wp.mesh_get_point(mesh, 3 * face) - p
    b = wp.mesh_get_point(mesh, 3 * face + 1) - p
    c = wp.mesh_get_point(mesh, 3 * face + 2) - p
    return closest_on_triangle(a, b, c)


@wp.func
def way_to_surface(mesh: wp.uint64, face: int, p: wp.vec3) -> wp.vec3:
    """Vector from p to the closest point of the mesh, given a face that is about the closest.

    On long thin triangles Warp's search is off sideways by up to 5e-4 of a unit mesh and may name
    a neighbour. That only matters where the distance itself is small: there all faces within it
    are measured again.
    """
    way = way_to_face(mesh, face, p)
    reach = wp.length(way)
    if reach < CLOSE:
        room = wp.vec3(reach, reach, reach)
        query = wp.mesh_query_aabb(mesh, p - room, p + room)
        other = wp.int32(0)
        while wp.mesh_query_aabb_next(query, other):
            shorter = way_to_face(mesh, other, p)
            if wp.length_sq(shorter) < wp.length_sq(way):
                way = shorter
    return way


@wp.kernel
def closest_points(
    # Mesh:
    mesh: wp.uint64,
    # Query in:
    points_in: wp.array[wp.vec3],
    max_distance: float,
    # Query out:
    closest_out: wp.array[wp.vec3],
    distance_out: wp.array[float],
):
    """Closest point of the mesh and its distance, one thread per point."""
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points_in[i], max_distance)
    if query.result:
        way = way_to_surface(mesh, query.face, points_in[i])
        closest_out[i] = points_in[i] + way
        distance_out[i] = wp.length(way)
    else:
        closest_out[i] = points_in[i]
        distance_out[i] = max_distance


@wp.kernel
def winding_distance(
    # Mesh:
    mesh: wp.uint64,
    # Query in:
    points_in: wp.array[wp.vec3],
    max_distance: float,
    threshold: float,
    # Query out:
    distance_out: wp.array[float],
):
    """Distance signed by the winding number, one thread per point."""
    i = wp.tid()
    query = wp.mesh_query_point_sign_winding_number(
        mesh, points_in[i], max_distance, WINDING_ACCURACY, threshold
    )
    if query.result:
        distance_out[i] = query.sign * wp.length(way_to_surface(mesh, query.face, points_in[i]))
    else:
        distance_out[i] = max_distance


@wp.kernel
def inside_pieces(
    # Pieces:
    planes: wp.array[wp.vec4],
    first_plane: wp.array[int],
    lower: wp.array[wp.vec3],
    upper: wp.array[wp.vec3],
    pieces: int,
    # Grid:
    origin: wp.vec3,
    cell: float,
    # Grid out:
    inside_out: wp.array3d[wp.uint8],
):
    """Half-space tests of all pieces, one thread per grid node."""
    i, j, k = wp.tid()
    p = origin + cell * wp.vec3(float(i), float(j), float(k))
    found = wp.int32(0)
    for piece in range(pieces):
        if found == 0:
            low = lower[piece]
            up = upper[piece]
            within = p[0] >= low[0] and p[1] >= low[1] and p[2] >= low[2]
            within = within and p[0] <= up[0] and p[1] <= up[1] and p[2] <= up[2]
            if within:
                held = wp.int32(1)
                plane = first_plane[piece]
                while held == 1 and plane < first_plane[piece + 1]:
                    h = planes[plane]
                    if h[0] * p[0] + h[1] * p[1] + h[2] * p[2] > h[3]:
                        held = 0
                    plane += 1
                found = held
    inside_out[i, j, k] = wp.uint8(found)


@wp.kernel
def ray_hits(
    # Mesh:
    mesh: wp.uint64,
    # Query in:
    start_in: wp.array[wp.vec3],
    direction_in: wp.array[wp.vec3],
    max_distance: float,
    # Query out:
    hit_out: wp.array[wp.uint8],
):
    """Whether a short ray meets the mesh, one thread per ray."""
    i = wp.tid()
    query = wp.mesh_query_ray(mesh, start_in[i], direction_in[i], max_distance)
    hit_out[i] = wp.uint8(0)
    if query.result:
        hit_out[i] = wp.uint8(1)


@wp.kernel
def adopt_nearer_donor(
    # Donors:
    closest: wp.array[wp.vec3],
    exact: wp.array3d[wp.uint8],
    # Grid:
    origin: wp.vec3,
    cell: float,
    stride: int,
    donor_in: wp.array3d[int],
    # Grid out:
    donor_out: wp.array3d[int],
    distance_out: wp.array3d[float],
):
    """Best closest point among those that a node and its 26 neighbours know."""
    i, j, k = wp.tid()
    p = origin + cell * wp.vec3(float(i), float(j), float(k))
    best = donor_in[i, j, k]
    nearest = wp.length_sq(p - closest[best])
    if exact[i, j, k] == wp.uint8(0):
        for di in range(-1, 2):
            for dj in range(-1, 2):
                for dk in range(-1, 2):
                    a = i + di * stride
                    b = j + dj * stride
                    c = k + dk * stride
                    ok = a >= 0 and b >= 0 and c >= 0
                    ok = ok and a < donor_in.shape[0]
                    ok = ok and b < donor_in.shape[1]
                    ok = ok and c < donor_in.shape[2]
                    if ok:
                        other = donor_in[a, b, c]
                        if other != best:
                            square = wp.length_sq(p - closest[other])
                            if square < nearest:
                                nearest = square
                                best = other
    donor_out[i, j, k] = best
    distance_out[i, j, k] = wp.sqrt(nearest)
