import numpy as np
import pytest
from picture_samples import BOX_FACES, box_mesh

from bidexdata.pictures.camera import framed, look_at, view_rotation
from bidexdata.pictures.raycast import KEY_LIGHT, RayScene
from bidexdata.pictures.scene import corner_normals, disc, face_normals, mesh_part, sphere

RED = (0.9, 0.1, 0.1)
BLUE = (0.1, 0.1, 0.9)
# 320 triangles inscribed in the sphere: the silhouette is up to 2 % of the radius inside it.
FACET = 0.02
DIRECTIONS = [
    (1, 0, 0),
    (0, -1, 0),
    (0, 0, 1),
    (0, 0, -1),
    (0.3, -0.5, 0.8),
    (-0.6, 0.7, -0.2),
]


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_sphere_has_the_silhouette_and_depth_of_geometry(direction):
    radius, distance, n = 0.1, 0.8, 301
    camera = look_at((0.2, -0.1, 0.4), direction, distance)
    hits = RayScene([sphere((0.2, -0.1, 0.4), radius, RED, "object")]).hits(camera, n, n)

    # A sphere at distance d seen in perspective is a disc of tangent r / sqrt(d^2 - r^2).
    tangent = radius / np.sqrt(distance**2 - radius**2)
    area = np.pi * (tangent / camera.tan_half_height * n / 2) ** 2
    assert (1 - 2 * FACET) * area < np.sum(hits.part == 0) < 1.005 * area
    nearest = hits.distance[n // 2, n // 2]
    assert distance - radius <= nearest + 1e-6 < distance - radius * (1 - FACET) + 1e-6
    assert np.all(np.isinf(hits.distance[hits.part < 0]))
    assert hits.part[0, 0] == -1


def test_the_nearer_part_hides_the_farther_in_either_order():
    near = sphere((0, 0, 0.2), 0.05, RED, "near")
    far = sphere((0, 0, 0.0), 0.10, BLUE, "far")
    camera = look_at((0, 0, 0.1), (0, 0, 1), 1.0)
    first = RayScene([near, far]).hits(camera, 64, 64).part
    second = RayScene([far, near]).hits(camera, 64, 64).part
    assert first[32, 32] == 0
    assert second[32, 32] == 1
    assert np.array_equal(first >= 0, second >= 0)
    assert np.array_equal(first[first >= 0], 1 - second[second >= 0])


def test_right_is_right_and_up_is_up():
    camera = look_at((0, 0, 0), (0, -1, 0), 1.0)  # from -y: x to the right, z up
    right, up = sphere((0.1, 0, 0), 0.03, RED, "x"), sphere((0, 0, 0.1), 0.03, BLUE, "z")
    part = RayScene([right, up]).hits(camera, 100, 100).part
    rows, columns = np.nonzero(part == 0)
    assert columns.mean() > 60
    assert abs(rows.mean() - 49.5) < 1
    rows, columns = np.nonzero(part == 1)
    assert rows.mean() < 40
    assert abs(columns.mean() - 49.5) < 1


def test_drawing_twice_gives_the_same_bytes():
    parts = [sphere((0, 0, 0.1), 0.1, RED, "a"), disc((0, 0, 0), 0.4, BLUE)]
    camera = framed(parts[0].vertices, (0.5, -0.7, 0.4), 1.5)
    first = RayScene(parts).draw(camera, 90, 60)
    assert first.shape == (60, 90, 3)
    assert np.array_equal(first, RayScene(parts).draw(camera, 90, 60))


def test_a_part_keeps_its_colour_and_a_lamp_casts_a_shadow():
    ball = sphere((0, 0, 0.15), 0.1, RED, "ball")
    ground = disc((0, 0, 0), 0.5, (0.8, 0.8, 0.8))
    camera = look_at((0, 0, 0.05), (0, -0.7, 0.7), 1.5)
    alone = RayScene([ground]).draw(camera, 80, 80).astype(int)
    both = RayScene([ground, ball]).draw(camera, 80, 80).astype(int)
    part = RayScene([ground, ball]).hits(camera, 80, 80).part
    r, _, b = both[part == 1].T
    assert np.all(r > b)
    shaded = (alone - both).sum(axis=2)[part == 0]
    assert shaded.max() > 100  # the ball's shadow
    assert np.median(shaded) < 30  # and most of the ground as before


@pytest.mark.parametrize("parts", [[], [mesh_part(np.zeros((0, 3)), np.zeros((0, 3)), RED, "")]])
def test_a_picture_of_nothing_is_background(parts):
    camera = look_at((0, 0, 0), (0, -1, 0), 1.0)
    scene = RayScene(parts)
    assert np.all(scene.hits(camera, 8, 8).part == -1)
    assert scene.draw(camera, 8, 8).min() > 200
    assert scene.visible(camera, 8, 8).shape == (len(parts),)


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_framing_shows_every_point_and_fills_the_picture(direction, aspect):
    rng = np.random.default_rng(4)
    points = rng.normal(size=(200, 3)) * [0.1, 0.3, 0.05] + [1, 2, 3]
    camera = framed(points, direction, aspect, margin=0.05)
    local = (points - camera.position) @ camera.R_world_camera
    x = local[:, 0] / -local[:, 2] / camera.tan_half_height / aspect
    y = local[:, 1] / -local[:, 2] / camera.tan_half_height
    assert np.all(local[:, 2] < 0)
    reach = max(np.abs(x).max(), np.abs(y).max())
    assert 0.85 < reach <= 0.9 + 1e-9


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_view_rotation_is_a_rotation_that_looks_along_the_direction(direction):
    R = view_rotation(direction)
    assert np.allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) > 0
    assert np.allclose(R[:, 2] * np.linalg.norm(direction), direction)
    assert R[2, 1] >= -1e-12  # world up is not down in the picture


