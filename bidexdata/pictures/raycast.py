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
from bidexdata.pictures.scene import GROUND, Part

FloatArray = NDArray[np.float64]

KEY_LIGHT = (-0.45, 0.75, 0.55)
"""Direction to the main lamp in the camera's frame (right, up, backward)."""
SKY_DIRECTIONS = 16
"""Directions all round in which a point may see the sky; about half of them are above a surface."""
SKY_REACH = 0.15
"""How far things hide the sky, as a fraction of the diagonal of all but the ground [-]."""
SHADOW_OFFSET = 1e-4
"""Light starts so far from a surface, as a fraction of the scene's diagonal [-]."""
SKY_STEP = 3
"""Pixels between the places that look at the sky; those between them on a surface interpolate."""
EDGE = 10
"""Neighbouring pixels that differ more in one colour [of 255] are drawn again with more rays."""


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
        used, numbers = _drawable(parts)
        offsets = np.cumsum([0, *(len(p.vertices) for p in used)])
        faces = np.concatenate([p.faces + o for p, o in zip(used, offsets, strict=False)])
        count = [len(p.faces) for p in used]
        colour = np.repeat(np.array([p.colour for p in used], np.float32), count, axis=0)
        self._parts, self._device = len(parts), device
        self._part_of_face = np.repeat(numbers, count)
        self._offset = SHADOW_OFFSET * _diagonal(used)
        self._reach = SKY_REACH * _diagonal([p for p in used if p.label != GROUND] or used)
        self._colour = wp.array(colour, dtype=wp.vec3, device=device)
        self._directions = wp.array(_sphere(SKY_DIRECTIONS), dtype=wp.vec3, device=device)
        self._normal = wp.array(_normals(used), dtype=wp.vec3, device=device)
        self._mesh = wp.Mesh(
            points=wp.array(_vertices(used), dtype=wp.vec3, device=device),
            indices=wp.array(faces.astype(np.int32).ravel(), dtype=int, device=device),
        )

    def move(self, parts: Sequence[Part]) -> None:
        """Put the same parts elsewhere: the same faces and colours, other vertices and normals.

        This takes a tenth of the time of a new scene.

        Raises:
            ValueError: They are other parts.
        """
        used, numbers = _drawable(parts)
        vertices, normals = _vertices(used), _normals(used)
        part_of_face = np.repeat(numbers, [len(p.faces) for p in used])
        known = (self._parts, self._mesh.points.size, self._part_of_face.tobytes())
        if known != (len(parts), len(vertices), part_of_face.tobytes()):
            raise ValueError("a scene can be moved to parts with the same faces only")
        self._normal.assign(normals)
        self._mesh.points.assign(vertices)
        self._mesh.refit()

    def draw(
        self, camera: Camera, width: int, height: int, *, samples: int = 2
    ) -> NDArray[np.uint8]:
        """Draw a picture.

        Every pixel has one ray first; those at an edge, of a thing or of a shadow, are drawn again
        with `samples` x `samples`, as more rays change little elsewhere.

        Args:
            camera: Where from.
            width: Pixels.
            height: Pixels.
            samples: Rays per pixel along each axis where there are edges, averaged.

        Returns:
            sRGB pixels, row 0 at the top, (h, w, 3).
        """
        aspect, middles = width / height, _places(width, height)
        sky = self._sky(camera, aspect, -(-width // SKY_STEP), -(-height // SKY_STEP))
        picture = _srgb(self._light(camera, aspect, middles, sky))
        if samples > 1:
            edges = np.flatnonzero(_at_edges(picture.reshape(height, width, 3)))
            within = _places(samples, samples) / (width, height)
            places = (middles[edges][:, None] + within).reshape(-1, 2)
            light = self._light(camera, aspect, places, sky)
            picture[edges] = _srgb(light.reshape(len(edges), samples**2, 3).mean(axis=1))
        return picture.reshape(height, width, 3)

    def hits(self, camera: Camera, width: int, height: int) -> Hits:
        """Find what each pixel sees, without shading."""
        distance, face, _ = self._cast(
            camera, width / height, self._to_device(_places(width, height))
        )
        face = face.numpy().reshape(height, width)
        part = np.where(face >= 0, self._part_of_face[face], -1).astype(np.int32)
        return Hits(distance.numpy().reshape(height, width), part)

    def visible(self, camera: Camera, width: int, height: int) -> NDArray[np.int32]:
        """Number of pixels that show each part, (parts,)."""
        part = self.hits(camera, width, height).part
        return np.bincount(part[part >= 0], minlength=self._parts).astype(np.int32)

    def _sky(self, camera: Camera, aspect: float, width: int, height: int) -> tuple[Any, ...]:
        """What a grid of places sees of the sky, which changes slowly along a surface."""
        import warp as wp

        from bidexdata.pictures.raycast_kernels import open_sky_at

        n, device = width * height, self._device
        at = self._to_device(_places(width, height))
        point, normal = (wp.empty(n, dtype=_typed(wp.vec3), device=device) for _ in range(2))
        sky = wp.empty(n, dtype=float, device=device)
        wp.launch(
            open_sky_at,
            dim=n,
            inputs=[
                *(self._mesh.id, self._normal, *_camera_arguments(camera, aspect)),
                *(self._offset, self._reach, self._directions),
                *(at, *self._cast(camera, aspect, at)),
            ],
            outputs=[point, normal, sky],
            device=device,
        )
        return wp.vec2i(width, height), point, normal, sky

    def _light(
        self, camera: Camera, aspect: float, places: FloatArray, sky: tuple[Any, ...]
    ) -> NDArray[np.float32]:
        """Linear light through places of the picture, (n, 3)."""
        import warp as wp

        from bidexdata.pictures.raycast_kernels import shade

        at = self._to_device(places)
        light = wp.empty(len(places), dtype=_typed(wp.vec3), device=self._device)
        key = camera.R_world_camera @ (np.array(KEY_LIGHT) / np.linalg.norm(KEY_LIGHT))
        wp.launch(
            shade,
            dim=len(places),
            inputs=[
                *(self._mesh.id, self._colour, self._normal, *_camera_arguments(camera, aspect)),
                *(wp.vec3(*key), self._offset, self._reach, self._directions, *sky),
                *(at, *self._cast(camera, aspect, at)),
            ],
            outputs=[light],
            device=self._device,
        )
        return np.asarray(light.numpy(), np.float32)

    def _cast(self, camera: Camera, aspect: float, places: Any) -> tuple[Any, Any, Any]:
        import warp as wp

        from bidexdata.pictures.raycast_kernels import cast_rays

        n, device = len(places), self._device
        distance = wp.empty(n, dtype=float, device=device)
        face = wp.empty(n, dtype=int, device=device)
        bary = wp.empty(n, dtype=_typed(wp.vec2), device=device)
        wp.launch(
            cast_rays,
            dim=n,
            inputs=[self._mesh.id, *_camera_arguments(camera, aspect), places],
            outputs=[distance, face, bary],
            device=device,
        )
        return distance, face, bary

    def _to_device(self, places: FloatArray) -> Any:
        import warp as wp

        return wp.array(places.astype(np.float32), dtype=wp.vec2, device=self._device)


_ONE_FACE = np.array([[0, 1, 2]], np.int32)


def _typed(kind: Any) -> Any:
    # Warp's stubs take vector types for values.
    return kind


def _camera_arguments(camera: Camera, aspect: float) -> tuple[Any, Any, Any]:
    import warp as wp

    return (
        wp.vec3(*camera.position),
        wp.mat33(*camera.R_world_camera.ravel()),
        wp.vec2(aspect * camera.tan_half_height, camera.tan_half_height),
    )


def _drawable(parts: Sequence[Part]) -> tuple[list[Part], list[int]]:
    """Parts with faces and their numbers."""
    found = [(p, i) for i, p in enumerate(parts) if len(p.faces)]
    # Warp cannot build a mesh of nothing: one far triangle without area stands in.
    nothing = Part(np.full((3, 3), 1e9), np.zeros((1, 3, 3)), _ONE_FACE, (0, 0, 0), "")
    used, numbers = zip(*(found or [(nothing, 0)]), strict=True)
    return list(used), list(numbers)


def _vertices(parts: Sequence[Part]) -> NDArray[np.float32]:
    return np.concatenate([p.vertices for p in parts]).astype(np.float32)


def _normals(parts: Sequence[Part]) -> NDArray[np.float32]:
    return np.concatenate([p.corner_normals for p in parts]).astype(np.float32)


def _diagonal(parts: Sequence[Part]) -> float:
    low = np.min([p.vertices.min(axis=0) for p in parts], axis=0)
    high = np.max([p.vertices.max(axis=0) for p in parts], axis=0)
    return float(np.linalg.norm(high - low)) or 1.0


def _places(width: int, height: int) -> FloatArray:
    """Middles of all pixels, row 0 at the top: x and y from -1 to 1, y up, (h * w, 2)."""
    x = (2 * np.arange(width) + 1) / width - 1
    y = 1 - (2 * np.arange(height) + 1) / height
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _srgb(light: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.round(255 * np.clip(light, 0, 1) ** (1 / 2.2)).astype(np.uint8)


def _at_edges(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels that differ from one of their four neighbours, (h, w)."""
    edge = np.zeros(picture.shape[:2], bool)
    signed = picture.astype(np.int16)
    for axis in (0, 1):
        differs = np.abs(np.diff(signed, axis=axis)).max(axis=2) > EDGE
        first, second = (
            (slice(None),) * axis + (slice(-1),),
            (slice(None),) * axis + (slice(1, None),),
        )
        edge[first] |= differs
        edge[second] |= differs
    return edge


def _sphere(n: int) -> NDArray[np.float32]:
    """Unit directions spread evenly all round, on a golden-angle spiral, (n, 3)."""
    k = np.arange(n)
    z = 1 - (2 * k + 1) / n
    r, angle = np.sqrt(1 - z * z), k * np.pi * (3 - 5**0.5)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1).astype(np.float32)
