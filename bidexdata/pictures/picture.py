"""Whole pictures: one grasp, the same grasp at several stages, one object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bidexdata.hands.model import Hand
from bidexdata.objects.prepared import Solid
from bidexdata.pictures.camera import framed
from bidexdata.pictures.drawing import Surface, grasp_parts, solid_parts
from bidexdata.pictures.raycast import RayScene
from bidexdata.pictures.views import DEFAULT_DIRECTION, choose_views, subject_points
from bidexdata.record import GraspBatch

Pixels = NDArray[np.uint8]
_GAP = 4  # white pixels between two views


def drawn_by(device: str = "cpu") -> str:
    """Say what drew a picture."""
    from importlib.metadata import version

    return f"drawn by Warp {version('warp-lang')} ray casting on {device}"


def draw_grasp(
    batch: GraspBatch,
    row: int,
    solid: Solid,
    hands: Sequence[Hand],
    *,
    stage: str | int | float = "grasp",
    views: int = 1,
    width: int = 360,
    height: int = 270,
    surface: Surface = "mesh",
    contacts: bool = True,
    device: str = "cpu",
) -> Pixels:
    """Draw one grasp from where both hands are seen best.

    Args:
        batch: Rows with identity and pose columns; contact columns are shown where present.
        row: Which row.
        solid: Its object, at unit diagonal.
        hands: In the order of the batch's H axis.
        stage: Name of a stage, or a moment between 0 and 2.
        views: Pictures side by side, from directions at least 60 degrees apart.
        width: Pixels of one view.
        height: Pixels.
        surface: The object's display mesh, or its convex pieces, each in its own colour.
        contacts: Mark contact points and outward normals.
        device: A Warp device.

    Returns:
        sRGB pixels, (height, views * (width + 4) - 4, 3).
    """
    parts = grasp_parts(batch, row, solid, hands, stage=stage, surface=surface, contacts=contacts)
    scene, points = RayScene(parts, device), subject_points(parts)
    return side_by_side(
        [
            scene.draw(framed(points, direction, width / height), width, height)
            for direction in choose_views(parts, scene, views)
        ]
    )


def draw_stages(
    batch: GraspBatch,
    row: int,
    solid: Solid,
    hands: Sequence[Hand],
    stages: Sequence[str | int | float],
    *,
    width: int = 360,
    height: int = 270,
    surface: Surface = "mesh",
    device: str = "cpu",
) -> list[Pixels]:
    """Draw one grasp at several moments with the camera standing still."""
    shown = [grasp_parts(batch, row, solid, hands, stage=s, surface=surface) for s in stages]
    middle = shown[len(shown) // 2]
    scene = RayScene(middle, device)
    direction = choose_views(middle, scene)[0]
    everything = np.concatenate([subject_points(parts) for parts in shown])
    camera = framed(everything, direction, width / height)
    drawn = []
    for parts in shown:
        scene.move(parts)
        drawn.append(scene.draw(camera, width, height))
    return drawn


def draw_object(
    solid: Solid,
    *,
    width: int = 360,
    height: int = 270,
    surfaces: Sequence[Surface] = ("mesh", "pieces"),
    device: str = "cpu",
) -> Pixels:
    """Draw an object from the right front, above: its repaired mesh beside its convex pieces.

    Both pictures have the same camera, so that what the pieces cut off or fill shows.
    """
    shown = [solid_parts(solid, 1.0, surface=s) for s in surfaces]
    points = np.concatenate([subject_points(parts) for parts in shown])
    camera = framed(points, DEFAULT_DIRECTION, width / height)
    return side_by_side([RayScene(parts, device).draw(camera, width, height) for parts in shown])


def side_by_side(drawn: Sequence[Pixels]) -> Pixels:
    """Join pictures of one height, left to right, with a white line between them."""
    strip = np.full((drawn[0].shape[0], _GAP, 3), 255, np.uint8)
    joined = [drawn[0]]
    for pixels in drawn[1:]:
        joined += [strip, pixels]
    return np.concatenate(joined, axis=1)
