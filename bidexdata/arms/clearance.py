"""How far arms stand from table, object, themselves and each other, by spheres: the search's view.

MuJoCo has the final word on a path. Here wrist and forearm count to the arm; hands count where they
are given, against the arm that carries them only from its fourth last joint back. Links before the
second joint stand in one place and count only against the arm itself.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.arms.arm_spheres import place_spheres
from bidexdata.arms.chain import chain_forward
from bidexdata.arms.inverse_kinematics import chain_on_device
from bidexdata.arms.robot import Arm
from bidexdata.devices import start_warp
from bidexdata.objects.distance_field import device_field, signed_distance
from bidexdata.objects.prepared import SignedDistanceGrid

FAR = 1e3
"""Clearance from what is not there [m]."""
_ROUNDING = 1e-5
"""What the balls round groups are larger by than they need be, for float32 [m]."""
_NO_FIELD = SignedDistanceGrid(np.zeros((2, 2, 2), np.float32), np.zeros(3), 1.0)


class Placed(NamedTuple):
    """The object of each row of configurations, in the world."""

    field: SignedDistanceGrid
    """Of all rows' object, at unit diagonal."""
    size: Float[np.ndarray, " N"]
    """Bounding-box diagonals [m]."""
    pos: Float[np.ndarray, "N 3"]
    """[m]."""
    rot: Float[np.ndarray, "N 3 3"]


class HeldHands(NamedTuple):
    """The spheres of one hand in the posture of each row of configurations."""

    pos: Float[np.ndarray, "N K 3"]
    """Centres in the hand frame [m]."""
    radius: Float[np.ndarray, " K"]
    """[m]."""


class Clearances(NamedTuple):
    """Least distances of one arm [m]; negative where spheres overlap."""

    table: Float[np.ndarray, "*n"]
    obj: Float[np.ndarray, "*n"]
    """`FAR` without an object."""
    itself: Float[np.ndarray, "*n"]
    """Links against each other and against the rig's fixtures."""


class Surroundings:
    """What the arms of N grasps have to mind, on a device: put there once, asked about often."""

    def __init__(
        self,
        placed: Placed | None,
        hands: tuple[HeldHands | None, HeldHands | None] = (None, None),
        *,
        rows: int,
        device: str = "cpu",
    ) -> None:
        """Copy them to the device.

        Args:
            placed: The object of each row; none for arms, table and fixtures alone.
            hands: The open hands of each row, left and right, where they count.
            rows: N.
            device: A Warp device.
        """
        start_warp()
        self.device = device
        self.field, self.object = _object_on_device(placed, rows, device)
        self.hands = tuple(
            _nothing_held(device) if hand is None else _hands_on_device(hand, device)
            for hand in hands
        )


def clear_at(
    arm: Arm,
    q: Float[np.ndarray, "M A"],
    rows: Int[np.ndarray, " M"],
    around: Surroundings,
    side: int = 0,
    *,
    with_hand: bool = True,
    most: float = FAR,
) -> Float[np.ndarray, "3 M"]:
    """Clearance of one arm from table, object and itself with the fixtures [m].

    Args:
        arm: The arm.
        q: Configurations [rad].
        rows: The grasp that each is of.
        around: What is there.
        side: Whose hand the arm carries.
        with_hand: The hand counts.
        most: Larger clearances are given as this, which takes less time [m].
    """
    import warp as wp

    from bidexdata.arms.clearance_kernels import clear_alone

    if not len(q):
        return np.zeros((3, 0))
    device = around.device
    hand = around.hands[side] if with_hand else _nothing_held(device)
    placed = _place(arm, q, rows, hand, device)
    out = wp.empty((3, len(q)), dtype=float, device=device)
    wp.launch(
        clear_alone,
        dim=len(q),
        inputs=[placed.spheres, hand, around.field, around.object, placed.centre, placed.rows,
                most, out],
        device=device,
    )  # fmt: skip
    return out.numpy().astype(np.float64)


