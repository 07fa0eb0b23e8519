"""Clouds as one camera sees them: rendered depth of the convex pieces of an object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexgrasp_model.tables import farthest_order

DISTANCE = 1.2
"""Camera to the object's centre [m]. Ours: a table-top camera."""
_ELEVATION = (20.0, 70.0)
"""Range of the camera's height over the horizon [degrees]. Ours."""
_PIXELS = 80
"""Side of a depth image. Ours: some thousand points are seen, and the network takes 1024."""
_LEAST = 1e-12
"""Faces of less than this share of the largest one's area have no direction."""


class Body(NamedTuple):
    """A convex piece."""

    corners: Float[np.ndarray, "V 3"]
    normal: Float[np.ndarray, "F 3"]
    """Of its faces, outward, unit length."""
    offset: Float[np.ndarray, " F"]
    """normal . x <= offset inside [m]."""

    def moved(self, R: Float[np.ndarray, "3 3"], size: float, pos: Float[np.ndarray, 3]) -> Body:
        """Scale it, turn it (or take its mirror image) and shift it."""
        normal = self.normal @ R.T
        return Body(size * self.corners @ R.T + pos, normal, size * self.offset + normal @ pos)


def bodies_of(pieces: Sequence[Any]) -> list[Body]:
    """The convex pieces of an object, as its solid has them: its own frame, unit diagonal."""
    found = []
    for piece in pieces:
        corners = np.asarray(piece.vertices, np.float64)
        a, b, c = (corners[piece.faces[:, k]] for k in range(3))
        across = np.cross(b - a, c - a)
        length = np.linalg.norm(across, axis=1)
        kept = length > _LEAST * length.max()
        normal = across[kept] / length[kept, None]
        found.append(Body(corners, normal, (normal * a[kept]).sum(1)))
    return found


def draw_camera(centre: Float[np.ndarray, 3], rng: np.random.Generator) -> Float[np.ndarray, 3]:
    """A camera position around an object on a table [m]."""
    turn = rng.uniform(0, 2 * np.pi)
    up = np.deg2rad(rng.uniform(*_ELEVATION))
    toward = [np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)]
    return centre + DISTANCE * np.array(toward)


def seen_cloud(
    bodies: Sequence[Body], count: int, rng: np.random.Generator
) -> Float[np.ndarray, "C 3"]:
    """What a camera somewhere around an object sees of it.

    Args:
        bodies: Its pieces, in the world [m].
        count: Points; the first ones again where the camera sees fewer.
        rng: Of the camera.
    """
    every = np.concatenate([body.corners for body in bodies])
    centre = (every.min(0) + every.max(0)) / 2
    radius = float(np.linalg.norm(every - centre, axis=1).max())
    cloud = depth_cloud(bodies, draw_camera(centre, rng), centre, radius, count)
    return np.resize(cloud, (count, 3))


def depth_cloud(
    bodies: Sequence[Body],
    camera: Float[np.ndarray, 3],
    centre: Float[np.ndarray, 3],
    radius: float,
    count: int,
) -> Float[np.ndarray, "n 3"]:
    """Render the depth of convex pieces and give `count` of the points seen, farthest first.

    Args:
        bodies: The pieces.
        camera: Position [m], world.
        centre: Where it looks.
        radius: Of a sphere about the centre that holds the object.
        count: Points wanted; fewer where fewer are seen.
    """
    axes = _camera_axes(camera, centre)
    span = np.linspace(-1, 1, _PIXELS) * radius / np.linalg.norm(camera - centre)
    x, y = np.meshgrid(span, span)
    rays = np.stack([x, y, np.ones_like(x)], -1) @ axes.T
    depth = np.full((_PIXELS, _PIXELS), np.inf)
    for body in bodies:
        part = _window((body.corners - camera) @ axes, span)
        found = _entry(body, camera, rays[part].reshape(-1, 3))
        depth[part] = np.minimum(depth[part], found.reshape(depth[part].shape))
    hit = np.isfinite(depth)
    points = camera + depth[hit][:, None] * rays[hit]
    return points[farthest_order(points, min(count, len(points)))] if len(points) else points


def _window(local: Float[np.ndarray, "V 3"], span: Float[np.ndarray, " W"]) -> tuple[slice, slice]:
    """Rows and columns of the image that can see a body with these corners, in camera axes."""
    if (local[:, 2] < 1e-3).any():
        return slice(None), slice(None)
    at = local[:, :2] / local[:, 2:]
    low = np.searchsorted(span, at.min(0), side="left")
    high = np.searchsorted(span, at.max(0), side="right")
    return slice(low[1], high[1]), slice(low[0], high[0])


def _entry(
    body: Body, camera: np.ndarray, rays: Float[np.ndarray, "R 3"]
) -> Float[np.ndarray, " R"]:
    """Where rays enter a convex body; infinite where they miss it."""
    speed = rays @ body.normal.T
    gap = body.offset - body.normal @ camera
    with np.errstate(divide="ignore", invalid="ignore"):
        at = gap / speed
    enter = np.where(speed < 0, at, -np.inf).max(1)
    leave = np.where(speed > 0, at, np.inf).min(1)
    outside = ((speed == 0) & (gap < 0)).any(1)
    return np.where((enter <= leave) & (enter > 0) & ~outside, enter, np.inf)


def _camera_axes(camera: np.ndarray, centre: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """Columns: right, down, forward."""
    forward = (centre - camera) / np.linalg.norm(centre - camera)
    up = np.array([0.0, 0, 1]) if abs(forward[2]) < 0.99 else np.array([1.0, 0, 0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=1)
