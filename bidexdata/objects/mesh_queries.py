"""Distances and rays against triangle meshes, by Warp on the CPU.

Preparing is bound by searches that run on the host, one object per process, so these launch on
the CPU wherever they run; results are the same bytes on every machine of one architecture.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.devices import start_warp

from .prepared import TriangleMesh

_DEVICE = "cpu"
_FARTHEST = 1e3
"""Surfaces are looked for this far away; meshes have unit diagonal."""


def distances(
    mesh: TriangleMesh, points: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Find the closest surface points (P, 3) and the unsigned distances (P,) of points (P, 3)."""
    import warp as wp

    from . import mesh_queries_kernels as kernels

    points = np.ascontiguousarray(points, np.float32)
    closest = np.zeros_like(points)
    distance = np.zeros(len(points), np.float32)
    if len(points):
        device_mesh = _device_mesh(mesh)
        wp.launch(
            kernels.closest_points,
            dim=len(points),
            inputs=[device_mesh.id, _shared(points, wp.vec3), _FARTHEST],
            outputs=[_shared(closest, wp.vec3), _shared(distance, wp.float32)],
            device=_DEVICE,
        )
    return closest, distance


def winding_distances(
    mesh: TriangleMesh, points: NDArray[np.floating], *, threshold: float = 0.5
) -> NDArray[np.float32]:
    """Signed distances (P,) of points (P, 3); the sign comes from the winding number.

    Negative where the mesh winds around the point more often than `threshold`, so open and
    self-overlapping meshes have an inside too.
    """
    import warp as wp

    from . import mesh_queries_kernels as kernels

    points = np.ascontiguousarray(points, np.float32)
    distance = np.zeros(len(points), np.float32)
    if len(points):
        device_mesh = _device_mesh(mesh, support_winding_number=True)
        wp.launch(
            kernels.winding_distance,
            dim=len(points),
            inputs=[device_mesh.id, _shared(points, wp.vec3), _FARTHEST, float(threshold)],
            outputs=[_shared(distance, wp.float32)],
            device=_DEVICE,
        )
    return distance


def faces_wall(
    mesh: TriangleMesh,
    points: NDArray[np.floating],
    directions: NDArray[np.floating],
    max_distance: float,
) -> NDArray[np.bool_]:
    """Tell which rays (P, 3) from points (P, 3) hit the mesh before `max_distance`."""
    import warp as wp

    from . import mesh_queries_kernels as kernels

    hit = np.zeros(len(points), np.uint8)
    if len(points):
        device_mesh = _device_mesh(mesh)
        wp.launch(
            kernels.ray_hits,
            dim=len(points),
            inputs=[
                device_mesh.id,
                _shared(np.ascontiguousarray(points, np.float32), wp.vec3),
                _shared(np.ascontiguousarray(directions, np.float32), wp.vec3),
                float(max_distance),
            ],
            outputs=[_shared(hit, wp.uint8)],
            device=_DEVICE,
        )
    return hit.astype(bool)


def nodes_inside(
    planes: Sequence[NDArray[np.float64]],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    origin: NDArray[np.float64],
    cell: float,
    shape: tuple[int, int, int],
) -> NDArray[np.bool_]:
    """Tell which nodes of a grid lie in at least one convex piece.

    Args:
        planes: Per piece the outward planes (n, d) with n . x <= d inside, (F_k, 4).
        lower: Lower corners of the pieces' boxes, (K, 3).
        upper: Upper corners, (K, 3).
        origin: Position of node (0, 0, 0), (3,).
        cell: Spacing.
        shape: Nodes per axis.
    """
    import warp as wp

    from . import mesh_queries_kernels as kernels

    start_warp()
    first = np.concatenate([[0], np.cumsum([len(p) for p in planes])]).astype(np.int32)
    inside = np.zeros(shape, np.uint8)
    wp.launch(
        kernels.inside_pieces,
        dim=shape,
        inputs=[
            _shared(np.concatenate(planes).astype(np.float32), wp.vec4),
            _shared(first, wp.int32),
            _shared(lower.astype(np.float32), wp.vec3),
            _shared(upper.astype(np.float32), wp.vec3),
            len(planes),
            wp.vec3(*map(float, origin)),
            float(cell),
        ],
        outputs=[_shared(inside, wp.uint8)],
        device=_DEVICE,
    )
    return inside.astype(bool)


def donated_distances(
    closest: NDArray[np.float32],
    donor: NDArray[np.int32],
    exact: NDArray[np.bool_],
    origin: NDArray[np.float64],
    cell: float,
    *,
    strides: Sequence[int],
) -> NDArray[np.float32]:
    """Distance of every grid node to the best surface point that it or its neighbours know.

    Args:
        closest: Surface points that can be handed on, (D, 3).
        donor: Which of them each node knows at the start, (nx, ny, nz).
        exact: Nodes whose own point is the closest one; they do not look further.
        origin: Position of node (0, 0, 0), (3,).
        cell: Spacing.
        strides: One pass over the grid per entry: how far the 26 neighbours are, in cells.
    """
    import warp as wp

    from . import mesh_queries_kernels as kernels

    start_warp()
    distance = np.zeros(donor.shape, np.float32)
    points = _shared(np.ascontiguousarray(closest, np.float32), wp.vec3)
    mask = _shared(exact.astype(np.uint8), wp.uint8)
    current = np.ascontiguousarray(donor, np.int32)
    for stride in strides:
        better = np.empty_like(current)
        wp.launch(
            kernels.adopt_nearer_donor,
            dim=donor.shape,
            inputs=[
                points,
                mask,
                wp.vec3(*map(float, origin)),
                float(cell),
                int(stride),
                _shared(current, wp.int32),
            ],
            outputs=[_shared(better, wp.int32), _shared(distance, wp.float32)],
            device=_DEVICE,
        )
        current = better
    return distance


def _device_mesh(mesh: TriangleMesh, *, support_winding_number: bool = False) -> Any:
    import warp as wp

    start_warp()
    # The arrays are copied: a Warp mesh must own memory that outlives the query.
    return wp.Mesh(
        wp.array(np.ascontiguousarray(mesh.vertices, np.float32), dtype=wp.vec3, device=_DEVICE),
        wp.array(
            np.ascontiguousarray(mesh.faces, np.int32).reshape(-1), dtype=wp.int32, device=_DEVICE
        ),
        support_winding_number=support_winding_number,
    )


def _shared(array: NDArray[Any], dtype: Any) -> Any:
    """View numpy memory as a Warp array; on the CPU the kernel writes straight into it."""
    import warp as wp

    return (
        wp.from_numpy(array, dtype=dtype, device=_DEVICE)
        if array.size == 0
        else wp.array(array, dtype=dtype, device=_DEVICE, copy=False)
    )
