"""How far arms stand from table, object, themselves and each other, by spheres: the search's view.

MuJoCo has the final word on a path. Here wrist and forearm count to the arm; hands count where they
are given, against the arm that carries them only from its fourth last joint back. Links before the
second joint stand in one place and count only against the arm itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.arms.placed_spheres import PosedArm, place_arm, pose_arm
from bidexdata.arms.robot import Arm
from bidexdata.arms.surroundings import (
    HeldHands,
    Placed,
    Surroundings,
    nothing_held,
    vectors_on_device,
)

FAR = 1e3
"""Clearance from what is not there [m]."""


class Clearances(NamedTuple):
    """Least distances of one arm [m]; negative where spheres overlap."""

    table: Float[np.ndarray, "*n"]
    obj: Float[np.ndarray, "*n"]
    """`FAR` without an object."""
    itself: Float[np.ndarray, "*n"]
    """Links against each other and against the rig's fixtures."""


class PairClearances(NamedTuple):
    """Of two arms at M configurations that follow each other."""

    apart: Float[np.ndarray, " M"]
    """Least distance between them [m]."""
    alone: Float[np.ndarray, " M"]
    """Least distance of one of them from table, object, fixtures and itself [m]."""
    way: Float[np.ndarray, "2 W"]
    """How far some sphere of each goes to the next configuration [m], W = M - 1."""


def clear_at(
    arm: Arm,
    q: Float[np.ndarray, "M A"],
    rows: Int[np.ndarray, " M"],
    around: Surroundings,
    side: int = 0,
    *,
    with_hand: bool = True,
    most: float = FAR,
    enough: float = -FAR,
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
        enough: A configuration that has one below this is not looked at any further [m].
    """
    if not len(q):
        return np.zeros((3, 0))
    import warp as wp

    from bidexdata.arms.clearance_kernels import clear_alone

    device = around.device
    hand = around.hands[side] if with_hand else nothing_held(device)
    posed, of = pose_arm(arm, q, hand, device), _whole(rows, device)
    out = _triples(len(q), device)
    wp.launch(
        clear_alone,
        dim=len(q),
        inputs=[posed.chain, posed.spheres, hand, around.field, around.object, posed.q, of, most,
                enough, posed.centre, out],
        device=device,
    )  # fmt: skip
    return out.numpy().astype(np.float64).T


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
    enough: float = -FAR,
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
        enough: Two that are nearer than this are not looked at any further [m].
    """
    if pairs is None:
        pairs = np.repeat(np.arange(len(left))[:, None], 2, axis=1)
    if not len(pairs):
        return np.zeros(0)
    import warp as wp

    from bidexdata.arms.clearance_kernels import clear_of_each_other

    device = around.device
    of = [_whole(row, device) for row in rows]
    one, other = _posed(arms, (left, right), around, with_hands=with_hands)
    for posed, row in zip((one, other), of, strict=True):
        place_arm(posed, row, device)
    out = wp.empty(len(pairs), dtype=float, device=device)
    wp.launch(
        clear_of_each_other,
        dim=len(pairs),
        inputs=[one.spheres, other.spheres, one.hand, other.hand, one.centre, other.centre, *of,
                _whole(pairs, device), most, enough, out],
        device=device,
    )  # fmt: skip
    return out.numpy().astype(np.float64)


def clear_together(
    arms: tuple[Arm, Arm],
    left: Float[np.ndarray, "M A"],
    right: Float[np.ndarray, "M B"],
    rows: Int[np.ndarray, " M"],
    around: Surroundings,
    *,
    with_hands: bool = True,
    most: tuple[float, float] = (FAR, FAR),
) -> PairClearances:
    """Clearances of two arms, and how far they go from one configuration to the next.

    As `apart_at`, and `clear_at` of both, but the spheres are placed once.

    Args:
        arms: Left and right.
        left: Configurations of the left arm [rad].
        right: Of the right arm, each with its like [rad].
        rows: The grasp that each is of.
        around: What is there.
        with_hands: The hands count.
        most: Larger clearances between the arms, and of each alone, are given as these, which takes
            less time [m].
    """
    if not len(rows):
        return PairClearances(np.zeros(0), np.zeros(0), np.zeros((2, 0)))
    import warp as wp

    from bidexdata.arms.clearance_kernels import clear_together as together
    from bidexdata.arms.sphere_kernels import ways_of_spheres

    device, count = around.device, len(rows)
    one, other = _posed(arms, (left, right), around, with_hands=with_hands)
    gaps = _triples(count, device)
    wp.launch(
        together,
        dim=count,
        inputs=[one.chain, other.chain, one.spheres, other.spheres, one.hand, other.hand,
                around.field, around.object, one.q, other.q, _whole(rows, device), *most,
                one.centre, other.centre, gaps],
        device=device,
    )  # fmt: skip
    ways = wp.empty((2, count - 1), dtype=float, device=device)
    wp.launch(
        ways_of_spheres, dim=count - 1, inputs=[one.centre, other.centre, ways], device=device
    )
    gap, alone, their = gaps.numpy().astype(np.float64).T
    return PairClearances(gap, np.minimum(alone, their), ways.numpy().astype(np.float64))


def _posed(
    arms: tuple[Arm, Arm],
    q: tuple[np.ndarray, np.ndarray],
    around: Surroundings,
    *,
    with_hands: bool,
) -> list[PosedArm]:
    """Both arms on the device."""
    device = around.device
    hands = around.hands if with_hands else (nothing_held(device),) * 2
    return [pose_arm(*of, device) for of in zip(arms, q, hands, strict=True)]


def _triples(count: int, device: str) -> Any:
    import warp as wp

    vector: Any = wp.vec3
    return wp.empty(count, dtype=vector, device=device)


def _whole(values: np.ndarray, device: str) -> Any:
    import warp as wp

    return wp.array(np.ascontiguousarray(values, np.int32), dtype=int, device=device)


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
    of = _whole(rows, device)
    room, start = (wp.empty(shape, dtype=float, device=device) for _ in range(2))
    turns = np.ascontiguousarray(rot, np.float32)
    lines = np.ascontiguousarray(ways, np.float32)
    wp.launch(
        room_of_hands,
        dim=shape,
        inputs=[
            *(
                around.hands[side],
                around.field,
                around.object,
                of,
                vectors_on_device(pos, device, len(pos)),
            ),
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