def test_shading_is_flat_on_a_box_and_radial_on_a_sphere():
    box = box_mesh((0, 0, 0), (1, 2, 3))
    own = np.repeat(face_normals(box.vertices, box.faces)[:, None], 3, axis=1)
    assert np.allclose(corner_normals(box.vertices, box.faces), own)
    ball = sphere((0, 0, 0), 1.0, RED, "")
    again = corner_normals(ball.vertices, ball.faces)
    assert np.min(np.einsum("fci,fci->fc", again, ball.vertices[ball.faces])) > 0.999


def test_a_seam_in_the_file_does_not_show():
    ball = sphere((0, 0, 0), 1.0, RED, "")
    torn_v = ball.vertices[ball.faces].reshape(-1, 3)  # every face has its own vertices
    torn_f = np.arange(len(torn_v), dtype=np.int32).reshape(-1, 3)
    whole = corner_normals(ball.vertices, ball.faces)
    assert np.allclose(corner_normals(torn_v, torn_f), whole, atol=1e-9)


def test_corner_normals_hold_without_area_and_without_faces():
    flat = corner_normals(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))
    assert np.array_equal(flat, np.zeros((1, 3, 3)))
    assert corner_normals(np.zeros((0, 3)), np.zeros((0, 3), np.int32)).shape == (0, 3, 3)
    assert BOX_FACES.dtype == np.int32


def test_what_hides_the_sky_leaves_no_pattern_on_a_table():
    parts = [sphere((0, 0, 0.12), 0.1, RED, "ball"), disc((0, 0, 0), 0.5, (0.8, 0.8, 0.8))]
    camera = look_at((0, 0, 0.05), (0, -0.5, 0.85), 1.0)
    scene = RayScene(parts)
    picture = scene.draw(camera, 160, 120).astype(float)
    ground = scene.hits(camera, 160, 120).part == 1
    crossing = [np.abs(np.diff(picture, 2, axis=a)).max(axis=2) for a in (0, 1)]
    rough = np.maximum(crossing[0][:, 1:-1], crossing[1][1:-1])
    # The rim of the ball and of its shadow, a pixel to each side, are all that is not smooth.
    assert np.mean(rough[ground[1:-1, 1:-1]] > 4) < 0.06


def test_a_coarse_ball_is_shaded_as_the_ball_it_stands_for():
    radius, n = 0.1, 161
    camera = look_at((0, 0, 0), (0.4, -0.8, 0.3), 0.6)
    scene = RayScene([sphere((0, 0, 0), radius, (1, 1, 1), "ball")])
    hits, drawn = scene.hits(camera, n, n), scene.draw(camera, n, n, samples=1)
    step = camera.tan_half_height * ((2 * np.arange(n) + 1) / n - 1)
    across, up = np.meshgrid(step, -step)
    ray = np.stack([across, up, -np.ones_like(up)], 2) @ camera.R_world_camera.T
    ray /= np.linalg.norm(ray, axis=2, keepdims=True)
    with np.errstate(invalid="ignore"):
        normal = camera.position + hits.distance[..., None] * ray
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    lamp = camera.R_world_camera @ (np.array(KEY_LIGHT) / np.linalg.norm(KEY_LIGHT))
    key, fill = np.maximum(normal @ lamp, 0), np.maximum(-(normal * ray).sum(2), 0)
    light = 0.62 * key + 0.16 * fill + 0.2 + 0.2 * (0.5 + 0.5 * normal[..., 2])
    inside = (hits.part == 0) & (fill > 0.2)
    dull = inside & (drawn.max(axis=2) < 240)  # where the lamp is not mirrored
    wanted = 255 * np.clip(light, 0, 1) ** (1 / 2.2)
    # A ball hides no sky and no lamp from itself, whatever triangles it is made of.
    assert np.abs(drawn[..., 0] - wanted)[dull & (key < 0.7)].max() < 2


def test_a_moved_scene_is_the_scene_that_would_be_built_there():
    def parts(x):
        return [sphere((x, 0, 0.1), 0.1, RED, "ball"), disc((0, 0, 0), 0.4, BLUE)]

    camera = look_at((0, 0, 0.1), (0.3, -0.8, 0.4), 1.4)
    scene = RayScene(parts(0.0))
    for x in (0.1, -0.25, 0.0):
        scene.move(parts(x))
        assert np.array_equal(scene.draw(camera, 80, 60), RayScene(parts(x)).draw(camera, 80, 60))
    for other in ([], parts(0)[:1], parts(0)[::-1], [*parts(0), *parts(1)]):
        with pytest.raises(ValueError, match="same faces"):
            scene.move(other)


def test_more_rays_change_a_picture_at_its_edges_only():
    parts = [sphere((0, 0, 0.1), 0.1, RED, "ball"), disc((0, 0, 0), 0.4, BLUE)]
    camera = look_at((0, 0, 0.1), (0.3, -0.8, 0.4), 1.4)
    scene = RayScene(parts)
    one, many = (scene.draw(camera, 80, 60, samples=n).astype(int) for n in (1, 3))
    changed = np.abs(one - many).max(axis=2) > 0
    near = np.zeros_like(changed)
    for axis in (0, 1):
        for way in (1, -1):
            near |= np.abs(one - np.roll(one, way, axis=axis)).max(axis=2) > 3
    assert 0 < changed.mean() < 0.25
    assert np.all(near[changed])
