"""Scenes to make grasps for: objects at a size and a place, of a release or of a library."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from bidexdata import Library, Release
from bidexgrasp_model.rotations import matrix_from_quat
from bidexgrasp_model.single_view import bodies_of, seen_cloud
from bidexgrasp_model.tables import farthest_order


@dataclass(frozen=True, slots=True)
class Place:
    """An object at a size, resting or floating."""

    scene_id: str
    object_id: str
    size: float
    """Diagonal of the solid's box [m]."""
    pos: tuple[float, float, float]
    """Origin of the object frame in the world [m]."""
    quat_wxyz: tuple[float, float, float, float]
    on_table: bool
    """Whether it rests on the plane z = 0; else it floats."""

    @property
    def turn(self) -> Float[np.ndarray, "3 3"]:
        """Orientation of the object in the world."""
        return matrix_from_quat(torch.tensor(self.quat_wxyz, dtype=torch.float64)).numpy()

    def in_world(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
        """Move points of unit diagonal [m]."""
        return (np.asarray(points, np.float64) * self.size) @ self.turn.T + np.asarray(self.pos)


def places_of_split(release: Release, split: str) -> list[Place]:
    """The scenes of a split whose objects have a known pose, in the release's order."""
    found = []
    for row in release.scenes.to_pylist():
        if row["split"] == split and np.isfinite(row["object_pos"]).all():
            found.append(
                Place(
                    row["scene_id"],
                    row["object_id"],
                    row["size_mm"] / 1000,
                    tuple(row["object_pos"]),
                    tuple(row["object_quat_wxyz"]),
                    row["setting"] == "tabletop",
                )
            )
    return found


def places_of_object(
    library: Library, object_id: str, sizes_mm: Sequence[int], setting: str, rest_poses: int
) -> list[Place]:
    """The scenes of one prepared object: on a table in its most probable rest poses.

    Raises:
        ValueError: It has no pose in which it rests.
    """
    solid = library.load_solid(object_id)
    if setting == "floating":
        still = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        return [
            Place(f"{object_id}/{mm}/float", object_id, mm / 1000, *still, on_table=False)
            for mm in sizes_mm
        ]
    if not len(solid.rest_heights):
        raise ValueError(f"{object_id} has no pose in which it rests on a table")
    found = []
    for mm in sizes_mm:
        for k in range(min(rest_poses, len(solid.rest_heights))):
            pos = (0.0, 0.0, float(solid.rest_heights[k]) * mm / 1000)
            w, x, y, z = (float(q) for q in solid.rest_quats_wxyz[k])
            found.append(
                Place(
                    f"{object_id}/{mm}/table{k}",
                    object_id,
                    mm / 1000,
                    pos,
                    (w, x, y, z),
                    on_table=True,
                )
            )
    return found


def release_clouds(
    release: Release, places: Sequence[Place], points: int
) -> Float[Tensor, "B P 3"]:
    """Clouds of scenes, in the world [m]."""
    number = {object_id: k for k, object_id in enumerate(release.object_ids)}
    stored = release.cloud("cloud_solid")
    moved = [p.in_world(stored[number[p.object_id], :points]) for p in places]
    return torch.from_numpy(np.stack(moved)).float()


def library_clouds(
    library: Library, places: Sequence[Place], points: int
) -> Float[Tensor, "B P 3"]:
    """The same of a library's objects."""
    surfaces = {p.object_id: library.load(p.object_id).surface_points for p in places}
    moved = []
    for place in places:
        cloud = np.asarray(surfaces[place.object_id], np.float64)
        if len(cloud) < points:
            cloud = np.resize(cloud, (points, 3))
        moved.append(place.in_world(cloud[:points]))
    return torch.from_numpy(np.stack(moved)).float()


def depth_clouds(
    source: Release | Library, places: Iterable[Place], points: int, rng: np.random.Generator
) -> Float[Tensor, "B P 3"]:
    """What one camera sees of each scene: rendered depth of the convex pieces [m]."""
    found = []
    for place in places:
        bodies = bodies_of(source.load_solid(place.object_id).pieces)
        moved = [b.moved(place.turn, place.size, np.asarray(place.pos)) for b in bodies]
        found.append(seen_cloud(moved, points, rng))
    return torch.from_numpy(np.stack(found)).float()


def cloud_of_points(points: Float[np.ndarray, "P 3"], count: int) -> Float[Tensor, "1 C 3"]:
    """A measured cloud in farthest-point order, repeated where it has fewer points."""
    order = farthest_order(np.asarray(points, np.float64), min(count, len(points)))
    return torch.from_numpy(np.resize(points[order], (1, count, 3))).float()
