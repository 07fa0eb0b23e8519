"""The spheres of an arm on a device, in groups, and where they are at given joint angles.

World frame. Groups are spheres of one body that follow each other along it, in a ball.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.arms.arm_spheres import ArmSpheres
from bidexdata.arms.chain_arrays import chain_on_device
from bidexdata.arms.robot import Arm
from bidexdata.arms.surroundings import ROUNDING, vectors_on_device
from bidexdata.devices import start_warp

_TOGETHER = 6
"""Spheres of a link that a ball is put round, at most [-]."""


class PosedArm(NamedTuple):
    """One arm with its hand at M configurations, on a device, for kernels that place its spheres."""

    chain: Any
    """`ChainArrays` of the arm."""
    spheres: Any
    """`SphereArrays` of the arm."""
    hand: Any
    """`HandArrays` of its hand."""
    q: Any
    """Joint angles [rad], (M, A)."""
    centre: Any
    """Room for the centres of spheres and balls in the world [m], (M, K)."""


def pose_arm(arm: Arm, q: Float[np.ndarray, "M A"], hand: Any, device: str) -> PosedArm:
    """Put configurations of an arm on a device; the centres are not there yet.

    Args:
        arm: The arm.
        q: Configurations [rad].
        hand: `HandArrays`.
        device: A Warp device.
    """
    import warp as wp

    spheres = _spheres_on_device(arm, device)
    held = hand.radius.shape[0]
    of_hand = held + hand.ball_radius.shape[1] + 1 if held else 0
    width = len(arm.spheres.radius) + spheres.group_joint.shape[0] + of_hand
    vector: Any = wp.vec3
    return PosedArm(
        chain_on_device(arm.chain, device),
        spheres,
        hand,
        wp.array(np.ascontiguousarray(q, np.float32), dtype=float, device=device),
        wp.empty((len(q), width), dtype=vector, device=device),
    )


def place_arm(posed: PosedArm, rows: Any, device: str) -> None:
    """Place the spheres of an arm and its hand; writes to its centres.

    Args:
        posed: The arm.
        rows: On the device, the row of the hand that each configuration is of.
        device: A Warp device.
    """
    import warp as wp

    from bidexdata.arms.sphere_kernels import place_arm_spheres

    wp.launch(
        place_arm_spheres,
        dim=rows.shape[0],
        inputs=[posed.chain, posed.spheres, posed.hand, posed.q, rows, posed.centre],
        device=device,
    )


@lru_cache(maxsize=16)
def _spheres_on_device(arm: Arm, device: str) -> Any:
    start_warp()
    import warp as wp

    from bidexdata.arms.sphere_kernels import SphereArrays

    def numbers(values: Any, dtype: Any = int) -> Any:
        kind = np.int32 if dtype is int else np.float32
        return wp.array(np.ascontiguousarray(values, kind), dtype=dtype, device=device)

    def vectors(values: list[Any] | np.ndarray) -> Any:
        return vectors_on_device(np.array(values, np.float64), device, len(values))

    arrays, spheres = SphereArrays(), along_links(arm.spheres)
    groups = _groups(spheres)
    pairs, pair_groups, pair_first = _grouped_pairs(spheres.against_self, groups.first)
    arrays.joint = numbers(spheres.joint)
    arrays.pos = vectors(spheres.pos)
    arrays.radius = numbers(spheres.radius, float)
    arrays.pairs = numbers(pairs)
    arrays.pair_groups = numbers(pair_groups)
    arrays.pair_first = numbers(pair_first)
    arrays.group_first = numbers(groups.first)
    arrays.group_joint = numbers(spheres.joint[groups.first[:-1]])
    arrays.group_pos = vectors(groups.pos)
    arrays.group_radius = numbers(groups.radius, float)
    arrays.fixture_pos = vectors([box.pos for box in arm.fixtures])
    arrays.fixture_half = vectors([box.half for box in arm.fixtures])
    arrays.first_group = int(np.searchsorted(groups.first[:-1], first_moving(arm)))
    arrays.far_groups = int(np.searchsorted(groups.first[:-1], far_from_hand(arm)))
    return arrays


def along_links(spheres: ArmSpheres) -> ArmSpheres:
    """The same spheres, those of each body in order along its longest side."""
    first = _first_of_bodies(spheres)
    order = [
        a + np.argsort(own[:, np.ptp(own, axis=0).argmax()], kind="stable")
        for a, own in zip(first, np.split(spheres.pos, first[1:]), strict=True)
    ]
    whole = np.concatenate(order)
    place = np.argsort(whole)
    pairs = place[spheres.against_self].astype(np.int32)
    return spheres._replace(
        pos=spheres.pos[whole], radius=spheres.radius[whole], against_self=pairs
    )


def _first_of_bodies(spheres: ArmSpheres) -> list[int]:
    keys = list(zip(spheres.joint.tolist(), spheres.part, strict=True))
    return [k for k in range(len(keys)) if k == 0 or keys[k] != keys[k - 1]]


class _Groups(NamedTuple):
    """Balls round some spheres of one body each."""

    first: np.ndarray
    """First sphere of each group, and the number of spheres."""
    pos: np.ndarray
    radius: np.ndarray


def _groups(spheres: ArmSpheres) -> _Groups:
    ends = [*_first_of_bodies(spheres), len(spheres.radius)]
    first = [k for a, b in pairwise(ends) for k in range(a, b, _TOGETHER)]
    pos, radius = [], []
    for a, b in pairwise([*first, ends[-1]]):
        own = spheres.pos[a:b]
        middle = 0.5 * (own.min(axis=0) + own.max(axis=0))
        pos.append(middle)
        apart = np.linalg.norm(own - middle, axis=1) + spheres.radius[a:b]
        radius.append(float(apart.max()) + ROUNDING)
    return _Groups(np.array([*first, ends[-1]]), np.array(pos), np.array(radius))


def _grouped_pairs(
    pairs: np.ndarray, first: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of spheres that may meet by the groups that they are of; those groups; where they begin."""
    of = np.searchsorted(first, pairs, side="right") - 1
    order = np.lexsort((of[:, 1], of[:, 0]))
    pairs, of = pairs[order], of[order]
    starts = [k for k in range(len(of)) if k == 0 or (of[k] != of[k - 1]).any()]
    return pairs, of[starts].reshape(-1, 2), np.array([*starts, len(pairs)])


def first_moving(arm: Arm) -> int:
    """The first sphere that a second joint of the chain, or a later one, moves."""
    return int(np.searchsorted(arm.spheres.joint, 1))


def far_from_hand(arm: Arm) -> int:
    """Spheres, from the first on, that the hand of the arm may meet."""
    return int(np.searchsorted(arm.spheres.joint, arm.chain.joints - 4, side="right"))
