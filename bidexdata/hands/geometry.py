"""The collision and visual geoms of a compiled hand as convex shapes in their body's frame.

MuJoCo collides a mesh by its convex hull, so every shape here is convex: sphere, capsule, box and
cylinder in closed form, a mesh by the planes of its hull.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.frames import matrix_from_quat
from bidexdata.hands.model import FloatArray

if TYPE_CHECKING:
    import mujoco

_HIDDEN_GROUPS = 3
"""First geom group that MuJoCo's viewer hides unless asked; Menagerie keeps collision geoms there."""


class Planes(NamedTuple):
    """A convex hull as half spaces normals @ p <= offsets."""

    normals: FloatArray
    """Outward unit normals, (F, 3)."""
    offsets: FloatArray
    """[m], (F,)."""


class Shape(NamedTuple):
    """One geom; points map from its own frame to the body's by R p + pos."""

    kind: str
    """`sphere`, `capsule`, `cylinder`, `box` or `mesh`."""
    size: FloatArray
    """MuJoCo's size parameters [m], (3,)."""
    pos: FloatArray
    """[m], (3,)."""
    R: FloatArray
    """(3, 3)."""
    vertices: FloatArray
    """Surface triangles in the geom's frame [m], (V, 3); of a mesh, as given (not its hull)."""
    faces: np.ndarray
    """(F, 3) int32."""
    planes: Planes | None
    """The hull, for meshes."""
    rgba: tuple[float, float, float, float]


def body_shapes(model: mujoco.MjModel, *, visual: bool = False) -> list[list[Shape]]:
    """Give the shapes of every body of the hand (the world body left out), B lists.

    Args:
        model: Compiled hand.
        visual: Those to draw instead of those that collide: geoms that collide with nothing, and
            meshes that collide in a group that MuJoCo's viewer shows (a pad that is its own
            picture). A model without any visual geom is drawn by its collision geoms.
    """
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    wanted = collides
    if visual and not collides.all():
        is_mesh = model.geom_dataid >= 0
        wanted = ~collides | (is_mesh & (model.geom_group < _HIDDEN_GROUPS))
    shapes: list[list[Shape]] = [[] for _ in range(model.nbody - 1)]
    for geom in np.flatnonzero(wanted & (model.geom_bodyid > 0)):
        shapes[model.geom_bodyid[geom] - 1].append(_shape(model, int(geom), hull=not visual))
    return shapes


def depth(shapes: list[Shape], points: FloatArray) -> FloatArray:
    """How deep points of the body's frame lie inside the union of its shapes [m], (n,).

    The largest depth over the shapes: exact where one shape decides, else a lower bound. Outside,
    minus the depth is a lower bound on the distance (exact for all but boxes, cylinders, meshes).
    """
    if not shapes:
        return np.full(len(points), -np.inf)
    return np.max([_depth(shape, (points - shape.pos) @ shape.R) for shape in shapes], axis=0)


def surface_samples(shapes: list[Shape], spacing: float) -> tuple[FloatArray, FloatArray]:
    """Spread points over the surface of the union, in the body's frame.

    Args:
        shapes: Shapes of one body.
        spacing: Largest edge of the triangles whose corners and centres are taken [m].

    Returns:
        Points [m], (n, 3), and the area that each stands for [m^2], (n,).
    """
    points, areas = [np.zeros((0, 3))], [np.zeros(0)]
    for i, shape in enumerate(shapes):
        corners = shape.vertices[shape.faces] if shape.planes is None else _hull_triangles(shape)
        corners = _subdivided(corners, spacing) @ shape.R.T + shape.pos
        centres = corners.mean(axis=1)
        edges = corners[:, 1:] - corners[:, :1]
        area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
        others = shapes[:i] + shapes[i + 1 :]
        outside = depth(others, centres) < 1e-6
        points.append(centres[outside])
        areas.append(area[outside])
    return np.concatenate(points), np.concatenate(areas)


def _shape(model: mujoco.MjModel, geom: int, *, hull: bool) -> Shape:
    import mujoco

    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    size = model.geom_size[geom].copy()
    planes = None
    if kind == "mesh":
        vertices, faces = _mesh(model, int(model.geom_dataid[geom]))
        planes = _planes(vertices) if hull else None
    else:
        vertices, faces = tessellate(kind, size)
    return Shape(
        kind,
        size,
        model.geom_pos[geom].copy(),
        matrix_from_quat(model.geom_quat[geom]),
        vertices,
        faces,
        planes,
        _colour(model, geom),
    )


def _colour(model: mujoco.MjModel, geom: int) -> tuple[float, float, float, float]:
    material = model.geom_matid[geom]
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    r, g, b, a = (float(x) for x in rgba)
    return r, g, b, a


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[FloatArray, np.ndarray]:
    v, f = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[v : v + model.mesh_vertnum[mesh]].astype(np.float64)
    return vertices, model.mesh_face[f : f + model.mesh_facenum[mesh]].astype(np.int32)


