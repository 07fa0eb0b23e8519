"""How far arms stand from table, object, themselves and each other, by spheres: the search's view.

MuJoCo has the final word on a path. Here wrist and forearm count to the arm, hands do not. Links
before the second joint stand in one place and count only against the arm itself.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.arms.arm_spheres import place_spheres
from bidexdata.arms.inverse_kinematics import chain_on_device
from bidexdata.arms.robot import Arm
from bidexdata.devices import start_warp
from bidexdata.objects.distance_field import device_field, signed_distance
from bidexdata.objects.prepared import SignedDistanceGrid

FAR = 1e3
"""Clearance from what is not there [m]."""


class Placed(NamedTuple):
    """The object of each row of configurations, in the world."""

    field: SignedDistanceGrid
    """Of all rows' object, at unit diagonal."""
    size: Float[np.ndarray, " N"]
    """Bounding-box diagonals [m]."""
    pos: Float[np.ndarray, "N 3"]
    """[m]."""
    rot: Float[np.ndarray, "N 3 3"]


class Clearances(NamedTuple):
    """Least distances of one arm [m]; negative where spheres overlap."""

    table: Float[np.ndarray, "*n"]
    obj: Float[np.ndarray, "*n"]
    """`FAR` without an object."""
    itself: Float[np.ndarray, "*n"]
    """Links against each other and against the rig's fixtures."""


def clearances(
    arm: Arm, q: Float[np.ndarray, "N *c A"], placed: Placed | None, *, device: str = "cpu"
) -> Clearances:
    """Clearance of one arm alone.

    Args:
        arm: The arm.
        q: Configurations, one row per object pose [rad].
        placed: The objects; none for arm, table and fixtures alone.
        device: A Warp device.
    """
    import warp as wp

    from bidexdata.arms.clearance_kernels import clear_alone

    start_warp()
    shape = q.shape[:-1]
    count = int(np.prod(shape))
    if count == 0:
        return Clearances(np.zeros(shape), np.zeros(shape), np.zeros(shape))
    centre = _centres(arm, q, device)
    out = [wp.empty(count, dtype=float, device=device) for _ in range(3)]
    wp.launch(
        clear_alone,
        dim=count,
        inputs=[
            _spheres_on_device(arm, device),
            *_object_on_device(placed, len(q), device),
            count // len(q),
            centre,
            *out,
        ],
        device=device,
    )
    return Clearances(*(x.numpy().astype(np.float64).reshape(shape) for x in out))


def clearance_between(
    arms: tuple[Arm, Arm],
    left: Float[np.ndarray, "L A"],
    right: Float[np.ndarray, "R B"],
    pairs: Int[np.ndarray, "M 2"],
    *,
    device: str = "cpu",
) -> Float[np.ndarray, " M"]:
    """Clearance between two arms.

    Args:
        arms: Left and right.
        left: Configurations of the left arm [rad].
        right: Of the right arm [rad].
        pairs: Which are taken together, row numbers of both.
        device: A Warp device.
    """
    import warp as wp

    from bidexdata.arms.clearance_kernels import clear_of_each_other

    if not len(pairs):
        return np.zeros(0)
    start_warp()
    out = wp.empty(len(pairs), dtype=float, device=device)
    chosen = wp.array(np.ascontiguousarray(pairs, np.int32), dtype=int, device=device)
    spheres = [_spheres_on_device(arm, device) for arm in arms]
    centres = [_centres(arms[0], left, device), _centres(arms[1], right, device)]
    wp.launch(
        clear_of_each_other,
        dim=len(pairs),
        inputs=[*spheres, *centres, chosen, out],
        device=device,
    )
    return out.numpy().astype(np.float64)


