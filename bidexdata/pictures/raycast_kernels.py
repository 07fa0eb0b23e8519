"""Kernels of the ray caster: the nearest hit of each ray, and its shade.

One thread per sample. Nothing is accumulated across threads, so a picture's bytes do not depend
on their order.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(1.0e6)


@wp.func
def ray_direction(
    row: int, column: int, rows: int, columns: int, R_world_camera: wp.mat33, tan_half_height: float
) -> wp.vec3:
    """Unit direction through the middle of a sample; row 0 is the top of the picture."""
    y = tan_half_height * (1.0 - (2.0 * float(row) + 1.0) / float(rows))
    x = (
        tan_half_height
        * (float(columns) / float(rows))
        * ((2.0 * float(column) + 1.0) / float(columns) - 1.0)
    )
    return wp.normalize(R_world_camera * wp.vec3(x, y, -1.0))


@wp.func
def linear_from_srgb(colour: wp.vec3) -> wp.vec3:
    """Undo the display's transfer curve (a power of 2.2) so that light adds up."""
    return wp.vec3(wp.pow(colour[0], 2.2), wp.pow(colour[1], 2.2), wp.pow(colour[2], 2.2))


@wp.func
def tangent_frame(normal: wp.vec3) -> wp.mat33:
    """Some rotation whose third column is `normal`; defined for every unit vector."""
    helper = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(normal[0]) > 0.6:
        helper = wp.vec3(0.0, 1.0, 0.0)
    x = wp.normalize(wp.cross(helper, normal))
    return wp.matrix_from_cols(x, wp.cross(normal, x), normal)


@wp.kernel
def cast_rays(
    # Scene:
    mesh: wp.uint64,
    # Camera:
    position: wp.vec3,
    R_world_camera: wp.mat33,
    tan_half_height: float,
    # Out:
    distance_out: wp.array2d[float],
    face_out: wp.array2d[int],
    bary_out: wp.array2d[wp.vec2],
):
    """Find the nearest hit through each sample; an infinite distance and face -1 mean none."""
    row, column = wp.tid()
    direction = ray_direction(
        row,
        column,
        distance_out.shape[0],
        distance_out.shape[1],
        R_world_camera,
        tan_half_height,
    )
    hit = wp.mesh_query_ray(mesh, position, direction, FAR)
    if hit.result:
        distance_out[row, column] = hit.t
        face_out[row, column] = hit.face
        bary_out[row, column] = wp.vec2(hit.u, hit.v)
    else:
        distance_out[row, column] = wp.inf
        face_out[row, column] = -1
        bary_out[row, column] = wp.vec2(0.0, 0.0)


@wp.kernel
def shade(
    # Scene:
    mesh: wp.uint64,
    face_colour: wp.array[wp.vec3],
    corner_normal: wp.array2d[wp.vec3],
    # Camera:
    position: wp.vec3,
    R_world_camera: wp.mat33,
    tan_half_height: float,
    # Light:
    to_key: wp.vec3,
    shadow_offset: float,
    sky_length: float,
    sky_direction: wp.array[wp.vec3],
    # Hits:
    distance_in: wp.array2d[float],
    face_in: wp.array2d[int],
    bary_in: wp.array2d[wp.vec2],
    # Out:
    light_out: wp.array2d[wp.vec3],
):
    """Light that each hit sends to the camera, linear in [0, 1]; the background where none is."""
    row, column = wp.tid()
    rows = distance_in.shape[0]
    direction = ray_direction(
        row, column, rows, distance_in.shape[1], R_world_camera, tan_half_height
    )
    face = face_in[row, column]
    if face < 0:
        # Neutral background, a little darker towards the bottom.
        grey = 0.96 - 0.10 * float(row) / float(rows)
        light_out[row, column] = linear_from_srgb(wp.vec3(grey, grey, grey + 0.01))
        return

    u = bary_in[row, column][0]
    v = bary_in[row, column][1]
    flat = wp.mesh_eval_face_normal(mesh, face)
    normal = wp.normalize(
        u * corner_normal[face, 0]
        + v * corner_normal[face, 1]
        + (1.0 - u - v) * corner_normal[face, 2]
    )
    if wp.dot(flat, direction) > 0.0:  # seen from behind
        flat = -flat
    if wp.dot(normal, flat) < 0.0:
        normal = -normal
    if wp.length(normal) < 0.5:
        normal = flat
    point = position + distance_in[row, column] * direction + shadow_offset * flat

    key = wp.max(wp.dot(normal, to_key), 0.0)
    if key > 0.0:
        blocked = wp.mesh_query_ray(mesh, point, to_key, FAR)
        if blocked.result:
            key = 0.0
    fill = wp.max(-wp.dot(normal, direction), 0.0)  # a weak lamp at the camera

    # Sky light, less where near surfaces hide it. The directions turn with the sample's place in
    # a 4 x 4 pattern, so that few rays give a soft edge and not one edge per ray.
    frame = tangent_frame(flat)
    turn = 2.0 * wp.pi * float(4 * ((row + 2 * column) % 4) + (column % 4)) / 16.0
    seen = float(0.0)
    for k in range(sky_direction.shape[0]):
        d = sky_direction[k]
        c = wp.cos(turn)
        s = wp.sin(turn)
        towards = frame * wp.vec3(c * d[0] - s * d[1], s * d[0] + c * d[1], d[2])
        near = wp.mesh_query_ray(mesh, point, towards, sky_length)
        if not near.result:
            seen += 1.0
    sky = seen / wp.max(float(sky_direction.shape[0]), 1.0)

    up = 0.5 + 0.5 * normal[2]
    half = wp.normalize(to_key - direction)
    gloss = wp.pow(wp.max(wp.dot(normal, half), 0.0), 32.0)
    if key == 0.0:
        gloss = 0.0
    base = linear_from_srgb(face_colour[face])
    strength = 0.62 * key + 0.16 * fill + (0.20 + 0.20 * up) * sky
    light_out[row, column] = strength * base + 0.10 * gloss * wp.vec3(1.0, 1.0, 1.0)
