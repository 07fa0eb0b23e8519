"""Kernels over triangle meshes: distances, winding-number signs, half-space tests, short rays."""

import warp as wp

wp.set_module_options({"enable_backward": False})


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
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points_in[i], max_distance)
    if query.result:
        p = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        closest_out[i] = p
        distance_out[i] = wp.length(p - points_in[i])
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
    # Query out:
    distance_out: wp.array[float],
):
    i = wp.tid()
    query = wp.mesh_query_point_sign_winding_number(mesh, points_in[i], max_distance)
    if query.result:
        p = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        distance_out[i] = query.sign * wp.length(p - points_in[i])
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
    i, j, k = wp.tid()
    p = origin + cell * wp.vec3(float(i), float(j), float(k))
    found = int(0)
    for piece in range(pieces):
        if found == 0:
            low = lower[piece]
            up = upper[piece]
            within = p[0] >= low[0] and p[1] >= low[1] and p[2] >= low[2]
            within = within and p[0] <= up[0] and p[1] <= up[1] and p[2] <= up[2]
            if within:
                held = int(1)
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
