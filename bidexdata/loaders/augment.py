"""Augmentations that keep a grasp a grasp: a turn about gravity, and the mirror image.

Both move hands, object, cloud and contacts together, so every pad still touches its contact point.
The mirror image swaps the hands: what the left hand did, its image, a right hand, does. What is
drawn for a grasp is a function of (seed, epoch, row), whatever the batch and the number of workers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bidexdata.errors import BadConfig
from bidexdata.frames import invert, matrix_from_quat, quat_from_matrix, quat_from_rotation_vector
from bidexdata.loaders.permutation import uniform
from bidexdata.record.fields import FIELDS

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand
    from bidexdata.hands.twins import Twin

ACROSS = np.diag([1.0, -1.0, 1.0])
"""The reflection: y -> -y, left to right, of the world and of the object frame."""
_IN_OBJECT = ("contact_point", "contact_normal", "contact_force")
_PER_HAND = tuple(n for n, f in FIELDS.items() if f.axes[:1] == ("H",) and n != "sides")
_YAW, _MIRROR = 1, 2
Columns = dict[str, np.ndarray]


class HandPair(NamedTuple):
    """The two hands of a data set, each with its twin in the other."""

    twins: tuple[Twin, Twin]
    """Of the hand at place 0 of the H axis in the hand at place 1, and the other way."""

    @classmethod
    def of(cls, hands: Sequence[Hand]) -> HandPair:
        """Match the hands of the H axis.

        Raises:
            BadConfig: There is one hand only, or the hands are no mirror images of each other.
        """
        from bidexdata.hands.twins import twin_of

        if len(hands) != 2:
            raise BadConfig(
                "the mirror image of a grasp swaps two hands, and this data has one "
                f"({hands[0].side}); leave out mirror"
            )
        return cls((twin_of(hands[0], hands[1]), twin_of(hands[1], hands[0])))


def draw_angles(seed: int, epoch: int, key: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Angles about gravity, uniform in [0, 2 pi) [rad]."""
    return 2 * np.pi * uniform(seed, _YAW, epoch, key)


def draw_mirrored(seed: int, epoch: int, key: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which scenes are mirrored: half of them."""
    return uniform(seed, _MIRROR, epoch, key) < 0.5


def turn_about_gravity(
    columns: Columns, angle: Float[np.ndarray, " n"], frame: str
) -> tuple[Columns, Float[np.ndarray, "n 3 3"]]:
    """Turn grasps about the vertical through the origin of the frame.

    In the `world` frame the object turns with the hands, and contacts, which are in the object
    frame, stay. In the `object` frame all that is in it turns about the direction of gravity there,
    and the object's pose is the one that leaves the world as it was.

    Args:
        columns: Columns of n grasps, hand poses in `frame`; with `object_quat_wxyz` where the
            object has another pose than the identity.
        angle: [rad].
        frame: `object` or `world`.

    Returns:
        The columns, and the rotations of what else is in the frame (clouds).
    """
    up = np.tile([0.0, 0.0, 1.0], (len(angle), 1))
    if frame == "object" and "object_quat_wxyz" in columns:
        up = matrix_from_quat(columns["object_quat_wxyz"])[:, 2]  # the third row of R_world_object
    R = matrix_from_quat(quat_from_rotation_vector(up * angle[:, None]))
    out = dict(columns)
    _move_hands(out, R, np.broadcast_to(np.eye(4), (2, 4, 4)))
    if frame == "object":
        _turn_vectors(out, _IN_OBJECT, R)
        _turn_object(out, np.broadcast_to(np.eye(3), R.shape), np.swapaxes(R, 1, 2))
    else:
        _turn_vectors(out, ("object_pos",), R)
        _turn_object(out, R, np.broadcast_to(np.eye(3), R.shape))
    return out, R


def mirror(columns: Columns, pair: HandPair) -> tuple[Columns, np.ndarray]:
    """Give the mirror image of grasps: of a mirrored object, held by swapped hands.

    Args:
        columns: Columns of n grasps; the frame of the hand poses, `object` or `world`, is
            reflected y -> -y.
        pair: The hands.

    Returns:
        The columns, and the reflection of what else is in the frame (clouds), (3, 3).
    """
    out = dict(columns)
    count = len(next(iter(columns.values()))) if columns else 0
    M = np.broadcast_to(ACROSS, (count, 3, 3))
    for name in _PER_HAND:
        if name in out:
            out[name] = out[name][:, ::-1]
    # Place 1 holds what was at place 0, so it takes that hand's twin; and the other way.
    taken = (pair.twins[1], pair.twins[0])
    _move_hands(out, M, np.stack([invert(t.image) for t in taken]))
    _turn_vectors(out, (*_IN_OBJECT, "object_pos"), M)
    _turn_object(out, M, M)
    if "joints" in out:
        out["joints"] = _twin_joints(out["joints"], taken)
    if "contact_index" in out:
        out["contact_index"] = _twin_contacts(out["contact_index"], taken)
    return {n: np.ascontiguousarray(v) for n, v in out.items()}, ACROSS


def _move_hands(out: Columns, R: np.ndarray, local: np.ndarray) -> None:
    """Pose T of each hand becomes R T local, local per hand, (H, 4, 4); in place in `out`."""
    if not {"hand_pos", "hand_quat_wxyz"} & set(out):
        return
    quat, pos = out["hand_quat_wxyz"], out["hand_pos"]
    known = np.asarray(np.isfinite(quat).all(axis=-1))
    safe = np.where(known[..., None], quat, np.array([1.0, 0, 0, 0]))
    turned = R[:, None, None] @ matrix_from_quat(safe)
    local = local[: pos.shape[1], None]
    shift = (turned @ local[..., :3, 3:])[..., 0]
    new = quat_from_matrix(turned @ local[..., :3, :3])
    out["hand_pos"] = (np.einsum("nij,nhsj->nhsi", R, pos) + shift).astype(np.float32)
    out["hand_quat_wxyz"] = np.where(known[..., None], new, np.nan).astype(np.float32)


def _turn_vectors(out: Columns, names: Sequence[str], R: np.ndarray) -> None:
    for name in names:
        if name in out:
            moved = np.einsum("nij,n...j->n...i", R, out[name])
            out[name] = moved.astype(np.float32)


def _turn_object(out: Columns, left: np.ndarray, right: np.ndarray) -> None:
    if "object_quat_wxyz" in out:
        R = left @ matrix_from_quat(out["object_quat_wxyz"]) @ right
        out["object_quat_wxyz"] = quat_from_matrix(R).astype(np.float32)


def _twin_joints(joints: np.ndarray, taken: tuple[Twin, Twin]) -> np.ndarray:
    out = np.full_like(joints, np.nan)
    for h, twin in enumerate(taken):
        count = len(twin.joint)
        out[:, h][..., twin.joint] = joints[:, h, :, :count] * twin.factor.astype(np.float32)
    return out


def _twin_contacts(index: np.ndarray, taken: tuple[Twin, Twin]) -> np.ndarray:
    out = np.full_like(index, -1)
    for h, twin in enumerate(taken):
        mine = index[:, h]
        found = twin.contact[np.clip(mine, 0, len(twin.contact) - 1)] if len(twin.contact) else mine
        out[:, h] = np.where(mine >= 0, found, -1)
    return out
