"""Clouds as one camera sees them: rendered depth of the convex pieces, or what of a cloud shows."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from bidexgrasp_model.tables import farthest_order

DISTANCE = 1.2
"""Camera to the object's centre [m]. Ours: a table-top camera."""
_ELEVATION = (20.0, 70.0)
"""Range of the camera's height over the horizon [degrees]. Ours."""
_PIXELS = 120
"""Side of a depth image. Ours: about 4 mm per pixel on an object of 0.5 m."""


def draw_camera(centre: Float[np.ndarray, 3], rng: np.random.Generator) -> Float[np.ndarray, 3]:
    """A camera position around an object on a table [m]."""
    turn = rng.uniform(0, 2 * np.pi)
    up = np.deg2rad(rng.uniform(*_ELEVATION))
    toward = [np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)]
    return centre + DISTANCE * np.array(toward)


def seen_points(
    cloud: Float[Tensor, "P 3"],
    normals: Float[Tensor, "P 3"],
    generator: torch.Generator | None = None,
) -> Float[Tensor, "P 3"]:
    """What of a cloud one camera sees, repeated to as many points, in farthest-point order.

    Points that face the camera and have none in front of them in a grid of rays: cheap enough for
    training. For a camera that stands anywhere use `depth_cloud`.

    Args:
        cloud: [m], world.
        normals: Outward.
        generator: Of the camera.
    """
    seed = int(torch.randint(0, 2**31, (1,), generator=generator))
    points = cloud.double().numpy()
    centre = points.mean(0)
    camera = draw_camera(centre, np.random.default_rng(seed))
    facing = ((camera - points) * normals.double().numpy()).sum(1) > 0
    shown = np.flatnonzero(facing & ~_hidden(points, camera, centre))
    if len(shown) < 4:
        return cloud
    chosen = points[shown]
    order = farthest_order(chosen, min(len(chosen), len(points)))
    repeated = np.resize(chosen[order], points.shape)
    return torch.from_numpy(repeated).to(cloud)


def _hidden(points: np.ndarray, camera: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Whether another point lies clearly in front of a point, in cells of a grid of rays."""
    axes = _camera_axes(camera, centre)
    local = (points - camera) @ axes
    depth = local[:, 2]
    extent = np.ptp(points, axis=0).max()
    cell = np.round(local[:, :2] / depth[:, None] * DISTANCE / (extent / 14)).astype(int)
    _, number = np.unique(cell, axis=0, return_inverse=True)
    number = number.reshape(-1)
    front = np.full(number.max() + 1, np.inf)
    np.minimum.at(front, number, depth)
    return depth > front[number] + extent / 8


def depth_cloud(
    pieces: list[tuple[np.ndarray, np.ndarray]],
    camera: Float[np.ndarray, 3],
    centre: Float[np.ndarray, 3],
    radius: float,
    count: int,
) -> Float[np.ndarray, "n 3"]:
    """Render the depth of convex pieces and give `count` of the points seen, farthest first.

    Args:
        pieces: Outward unit normals (F, 3) and offsets (F) of each piece's faces: n x <= d inside [m].
        camera: Position [m], world.
        centre: Where it looks.
        radius: Of a sphere about the centre that holds the object.
        count: Points wanted; fewer where fewer are seen.
    """
    axes = _camera_axes(camera, centre)
    span = np.linspace(-1, 1, _PIXELS) * radius / np.linalg.norm(camera - centre)
    x, y = np.meshgrid(span, span)
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ axes.T
    depth = np.full(len(rays), np.inf)
    for normal, offset in pieces:
        depth = np.minimum(depth, _entry(normal, offset, camera, rays))
    hit = np.isfinite(depth)
    points = camera + depth[hit, None] * rays[hit]
    return points[farthest_order(points, min(count, len(points)))] if len(points) else points


def _entry(
    normal: np.ndarray, offset: np.ndarray, camera: np.ndarray, rays: np.ndarray
) -> Float[np.ndarray, " R"]:
    """Where rays enter a convex body; infinite where they miss it."""
    speed = rays @ normal.T
    gap = offset - normal @ camera
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
