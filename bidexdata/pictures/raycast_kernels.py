"""Kernels of the ray caster: the nearest hit of each ray, and its shade.

One thread per sample. Nothing is accumulated across threads, so a picture's bytes do not depend
on their order. A sample is a place in the picture: x from -1 (left) to 1, y from -1 (bottom) to 1.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(1.0e6)
OWN_NORMAL = wp.constant(0.5)
"""Least cosine between a face's smooth and own normal; only slivers, whose own is noise, have less."""
SAME_NORMAL = wp.constant(0.8)
"""Least cosine between normals of places that may share the sky they see."""
FLAT = wp.constant(0.05)
"""Such places are at most so far out of one plane, as a fraction of the sky's reach [-]."""
LEAST_WEIGHT = wp.constant(0.1)
"""Where such places are fewer or farther, a hit looks at the sky itself [-]."""


@wp.struct
class Surface:
    """A place where a ray ended."""

    point: wp.vec3
    normal: wp.vec3


@wp.func
def ray_direction(place: wp.vec2, R_world_camera: wp.mat33, tangent: wp.vec2) -> wp.vec3:
    """Unit direction through a sample; `tangent` is that of half the width and half the height."""
    return wp.normalize(
        R_world_camera * wp.vec3(tangent[0] * place[0], tangent[1] * place[1], -1.0)
    )


@wp.func
def linear_from_srgb(colour: wp.vec3) -> wp.vec3:
    """Undo the display's transfer curve (a power of 2.2) so that light adds up."""
    return wp.vec3(wp.pow(colour[0], 2.2), wp.pow(colour[1], 2.2), wp.pow(colour[2], 2.2))


@wp.func
def above_plane(point: wp.vec3, vertex: wp.vec3, normal: wp.vec3) -> wp.vec3:
    """Lift a point to the plane through a vertex where it is below it."""
    return point - wp.min(wp.dot(point - vertex, normal), 0.0) * normal


@wp.kernel
def cast_rays(
    # Scene:
    mesh: wp.uint64,
    # Camera:
    position: wp.vec3,
    R_world_camera: wp.mat33,
    tangent: wp.vec2,
    # In:
    place_in: wp.array[wp.vec2],
    # Out:
    distance_out: wp.array[float],
    face_out: wp.array[int],
    bary_out: wp.array[wp.vec2],
):
    """Find the nearest hit through each sample; an infinite distance and face -1 mean none."""
    i = wp.tid()
    direction = ray_direction(place_in[i], R_world_camera, tangent)
    hit = wp.mesh_query_ray(mesh, position, direction, FAR)
    if hit.result:
        distance_out[i] = hit.t
        face_out[i] = hit.face
        bary_out[i] = wp.vec2(hit.u, hit.v)
    else:
        distance_out[i] = wp.inf
        face_out[i] = -1
        bary_out[i] = wp.vec2(0.0, 0.0)


@wp.func
def surface(
    mesh: wp.uint64,
    corner_normal: wp.array2d[wp.vec3],
    start: wp.vec3,
    direction: wp.vec3,
    distance: float,
    face: int,
    bary: wp.vec2,
    offset: float,
) -> Surface:
    """What a ray met: the smooth normal on the side that it came from, and where light starts.

    Light starts on the smooth surface that the normals speak of, not on the flat triangle below
    it, which would shade itself in the shape of its facets (Hanika, Ray Tracing Gems II, 4).
    """
    u = bary[0]
    v = bary[1]
    w = 1.0 - u - v
    n0 = corner_normal[face, 0]
    n1 = corner_normal[face, 1]
    n2 = corner_normal[face, 2]
    flat = wp.mesh_eval_face_normal(mesh, face)
    smooth = wp.normalize(u * n0 + v * n1 + w * n2)
    if wp.length(smooth) < 0.5:  # corners without a normal
        smooth = flat
    if wp.dot(smooth, flat) < OWN_NORMAL:
        flat = smooth
    side = float(1.0)
    if wp.dot(flat, direction) > 0.0:
        side = -1.0
    hit = start + distance * direction
    found = Surface()
    found.normal = side * smooth
    found.point = (
        u * above_plane(hit, wp.mesh_get_point(mesh, 3 * face), side * n0)
        + v * above_plane(hit, wp.mesh_get_point(mesh, 3 * face + 1), side * n1)
        + w * above_plane(hit, wp.mesh_get_point(mesh, 3 * face + 2), side * n2)
        + offset * side * flat
    )
    return found


@wp.func
def open_sky(mesh: wp.uint64, at: Surface, reach: float, sky_direction: wp.array[wp.vec3]) -> float:
    """Share of the sky that near things leave free, in [0, 1].

    The directions are the same at every place and count by their height over the surface, so
    that neither a pattern nor an edge of theirs shows; what is far hides less.
    """
    seen = float(0.0)
    whole = float(1.0e-6)
    for k in range(sky_direction.shape[0]):
        weight = wp.dot(at.normal, sky_direction[k])
        if weight > 0.0:
            whole += weight
            near = wp.mesh_query_ray(mesh, at.point, sky_direction[k], reach)
            if near.result:
                seen += weight * near.t / reach
            else:
                seen += weight
    return seen / whole