def clearances_reference(
    arm: Arm, q: Float[np.ndarray, "N *c A"], placed: Placed | None
) -> Clearances:
    """`clearances` in NumPy and float64."""
    centre, radius = place_spheres(arm.chain, arm.spheres, q), arm.spheres.radius
    moving = slice(_first_moving(arm), None)
    far = centre[..., moving, :]
    table = np.min(far[..., 2] - radius[moving], axis=-1, initial=FAR)
    near = np.full(table.shape, FAR)
    if placed is not None:
        for n in range(len(q)):
            x = (far[n] - placed.pos[n]) @ placed.rot[n]
            distance = signed_distance(placed.field, float(placed.size[n]), x)[0]
            near[n] = np.min(distance - radius[moving], axis=-1, initial=FAR)
    a, b = arm.spheres.against_self.T
    apart = np.linalg.norm(centre[..., a, :] - centre[..., b, :], axis=-1) - radius[a] - radius[b]
    itself = np.min(apart, axis=-1, initial=FAR)
    for box in arm.fixtures:
        out = np.abs(far - np.array(box.pos)) - np.array(box.half)
        outside = np.linalg.norm(np.maximum(out, 0.0), axis=-1)
        gap = outside + np.minimum(out.max(axis=-1), 0.0) - radius[moving]
        itself = np.minimum(itself, np.min(gap, axis=-1, initial=FAR))
    return Clearances(table, near, itself)


def _first_moving(arm: Arm) -> int:
    return int(np.searchsorted(arm.spheres.joint, 1))


def _centres(arm: Arm, q: np.ndarray, device: str) -> Any:
    import warp as wp

    from bidexdata.arms.clearance_kernels import place_arm_spheres

    flat = np.ascontiguousarray(q.reshape(-1, arm.chain.joints), np.float32)
    centre = wp.zeros((len(flat), len(arm.spheres.radius)), dtype=wp.vec3, device=device)
    wp.launch(
        place_arm_spheres,
        dim=len(flat),
        inputs=[
            chain_on_device(arm.chain, device),
            _spheres_on_device(arm, device),
            wp.array(flat, dtype=float, device=device),
            centre,
        ],
        device=device,
    )
    return centre


def _object_on_device(placed: Placed | None, rows: int, device: str) -> list[Any]:
    import warp as wp

    if placed is None:
        nothing = SignedDistanceGrid(np.zeros((2, 2, 2), np.float32), np.zeros(3), 1.0)
        placed = Placed(
            nothing, np.ones(rows), np.zeros((rows, 3)), np.tile(np.eye(3), (rows, 1, 1))
        )
        present = 0
    else:
        present = 1
    size = np.ascontiguousarray(placed.size, np.float32)
    pos = np.ascontiguousarray(placed.pos, np.float32)
    rot = np.ascontiguousarray(placed.rot, np.float32)
    return [
        _field_on_device(placed.field, device),
        present,
        wp.array(size, dtype=float, device=device),
        wp.array(pos, dtype=wp.vec3, shape=(rows,), device=device),
        wp.array(rot, dtype=wp.mat33, shape=(rows,), device=device),
    ]


@lru_cache(maxsize=16)
def _field_on_device(field: SignedDistanceGrid, device: str) -> Any:
    return device_field(field, device)


@lru_cache(maxsize=16)
def _spheres_on_device(arm: Arm, device: str) -> Any:
    start_warp()
    import warp as wp

    from bidexdata.arms.clearance_kernels import SphereArrays

    def vectors(values: np.ndarray) -> Any:
        values = np.ascontiguousarray(values, np.float32).reshape(-1, 3)
        return wp.array(values, dtype=wp.vec3, shape=(len(values),), device=device)

    arrays, spheres = SphereArrays(), arm.spheres
    arrays.joint = wp.array(spheres.joint.astype(np.int32), dtype=int, device=device)
    arrays.pos = vectors(spheres.pos)
    arrays.radius = wp.array(spheres.radius.astype(np.float32), dtype=float, device=device)
    arrays.pairs = wp.array(spheres.against_self.astype(np.int32), dtype=int, device=device)
    arrays.fixture_pos = vectors(np.array([box.pos for box in arm.fixtures]))
    arrays.fixture_half = vectors(np.array([box.half for box in arm.fixtures]))
    arrays.first_moving = _first_moving(arm)
    return arrays
