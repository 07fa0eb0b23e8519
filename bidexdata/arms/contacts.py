"""How far a robot stands from table, object and itself by MuJoCo: the final word on a path.

Hands count as arms do until they close. From then on their touch is the grasp's own business: fingers
on the object, and overlaps of the hands with the table or each other that are no deeper than synthesis
lets them be where it is not told otherwise: its limits are settings of a run, and grasps of any run or
import come here. A hand's own forearm and wrist against that hand never count: one model, kept apart by
the limits of its joints, and as near as a millimetre in every posture.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from bidexdata.arms.arm_scene import ARM, FIXTURE, ArmScene
from bidexdata.engine_log import engine_warnings_logged
from bidexdata.simulation.assembly import hand_prefix
from bidexdata.simulation.scene import NOBODY
from bidexdata.simulation.settings import HANDS_DEPTH, TABLE_DEPTH

if TYPE_CHECKING:
    import mujoco

REACH = 0.05
"""Distances beyond this read as this [m]."""
TABLE, OBJECT, ARMS, ITSELF = range(4)
"""Places of the distances in `ArmDepths`."""
_NONE = -1


class ArmDepths(NamedTuple):
    """Least signed distances [m], at most the reach; negative = depth of an overlap."""

    table: Float[np.ndarray, "*t"]
    """Of arms from the table, of hands too until they close; then of hands that are in it deeper than a
    grasp may be."""
    obj: Float[np.ndarray, "*t"]
    """Of arms from the object, of hands too until they close."""
    arms: Float[np.ndarray, "*t"]
    """Of one arm from the other arm and its hand, and of the hands until they close; then of hands that
    are in each other too deep."""
    itself: Float[np.ndarray, "*t"]
    """Within one arm, from its own hand, and of arms and hands from fixtures; without a hand's own forearm
    and wrist against it."""


class PairKinds(NamedTuple):
    """What a pair of geoms counts as, by owners, and how deep it may be without counting."""

    kind: NDArray[np.int64]
    """Place in `ArmDepths`, or -1, for owners + `shift`, (O, O)."""
    may: NDArray[np.float64]
    """Depth that a pair of this kind may have [m]; -inf where every distance counts, (O, O)."""
    shift: int

    def of_arms_alone(self) -> PairKinds:
        """Without the pairs of hands that may overlap."""
        return self._replace(kind=np.where(np.isfinite(self.may), _NONE, self.kind))


def pair_kinds(arms: ArmScene, *, hands_touch: bool) -> PairKinds:
    """Say what every pair of owners counts as.

    Args:
        arms: The scene.
        hands_touch: Hands close or have closed: they may touch the object, and be in the table and in
            each other as deep as a grasp may.
    """
    of_object = arms.scene.object_owner
    owners = range(FIXTURE, of_object + 1)
    kind = np.full((len(owners), len(owners)), _NONE)
    may = np.full(kind.shape, -np.inf)

    def rule(first: int, second: int, place: int, depth: float = -np.inf) -> None:
        for a, b in ((first, second), (second, first)):
            kind[a - FIXTURE, b - FIXTURE], may[a - FIXTURE, b - FIXTURE] = place, depth

    for i in range(2):
        arm, other = ARM - i, 1 - i
        rule(arm, NOBODY, TABLE)
        rule(i, NOBODY, TABLE, TABLE_DEPTH if hands_touch else -np.inf)
        rule(arm, of_object, OBJECT)
        rule(i, of_object, _NONE if hands_touch else OBJECT)
        rule(arm, ARM - other, ARMS)
        rule(arm, other, ARMS)
        for own in (arm, i):
            rule(arm, own, ITSELF)
            rule(FIXTURE, own, ITSELF)
    rule(0, 1, ARMS, HANDS_DEPTH if hands_touch else -np.inf)
    return PairKinds(kind, may, -FIXTURE)


def arm_distances(
    arms: ArmScene,
    arm_q: Float[np.ndarray, "*t 2 A"],
    joints: Float[np.ndarray, "*s 2 J"],
    *,
    rise: Float[np.ndarray, "*t"] | None = None,
    reach: float = REACH,
    hands_touch: bool,
) -> ArmDepths:
    """Measure postures of a robot around the object where `set_arms` has put it.

    Args:
        arms: The scene; its arms and fingers are moved.
        arm_q: Joint angles of the arms [rad].
        joints: Of the hands [rad], as many as of the arms or one for all.
        rise: How much higher than that the object is in each posture [m].
        reach: Pairs farther apart than this are not looked for [m].
        hands_touch: As for `pair_kinds`.
    """
    lead = arm_q.shape[:-2]
    postures = arm_q.reshape(-1, *arm_q.shape[-2:])
    fingers = np.broadcast_to(joints, (*lead, *joints.shape[-2:])).reshape(-1, *joints.shape[-2:])
    qpos = qpos_of(arms, postures, fingers)
    if rise is not None:
        qpos[:, arms.scene.object_qpos + 2] += rise.ravel()
    found = distances_at(arms, qpos, reach=reach, hands_touch=hands_touch)
    return ArmDepths(*(column.reshape(lead) for column in found.T))


def qpos_of(
    arms: ArmScene, arm_q: Float[np.ndarray, "T 2 A"], joints: Float[np.ndarray, "T 2 J"]
) -> Float[np.ndarray, "T Q"]:
    """Positions of everything, with arms and fingers at T postures [rad], the rest as it is."""
    qpos = np.repeat(arms.scene.data.qpos[None], len(arm_q), axis=0)
    for i, (arm, fingers) in enumerate(zip(arms.arm_qpos, arms.scene.joint_qpos, strict=True)):
        qpos[:, arm], qpos[:, fingers] = arm_q[:, i, : len(arm)], joints[:, i, : len(fingers)]
    return qpos


def distances_at(
    arms: ArmScene,
    qpos: Float[np.ndarray, "T Q"],
    *,
    reach: float,
    hands_touch: bool,
    before: Callable[[int], object] | None = None,
) -> Float[np.ndarray, "T 4"]:
    """Measure T states of a scene, by `ArmDepths`' places [m]; its positions are put back.

    Args:
        arms: The scene.
        qpos: Positions of everything in it.
        reach: Pairs farther apart than this are not looked for [m].
        hands_touch: As for `pair_kinds`.
        before: Called with the number of each state before it is measured, to resize the object.
    """
    import mujoco

    model, data = arms.scene.model, arms.scene.data
    looked, met = _looked_at(arms, hands_touch=hands_touch), []
    at_first = data.qpos.copy()
    model.geom_gap[:] = 0.5 * reach  # MuJoCo adds those of a pair
    model.body_margin[looked.bodies] = reach  # what the broad phase reads
    try:
        _set_masks(model, looked.masks)
        with engine_warnings_logged():
            for k, state in enumerate(qpos):
                if before is not None:
                    before(k)
                data.qpos[:] = state
                mujoco.mj_kinematics(model, data)
                mujoco.mj_collision(model, data)
                # Copies: the arrays are views of what the next state overwrites.
                met.append((data.contact.geom.copy(), data.contact.dist.copy()))
    finally:
        if looked.masks is not None:
            _set_masks(model, looked.own_masks)
        model.geom_gap[:] = 0.0
        model.body_margin[looked.bodies] = 0.0
        data.qpos[:] = at_first
    return _least_of_each(looked, met, reach)


class Masks(NamedTuple):
    """Bits that say which geoms, and bodies of geoms, MuJoCo looks at; as in its model."""

    geom_contype: NDArray[np.int32]
    geom_conaffinity: NDArray[np.int32]
    body_contype: NDArray[np.int32]
    body_conaffinity: NDArray[np.int32]


def masks_of_kinds(
    arms: ArmScene, kinds: PairKinds, owners: NDArray[np.int64] | None = None
) -> Masks | None:
    """Bits that leave out pairs which do not count: fingers of one hand above all.

    Args:
        arms: The scene.
        kinds: What counts.
        owners: Of the geoms; the scene's when omitted, (G,).

    Returns:
        None where bits cannot say both that and what the model's own say.
    """
    model = arms.scene.model
    meets = (model.geom_contype | model.geom_conaffinity) != 0
    owner = (arms.scene.geom_owner if owners is None else owners) + kinds.shift
    counts = kinds.kind != _NONE
    with_others = (counts * (1 << np.arange(len(counts)))).sum(axis=1)
    contype = np.where(meets, 1 << owner, 0).astype(np.int32)
    conaffinity = np.where(meets, with_others[owner], 0).astype(np.int32)
    wanted = counts[owner[:, None], owner] & _meet(model.geom_contype, model.geom_conaffinity)
    if (wanted != _meet(contype, conaffinity)).any():
        return None
    of_bodies = [np.zeros(model.nbody, np.int32) for _ in range(2)]
    for bits, values in zip(of_bodies, (contype, conaffinity), strict=True):
        np.bitwise_or.at(bits, model.geom_bodyid, values)
    return Masks(contype, conaffinity, *of_bodies)


class _LookedAt(NamedTuple):
    """What a scene of arms is measured with."""

    kinds: PairKinds
    owner: NDArray[np.int64]
    """Of the geoms: the scene's, but forearm and wrist of a hand have numbers of their own, (G,)."""
    masks: Masks | None
    own_masks: Masks
    """The model's."""
    bodies: NDArray[np.int64]
    """Of its geoms, without the world."""