@wp.kernel
def open_sky_at(
    # Scene:
    mesh: wp.uint64,
    corner_normal: wp.array2d[wp.vec3],
    # Camera:
    position: wp.vec3,
    R_world_camera: wp.mat33,
    tangent: wp.vec2,
    # Light:
    offset: float,
    reach: float,
    sky_direction: wp.array[wp.vec3],
    # In:
    place_in: wp.array[wp.vec2],
    distance_in: wp.array[float],
    face_in: wp.array[int],
    bary_in: wp.array[wp.vec2],
    # Out:
    point_out: wp.array[wp.vec3],
    normal_out: wp.array[wp.vec3],
    sky_out: wp.array[float],
):
    """Ask how much sky the hits see; where there is none the normal is zero."""
    i = wp.tid()
    if face_in[i] < 0:
        point_out[i] = wp.vec3(0.0, 0.0, 0.0)
        normal_out[i] = wp.vec3(0.0, 0.0, 0.0)
        sky_out[i] = 1.0
        return
    direction = ray_direction(place_in[i], R_world_camera, tangent)
    at = surface(
        mesh, corner_normal, position, direction, distance_in[i], face_in[i], bary_in[i], offset
    )
    point_out[i] = at.point
    normal_out[i] = at.normal
    sky_out[i] = open_sky(mesh, at, reach, sky_direction)


@wp.func
def nearby_sky(
    at: Surface,
    place: wp.vec2,
    size: wp.vec2i,
    flatness: float,
    point: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    sky: wp.array[float],
) -> float:
    """Interpolate between the four nearest of a grid's points on the same surface; -1: none is."""
    x = 0.5 * (place[0] + 1.0) * float(size[0]) - 0.5
    y = 0.5 * (1.0 - place[1]) * float(size[1]) - 0.5
    column = int(wp.floor(x))
    row = int(wp.floor(y))
    total = float(0.0)
    weights = float(0.0)
    for k in range(4):
        c = column + k % 2
        r = row + k // 2
        near = (1.0 - wp.abs(x - float(c))) * (1.0 - wp.abs(y - float(r)))
        i = wp.clamp(r, 0, size[1] - 1) * size[0] + wp.clamp(c, 0, size[0] - 1)
        alike = (wp.dot(at.normal, normal[i]) - SAME_NORMAL) / (1.0 - SAME_NORMAL)
        level = 1.0 - wp.abs(wp.dot(at.normal, at.point - point[i])) / flatness
        weight = near * wp.max(alike, 0.0) * wp.max(level, 0.0)
        total += weight * sky[i]
        weights += weight
    if weights < LEAST_WEIGHT:
        return -1.0
    return total / weights


@wp.kernel
def shade(
    # Scene:
    mesh: wp.uint64,
    face_colour: wp.array[wp.vec3],
    corner_normal: wp.array2d[wp.vec3],
    # Camera:
    position: wp.vec3,
    R_world_camera: wp.mat33,
    tangent: wp.vec2,
    # Light:
    to_key: wp.vec3,
    offset: float,
    reach: float,
    sky_direction: wp.array[wp.vec3],
    # Sky that a grid of places sees:
    grid_size: wp.vec2i,
    grid_point: wp.array[wp.vec3],
    grid_normal: wp.array[wp.vec3],
    grid_sky: wp.array[float],
    # In:
    place_in: wp.array[wp.vec2],
    distance_in: wp.array[float],
    face_in: wp.array[int],
    bary_in: wp.array[wp.vec2],
    # Out:
    light_out: wp.array[wp.vec3],
):
    """Light that each hit sends to the camera, linear in [0, 1]; the background where none is."""
    i = wp.tid()
    face = face_in[i]
    if face < 0:
        # Neutral background, a little darker towards the bottom.
        grey = 0.91 + 0.05 * place_in[i][1]
        light_out[i] = linear_from_srgb(wp.vec3(grey, grey, grey + 0.01))
        return

    direction = ray_direction(place_in[i], R_world_camera, tangent)
    at = surface(mesh, corner_normal, position, direction, distance_in[i], face, bary_in[i], offset)
    key = wp.max(wp.dot(at.normal, to_key), 0.0)
    if key > 0.0:  # noqa: SIM102 (Warp evaluates both sides of an `and`: a ray for each)
        if wp.mesh_query_ray_anyhit(mesh, at.point, to_key, FAR):
            key = 0.0
    fill = wp.max(-wp.dot(at.normal, direction), 0.0)  # a weak lamp at the camera
    sky = nearby_sky(at, place_in[i], grid_size, FLAT * reach, grid_point, grid_normal, grid_sky)
    if sky < 0.0:
        sky = open_sky(mesh, at, reach, sky_direction)

    up = 0.5 + 0.5 * at.normal[2]
    half = wp.normalize(to_key - direction)
    gloss = wp.pow(wp.max(wp.dot(at.normal, half), 0.0), 32.0)
    if key == 0.0:
        gloss = 0.0
    base = linear_from_srgb(face_colour[face])
    strength = 0.62 * key + 0.16 * fill + (0.20 + 0.20 * up) * sky
    light_out[i] = strength * base + 0.10 * gloss * wp.vec3(1.0, 1.0, 1.0)