def apart_at(
    arms: tuple[Arm, Arm],
    left: Float[np.ndarray, "L A"],
    right: Float[np.ndarray, "R B"],
    rows: tuple[Int[np.ndarray, " L"], Int[np.ndarray, " R"]],
    around: Surroundings,
    pairs: Int[np.ndarray, "M 2"] | None = None,
    *,
    with_hands: bool = True,
    most: float = FAR,
) -> Float[np.ndarray, " M"]:
    """Clearance between two arms [m].

    Args:
        arms: Left and right.
        left: Configurations of the left arm [rad].
        right: Of the right arm [rad].
        rows: The grasp that each is of.
        around: What is there.
        pairs: Which are taken together; each with its like when omitted.
        with_hands: The hands count.
        most: Larger clearances are given as this, which takes less time [m].
    """
    import warp as wp

    from bidexdata.arms.clearance_kernels import clear_of_each_other

    if pairs is None:
        pairs = np.repeat(np.arange(len(left), dtype=np.int32)[:, None], 2, axis=1)
    if not len(pairs):
        return np.zeros(0)
    device = around.device
    hands = around.hands if with_hands else (_nothing_held(device),) * 2
    one, other = (
        _place(arm, q, row, hand, device)
        for arm, q, row, hand in zip(arms, (left, right), rows, hands, strict=True)
    )
    chosen = wp.array(np.ascontiguousarray(pairs, np.int32), dtype=int, device=device)
    out = wp.empty(len(pairs), dtype=float, device=device)
    wp.launch(
        clear_of_each_other,
        dim=len(pairs),
        inputs=[one.spheres, other.spheres, *hands, one.centre, other.centre, one.rows, other.rows,
                chosen, most, out],
        device=device,
    )  # fmt: skip
    return out.numpy().astype(np.float64)


def room_of_ways(
    around: Surroundings,
    side: int,
    rows: Int[np.ndarray, " N"],
    pos: Float[np.ndarray, "N 3"],
    rot: Float[np.ndarray, "N 3 3"],
    ways: Float[np.ndarray, "N D 3"],
    checks: int,
) -> tuple[Float[np.ndarray, "N D"], Float[np.ndarray, "N D"]]:
    """Clearance of open hands from the object on straight ways: behind their starts, and there [m].

    Args:
        around: The object and the hands.
        side: Which hands.
        rows: The grasp that each way is of.
        pos: Where they are [m].
        rot: How they are turned.
        ways: Where they go from there [m].
        checks: In how many steps.
    """
    import warp as wp

    from bidexdata.arms.clearance_kernels import room_of_hands

    device, shape = around.device, ways.shape[:2]
    if not len(rows):
        return np.zeros(shape), np.zeros(shape)
    of = wp.array(np.ascontiguousarray(rows, np.int32), dtype=int, device=device)
    room, start = (wp.empty(shape, dtype=float, device=device) for _ in range(2))
    turns = np.ascontiguousarray(rot, np.float32)
    lines = np.ascontiguousarray(ways, np.float32)
    wp.launch(
        room_of_hands,
        dim=shape,
        inputs=[
            *(around.hands[side], around.field, around.object, of, _vectors(pos, device, len(pos))),
            wp.array(turns, dtype=wp.mat33, shape=(len(pos),), device=device),
            wp.array(lines, dtype=wp.vec3, shape=shape, device=device),
            *(checks, room, start),
        ],
        device=device,
    )
    return room.numpy().astype(np.float64), start.numpy().astype(np.float64)


def clearances(
    arm: Arm,
    q: Float[np.ndarray, "N *c A"],
    placed: Placed | None,
    hands: HeldHands | None = None,
    *,
    device: str = "cpu",
) -> Clearances:
    """Clearance of one arm alone.

    Args:
        arm: The arm.
        q: Configurations, one row per object pose [rad].
        placed: The objects; none for arm, table and fixtures alone.
        hands: The hand, for each row, where it counts.
        device: A Warp device.
    """
    around = Surroundings(placed, (hands, None), rows=len(q), device=device)
    flat, rows = _flat(q)
    return Clearances(*clear_at(arm, flat, rows, around).reshape(3, *q.shape[:-1]))


def clearance_between(
    arms: tuple[Arm, Arm],
    left: Float[np.ndarray, "L *c A"],
    right: Float[np.ndarray, "R *d B"],
    pairs: Int[np.ndarray, "M 2"],
    hands: tuple[HeldHands, HeldHands] | None = None,
    *,
    device: str = "cpu",
) -> Float[np.ndarray, " M"]:
    """Clearance between two arms.

    Args:
        arms: Left and right.
        left: Configurations of the left arm [rad].
        right: Of the right arm [rad].
        pairs: Which are taken together, numbers of both in C order.
        hands: The hands, for each row of configurations, where they count.
        device: A Warp device.
    """
    around = Surroundings(None, hands or (None, None), rows=0, device=device)
    one, other = _flat(left), _flat(right)
    return apart_at(arms, one[0], other[0], (one[1], other[1]), around, pairs)