@lru_cache(maxsize=4)
def _looked_at(arms: ArmScene, *, hands_touch: bool) -> _LookedAt:
    owner, kinds = _with_carriers(arms, pair_kinds(arms, hands_touch=hands_touch))
    masks = masks_of_kinds(arms, kinds, owner)
    own_masks = Masks(*(getattr(arms.scene.model, name).copy() for name in Masks._fields))
    bodies = np.setdiff1d(arms.scene.model.geom_bodyid, [0])
    return _LookedAt(kinds, owner, masks, own_masks, bodies)


def _with_carriers(arms: ArmScene, kinds: PairKinds) -> tuple[NDArray[np.int64], PairKinds]:
    """Make owners of forearm and wrist of each hand, which meet all that their arm does but that hand."""
    model, owner, count = arms.scene.model, arms.scene.geom_owner.copy(), len(kinds.kind)
    of = np.concatenate([np.arange(count), [ARM + kinds.shift, ARM - 1 + kinds.shift]])
    kind, may = kinds.kind[np.ix_(of, of)], kinds.may[np.ix_(of, of)]
    named = [model.body(int(b)).name for b in model.geom_bodyid]
    for i in range(2):
        carries = np.array([name.startswith(hand_prefix(i)) for name in named])
        carries &= owner == ARM - i
        owner[carries] = count + i - kinds.shift
        kind[count + i, i + kinds.shift] = kind[i + kinds.shift, count + i] = _NONE
    return owner, PairKinds(kind, may, kinds.shift)


