"""One compiled scene for all sizes of its object, for questions about distances alone.

Compiling a scene of two Shadow hands takes tens of milliseconds (`python -m benchmarks.real`). A
larger object of the same shape has the same pieces with scaled vertices, and that can be written into
the compiled model. Its mass and inertia stay those of the compiled size: such a scene is not stepped.
"""

from __future__ import annotations

import numpy as np

from bidexdata.simulation.scene import SimScene

COMPILED_SIZE = 0.5
"""Diagonal of the object in the scene that is compiled [m]: always one, so that no scene depends on
which was asked for before."""


class SizedScenes:
    """Scenes of one object at any size, by one model that is changed in place."""

    def __init__(self, scene: SimScene) -> None:
        """Take a scene whose object has the size `COMPILED_SIZE`; it is this object's from now on."""
        self._scene = scene
        model = scene.model
        geoms = np.flatnonzero(self._scene.geom_owner == self._scene.object_owner)
        meshes = model.geom_dataid[geoms]
        vertices = _rows(model.mesh_vertadr[meshes], model.mesh_vertnum[meshes])
        body = self._scene.object_body
        boxes = _rows(
            np.append(model.body_bvhadr[body], model.mesh_bvhadr[meshes]),
            np.append(model.body_bvhnum[body], model.mesh_bvhnum[meshes]),
        )
        self._lengths = [
            (array, rows, array[rows].astype(np.float64))
            for array, rows in (
                (model.geom_pos, geoms),
                (model.geom_size, geoms),
                (model.geom_rbound, geoms),
                (model.geom_aabb, geoms),
                (model.mesh_vert, vertices),
                (model.bvh_aabb, boxes),
            )
        ]

    def at(self, size: float) -> SimScene:
        """The scene with its object at `size` [m]; the scene given before changes with it."""
        for array, rows, lengths in self._lengths:
            array[rows] = lengths * (size / COMPILED_SIZE)
        return self._scene


def _rows(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Numbers of rows in stretches that start at `first` and hold `count` each; none where -1."""
    stretches = [np.arange(a, a + n) for a, n in zip(first, count, strict=True) if a >= 0]
    return np.concatenate(stretches).astype(np.intp)