def _flat(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Configurations (N, *c, A) as (M, A), and the row of each."""
    per_row = int(np.prod(q.shape[1:-1]))
    return q.reshape(len(q) * per_row, q.shape[-1]), np.repeat(np.arange(len(q)), per_row)


def clearances_reference(
    arm: Arm,
    q: Float[np.ndarray, "N *c A"],
    placed: Placed | None,
    hands: HeldHands | None = None,
) -> Clearances:
    """`clearances` in NumPy and float64."""
    centre, radius = place_spheres(arm.chain, arm.spheres, q), arm.spheres.radius
    a, b = arm.spheres.against_self.T
    apart = np.linalg.norm(centre[..., a, :] - centre[..., b, :], axis=-1) - radius[a] - radius[b]
    itself = np.min(apart, axis=-1, initial=FAR)
    moving = slice(_first_moving(arm), None)
    far, radius = centre[..., moving, :], radius[moving]
    if hands is not None:
        held, back = held_spheres(arm, q, hands), slice(0, _far_from_hand(arm))
        apart = np.linalg.norm(centre[..., back, None, :] - held[..., None, :, :], axis=-1)
        gap = apart - arm.spheres.radius[back, None] - hands.radius
        itself = np.minimum(itself, np.min(gap, axis=(-1, -2), initial=FAR))
        far = np.concatenate([far, held], axis=-2)
        radius = np.concatenate([radius, hands.radius])
    table = np.min(far[..., 2] - radius, axis=-1, initial=FAR)
    near = np.full(table.shape, FAR)
    if placed is not None:
        for n in range(len(q)):
            x = (far[n] - placed.pos[n]) @ placed.rot[n]
            distance = signed_distance(placed.field, float(placed.size[n]), x)[0]
            near[n] = np.min(distance - radius, axis=-1, initial=FAR)
    for box in arm.fixtures:
        out = np.abs(far - np.array(box.pos)) - np.array(box.half)
        outside = np.linalg.norm(np.maximum(out, 0.0), axis=-1)
        gap = outside + np.minimum(out.max(axis=-1), 0.0) - radius
        itself = np.minimum(itself, np.min(gap, axis=-1, initial=FAR))
    return Clearances(table, near, itself)


def held_spheres(
    arm: Arm, q: Float[np.ndarray, "N *c A"], hands: HeldHands
) -> Float[np.ndarray, "N *c K 3"]:
    """Centres of the spheres of a hand in the world [m] at joint angles [rad] of its arm."""
    pos, rot = chain_forward(arm.chain, q)
    local = hands.pos.reshape(len(q), *[1] * (q.ndim - 2), *hands.pos.shape[1:])
    return pos[..., None, :] + np.einsum("...ij,...kj->...ki", rot, local)


class _Spread(NamedTuple):
    """One arm with its hand at some configurations, on a device."""

    spheres: Any
    rows: Any
    centre: Any


def _place(arm: Arm, q: np.ndarray, rows: np.ndarray, hand: Any, device: str) -> _Spread:
    import warp as wp

    from bidexdata.arms.clearance_kernels import place_arm_spheres

    spheres = _spheres_on_device(arm, device)
    held = hand.radius.shape[0]
    width = len(arm.spheres.radius) + spheres.group_joint.shape[0] + (held + 1 if held else 0)
    vector: Any = wp.vec3
    centre = wp.empty((len(q), width), dtype=vector, device=device)
    of = wp.array(np.ascontiguousarray(rows, np.int32), dtype=int, device=device)
    angles = wp.array(np.ascontiguousarray(q, np.float32), dtype=float, device=device)
    wp.launch(
        place_arm_spheres,
        dim=len(q),
        inputs=[chain_on_device(arm.chain, device), spheres, hand, angles, of, centre],
        device=device,
    )
    return _Spread(spheres, of, centre)


def _hands_on_device(hands: HeldHands, device: str) -> Any:
    import warp as wp

    from bidexdata.arms.clearance_kernels import HandArrays

    arrays, count = HandArrays(), len(hands.pos)
    middle = 0.5 * (hands.pos.min(axis=1) + hands.pos.max(axis=1))
    wide = np.max(
        np.linalg.norm(hands.pos - middle[:, None], axis=-1) + hands.radius, axis=1, initial=0.0
    )
    arrays.pos = wp.array(
        np.ascontiguousarray(hands.pos, np.float32), dtype=wp.vec3, shape=hands.pos.shape[:2],
        device=device,
    )  # fmt: skip
    arrays.radius = wp.array(hands.radius.astype(np.float32), dtype=float, device=device)
    arrays.ball_pos = _vectors(middle, device, count)
    arrays.ball_radius = wp.array((wide + _ROUNDING).astype(np.float32), dtype=float, device=device)
    return arrays


@lru_cache(maxsize=4)
def _nothing_held(device: str) -> Any:
    import warp as wp

    from bidexdata.arms.clearance_kernels import HandArrays

    arrays = HandArrays()
    arrays.pos = wp.zeros((0, 0), dtype=wp.vec3, device=device)
    arrays.radius = wp.empty(0, dtype=float, device=device)
    arrays.ball_pos = wp.zeros(0, dtype=wp.vec3, device=device)
    arrays.ball_radius = wp.empty(0, dtype=float, device=device)
    return arrays


def _first_moving(arm: Arm) -> int:
    return int(np.searchsorted(arm.spheres.joint, 1))


def _far_from_hand(arm: Arm) -> int:
    """Spheres, from the first on, that the hand of the arm may meet."""
    return int(np.searchsorted(arm.spheres.joint, arm.chain.joints - 4, side="right"))


def _object_on_device(placed: Placed | None, rows: int, device: str) -> tuple[Any, Any]:
    import warp as wp

    from bidexdata.arms.clearance_kernels import ObjectArrays

    around = ObjectArrays()
    around.present = 0 if placed is None else 1
    if placed is None:
        placed = Placed(_NO_FIELD, np.ones(rows), np.zeros((rows, 3)), np.zeros((rows, 3, 3)))
    low, high = _box(placed.field)
    around.low, around.high = wp.vec3(*map(float, low)), wp.vec3(*map(float, high))
    around.size = wp.array(
        np.ascontiguousarray(placed.size, np.float32), dtype=float, device=device
    )
    around.pos = _vectors(placed.pos, device, rows)
    rot = np.ascontiguousarray(placed.rot, np.float32)
    around.rot = wp.array(rot, dtype=wp.mat33, shape=(rows,), device=device)
    return _field_on_device(placed.field, device), around


def _vectors(values: np.ndarray, device: str, count: int) -> Any:
    import warp as wp

    values = np.ascontiguousarray(values, np.float32).reshape(-1, 3)
    return wp.array(values, dtype=wp.vec3, shape=(count,), device=device)


@lru_cache(maxsize=16)
def _box(field: SignedDistanceGrid) -> tuple[np.ndarray, np.ndarray]:
    """Corners of an upright box that no point of the solid is beyond, at unit diagonal."""
    inside = np.argwhere(field.values <= field.cell)
    if not len(inside):
        return np.zeros(3), np.zeros(3)
    # A cell more: the surface lies between nodes.
    low, high = inside.min(axis=0) - 1, inside.max(axis=0) + 1
    return field.origin + field.cell * low, field.origin + field.cell * high


@lru_cache(maxsize=16)
def _field_on_device(field: SignedDistanceGrid, device: str) -> Any:
    return device_field(field, device)


@lru_cache(maxsize=16)
def _spheres_on_device(arm: Arm, device: str) -> Any:
    start_warp()
    import warp as wp

    from bidexdata.arms.clearance_kernels import SphereArrays

    def numbers(values: Any, dtype: Any = int) -> Any:
        kind = np.int32 if dtype is int else np.float32
        return wp.array(np.ascontiguousarray(values, kind), dtype=dtype, device=device)

    def vectors(values: list[Any] | np.ndarray) -> Any:
        return _vectors(np.array(values, np.float64), device, len(values))

    arrays, spheres = SphereArrays(), arm.spheres
    groups = _groups(arm)
    pairs, pair_groups, pair_first = _grouped_pairs(arm, groups.first)
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
    arrays.first_group = int(np.searchsorted(groups.first[:-1], _first_moving(arm)))
    arrays.far_groups = int(np.searchsorted(groups.first[:-1], _far_from_hand(arm)))
    return arrays


class _Groups(NamedTuple):
    """Balls round the spheres of one body each."""

    first: np.ndarray
    """First sphere of each group, and the number of spheres."""
    pos: np.ndarray
    radius: np.ndarray


def _groups(arm: Arm) -> _Groups:
    spheres = arm.spheres
    keys = list(zip(spheres.joint.tolist(), spheres.part, strict=True))
    first = [k for k in range(len(keys)) if k == 0 or keys[k] != keys[k - 1]]
    pos, radius = [], []
    for a, b in pairwise([*first, len(keys)]):
        own = spheres.pos[a:b]
        middle = 0.5 * (own.min(axis=0) + own.max(axis=0))
        pos.append(middle)
        apart = np.linalg.norm(own - middle, axis=1) + spheres.radius[a:b]
        radius.append(float(apart.max()) + _ROUNDING)
    return _Groups(np.array([*first, len(keys)]), np.array(pos), np.array(radius))


def _grouped_pairs(arm: Arm, first: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of spheres that may meet by the groups that they are of; those groups; where they begin."""
    pairs = arm.spheres.against_self
    of = np.searchsorted(first, pairs, side="right") - 1
    order = np.lexsort((of[:, 1], of[:, 0]))
    pairs, of = pairs[order], of[order]
    starts = [k for k in range(len(of)) if k == 0 or (of[k] != of[k - 1]).any()]
    return pairs, of[starts].reshape(-1, 2), np.array([*starts, len(pairs)])