def _planes(vertices: FloatArray) -> Planes:
    from scipy.spatial import ConvexHull

    equations = np.unique(ConvexHull(vertices).equations, axis=0)
    return Planes(equations[:, :3], -equations[:, 3])


def _hull_triangles(shape: Shape) -> FloatArray:
    from scipy.spatial import ConvexHull

    return shape.vertices[ConvexHull(shape.vertices).simplices]


def _depth(shape: Shape, p: FloatArray) -> FloatArray:
    """Depth of points in the geom's frame, (n,)."""
    radius = shape.size[0]
    if shape.planes is not None:
        return np.min(shape.planes.offsets - p @ shape.planes.normals.T, axis=1)
    if shape.kind == "sphere":
        return radius - np.linalg.norm(p, axis=1)
    if shape.kind == "capsule":
        end = np.clip(p[:, 2], -shape.size[1], shape.size[1])
        return radius - np.linalg.norm(p - end[:, None] * np.array([0.0, 0.0, 1.0]), axis=1)
    if shape.kind == "cylinder":
        return np.minimum(radius - np.hypot(p[:, 0], p[:, 1]), shape.size[1] - np.abs(p[:, 2]))
    assert shape.kind == "box"
    return np.min(shape.size - np.abs(p), axis=1)


def tessellate(kind: str, size: FloatArray, segments: int = 24) -> tuple[FloatArray, np.ndarray]:
    """Triangulate a primitive of MuJoCo in its own frame.

    Args:
        kind: `sphere`, `capsule`, `cylinder` or `box`.
        size: MuJoCo's size parameters [m].
        segments: Corners per turn.

    Returns:
        Vertices [m] (V, 3) and faces (F, 3), wound so that normals point out.
    """
    if kind == "box":
        return _box(size)
    radius, half = float(size[0]), float(size[1])
    if kind == "cylinder":
        profile = np.array([[0.0, -half], [radius, -half], [radius, half], [0.0, half]])
    else:
        half = half if kind == "capsule" else 0.0
        angle = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
        lift = np.where(angle < 0, -half, half)
        profile = np.stack([radius * np.cos(angle), radius * np.sin(angle) + lift], axis=1)
        if half > 0:
            # The equator appears at both ends of the straight part.
            equator = np.array([[radius, -half], [radius, half]])
            middle = np.searchsorted(angle, -1e-9)
            profile = np.concatenate([profile[:middle], equator, profile[middle + 1 :]])
    return _revolved(profile, segments)


def _box(size: FloatArray) -> tuple[FloatArray, np.ndarray]:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)]
    return corners, np.array(faces, np.int32)


def _revolved(profile: FloatArray, segments: int) -> tuple[FloatArray, np.ndarray]:
    """Turn (radius, z) points, first and last on the axis, about z."""
    turn = np.arange(segments) * 2 * np.pi / segments
    ring = profile[1:-1]
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    sides = ring[:, None, :1] * around
    rings = np.concatenate([sides, np.broadcast_to(ring[:, None, 1:], (*sides.shape[:2], 1))], -1)
    bottom, top = [0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]
    vertices = np.concatenate([[bottom], rings.reshape(-1, 3), [top]])
    a = 1 + np.arange(segments)
    b = 1 + (np.arange(segments) + 1) % segments
    zero = np.zeros(segments, int)
    faces = [np.stack([zero, b, a], 1)]
    for k in range(len(ring) - 1):
        low, high = k * segments, (k + 1) * segments
        faces += [np.stack([a + low, b + low, b + high], 1)]
        faces += [np.stack([a + low, b + high, a + high], 1)]
    last = (len(ring) - 1) * segments
    faces.append(np.stack([a + last, b + last, zero + len(vertices) - 1], 1))
    return vertices, np.concatenate(faces).astype(np.int32)


def _subdivided(corners: FloatArray, longest: float) -> FloatArray:
    """Halve the longest edge of triangles (n, 3, 3) until none is longer than `longest`."""
    done = [np.zeros((0, 3, 3))]
    while len(corners):
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        fine = edges.max(axis=1) <= longest
        done.append(corners[fine])
        corners, edges = corners[~fine], edges[~fine]
        # Turn each triangle so that its longest edge runs from corner 0 to corner 1.
        turn = (np.arange(3) + edges.argmax(axis=1)[:, None]) % 3
        corners = np.take_along_axis(corners, turn[:, :, None], axis=1)
        a, b, c = corners.transpose(1, 0, 2)
        middle = 0.5 * (a + b)
        corners = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    return np.concatenate(done)
