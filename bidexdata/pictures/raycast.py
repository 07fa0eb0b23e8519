"""Ray casting of coloured triangles with Warp meshes: pictures without a GL library.

The same kernels run on a CPU and on CUDA. The picture depends on the scene, the camera and the
size alone; drawing twice on one device gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.devices import start_warp
from bidexdata.pictures.camera import Camera
from bidexdata.pictures.scene import Part

KEY_LIGHT = (-0.45, 0.75, 0.55)
"""Direction to the main lamp in the camera's frame (right, up, backward)."""
SKY_RAYS = 4
"""Rays per sample that ask how much sky a point sees."""
SKY_REACH = 0.15
"""How far things hide the sky, as a fraction of the scene's diagonal [-]."""


class Hits(NamedTuple):
    """What the ray through the middle of each pixel meets first."""

    distance: NDArray[np.float32]
    """From the camera along the ray [m]; infinite where nothing is met, (h, w)."""
    part: NDArray[np.int32]
    """Number of the part, -1 where nothing is met, (h, w)."""


class RayScene:
    """Parts as one Warp mesh, ready to be looked at from any camera.

    Args:
        parts: What is seen; may be empty.
        device: A Warp device, `cpu` or `cuda:0`.
    """

    def __init__(self, parts: Sequence[Part], device: str = "cpu"):
        import warp as wp

        start_warp()
        # Warp cannot build a mesh of nothing: one far triangle without area stands in.
        nothing = Part(np.full((3, 3), 1e9), np.zeros((1, 3, 3)), _ONE_FACE, (0, 0, 0), "")
        used = [p for p in parts if len(p.faces)] or [nothing]
        offsets = np.cumsum([0, *(len(p.vertices) for p in used)])
        vertices = np.concatenate([p.vertices for p in used]).astype(np.float32)
        faces = np.concatenate([p.faces + o for p, o in zip(used, offsets, strict=False)])
        normals = np.concatenate([p.corner_normals for p in used]).astype(np.float32)
        count = [len(p.faces) for p in used]
        colour = np.repeat(np.array([p.colour for p in used], np.float32), count, axis=0)
        numbers = [i for i, p in enumerate(parts) if len(p.faces)] or [0]
        self._parts, self._device = len(parts), device
        self._part_of_face = np.repeat(numbers, count)
        self._extent = float(np.linalg.norm(np.ptp(vertices, axis=0))) or 1.0
        self._colour = wp.array(colour, dtype=wp.vec3, device=device)
        self._normal = wp.array(normals, dtype=wp.vec3, device=device)
        self._mesh = wp.Mesh(
            points=wp.array(vertices, dtype=wp.vec3, device=device),
            indices=wp.array(faces.astype(np.int32).ravel(), dtype=int, device=device),
        )

    def draw(
        self, camera: Camera, width: int, height: int, *, samples: int = 2
    ) -> NDArray[np.uint8]:
        """Draw a picture.

        Args:
            camera: Where from.
            width: Pixels.
            height: Pixels.
            samples: Rays per pixel along each axis, averaged.

        Returns:
            sRGB pixels, row 0 at the top, (h, w, 3).
        """
        import warp as wp

        from bidexdata.pictures.raycast_kernels import shade

        rows, columns, device = height * samples, width * samples, self._device
        light = wp.empty((rows, columns), dtype=_typed(wp.vec3), device=device)
        key = camera.R_world_camera @ (np.array(KEY_LIGHT) / np.linalg.norm(KEY_LIGHT))
        sky = wp.array(_sky_directions(SKY_RAYS), dtype=wp.vec3, device=device)
        wp.launch(
            shade,
            dim=(rows, columns),
            inputs=[
                *(self._mesh.id, self._colour, self._normal),
                *_camera_arguments(camera),
                *(wp.vec3(*key), 1e-4 * self._extent, SKY_REACH * self._extent, sky),
                *self._cast(camera, rows, columns),
            ],
            outputs=[light],
            device=device,
        )
        linear = light.numpy().reshape(height, samples, width, samples, 3).mean(axis=(1, 3))
        return np.round(255 * np.clip(linear, 0, 1) ** (1 / 2.2)).astype(np.uint8)

    def hits(self, camera: Camera, width: int, height: int) -> Hits:
        """Find what each pixel sees, without shading."""
        distance, face, _ = self._cast(camera, height, width)
        face = face.numpy()
        part = np.where(face >= 0, self._part_of_face[face], -1).astype(np.int32)
        return Hits(distance.numpy(), part)

    def visible(self, camera: Camera, width: int, height: int) -> NDArray[np.int32]:
        """Number of pixels that show each part, (parts,)."""
        part = self.hits(camera, width, height).part
        return np.bincount(part[part >= 0], minlength=self._parts).astype(np.int32)

    def _cast(self, camera: Camera, rows: int, columns: int) -> tuple[Any, Any, Any]:
        import warp as wp

        from bidexdata.pictures.raycast_kernels import cast_rays

        shape, device = (rows, columns), self._device
        distance = wp.empty(shape, dtype=float, device=device)
        face = wp.empty(shape, dtype=int, device=device)
        bary = wp.empty(shape, dtype=_typed(wp.vec2), device=device)
        wp.launch(
            cast_rays,
            dim=shape,
            inputs=[self._mesh.id, *_camera_arguments(camera)],
            outputs=[distance, face, bary],
            device=device,
        )
        return distance, face, bary


_ONE_FACE = np.array([[0, 1, 2]], np.int32)


def _typed(kind: Any) -> Any:
    # Warp's stubs take vector types for values.
    return kind


def _camera_arguments(camera: Camera) -> tuple[Any, Any, float]:
    import warp as wp

    return (
        wp.vec3(*camera.position),
        wp.mat33(*camera.R_world_camera.ravel()),
        camera.tan_half_height,
    )


def _sky_directions(n: int) -> NDArray[np.float32]:
    # A golden-angle spiral about the normal, denser towards it as the light that arrives there.
    k = np.arange(n)
    r = np.sqrt((k + 0.5) / n)
    angle = k * np.pi * (3 - 5**0.5)
    return np.stack([r * np.cos(angle), r * np.sin(angle), np.sqrt(1 - r * r)], 1).astype(
        np.float32
    )