def _meet(contype: np.ndarray, conaffinity: np.ndarray) -> np.ndarray:
    """Which pairs of geoms MuJoCo looks at by their bits, (G, G)."""
    one_way = (contype[:, None] & conaffinity) != 0
    return one_way | one_way.T


def _set_masks(model: mujoco.MjModel, masks: Masks | None) -> None:
    if masks is not None:
        for name, bits in zip(masks._fields, masks, strict=True):
            getattr(model, name)[:] = bits


def _least_of_each(
    looked: _LookedAt, met: list[tuple[np.ndarray, np.ndarray]], reach: float
) -> Float[np.ndarray, "T 4"]:
    """Least distances over the contacts of each of T postures [m], by `ArmDepths`' places."""
    least = np.full((len(met), 5), reach)  # the last for pairs that do not count
    counts = [len(dist) for _geoms, dist in met]
    if sum(counts):
        geoms = np.concatenate([g.reshape(-1, 2) for g, _dist in met])
        dist = np.concatenate([d for _geoms, d in met])
        _keep_least(
            least, looked.kinds, looked.owner[geoms], dist, np.repeat(range(len(met)), counts)
        )
    return least[:, :4]


def least_distances(
    arms: ArmScene, kinds: PairKinds, reach: float = 0.0
) -> Float[np.ndarray, " 4"]:
    """Least distances [m] over the contacts that the scene's state lists, by `ArmDepths`' places."""
    least = np.full((1, 5), reach)
    contact = arms.scene.data.contact
    geoms = contact.geom
    if len(geoms):
        _keep_least(
            least, kinds, arms.scene.geom_owner[geoms], contact.dist, np.zeros(len(geoms), np.intp)
        )
    return least[0, :4]


def _keep_least(
    least: np.ndarray, kinds: PairKinds, owners: np.ndarray, dist: np.ndarray, row: np.ndarray
) -> None:
    """Lower the entries of rows of `least` to the distances of their contacts."""
    pairs = owners + kinds.shift
    kind = kinds.kind[pairs[:, 0], pairs[:, 1]]
    far = dist >= -kinds.may[pairs[:, 0], pairs[:, 1]]
    np.minimum.at(least, (row, np.where(far, _NONE, kind)), dist)


def nearest_side(arms: ArmScene, place: int, *, hands_touch: bool) -> tuple[int, bool]:
    """Say whose the nearest contact of one kind is in the state that `distances_at` left last.

    Args:
        arms: The scene.
        place: The kind, a place in `ArmDepths`.
        hands_touch: As it was measured.

    Returns:
        The number of the arm, -1 where the two of them meet, and whether it is its hand that is near.
    """
    looked = _looked_at(arms, hands_touch=hands_touch)
    contact = arms.scene.data.contact
    geoms, dist = contact.geom, contact.dist
    pairs = looked.owner[geoms] + looked.kinds.shift
    counts = looked.kinds.kind[pairs[:, 0], pairs[:, 1]] == place
    counts &= dist < -looked.kinds.may[pairs[:, 0], pairs[:, 1]]
    if place == ARMS or not counts.any():
        return -1, False
    owners = arms.scene.geom_owner[geoms[np.flatnonzero(counts)[dist[counts].argmin()]]].tolist()
    for i in range(2):
        if ARM - i in owners:
            return i, False
    own = [one for one in owners if 0 <= one < 2]
    return (own[0], True) if own else (-1, False)
