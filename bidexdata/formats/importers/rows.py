"""From the grasps of foreign files to rows of the record, in our frames, sizes and ids.

The object frame's origin is the centre of mass of the simulated solid and its unit the solid's box
diagonal, so the object's pose moves and its scale becomes a size. Floating scenes are moved as a
whole until the object has the identity pose; on a table the scene is shifted until the object
stands at x = y = 0. Columns that an import cannot know are left out. A row whose joints our hand
cannot reach has the status `joint_range` and no pose; it is kept as an audit row, not a selected one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import NotUsable
from bidexdata.formats.importers.format import (
    FloatArray,
    ForeignGrasps,
    Format,
    Placed,
    placed,
)
from bidexdata.formats.importers.stages import Staged, all_possible, staged
from bidexdata.frames import quat_canonical, quat_conjugate, quat_multiply, quat_rotate
from bidexdata.hands.model import Hand
from bidexdata.objects.prepared import Solid
from bidexdata.record import GraspBatch, Header, Scene, Status
from bidexdata.record.batch import empty_columns
from bidexdata.record.fields import SIDES
from bidexdata.record.scene import Setting
from bidexdata.synthesis.attempts import grasp_ids

COLUMNS = (
    *("grasp_id", "scene_id", "object_id", "size_mm", "size", "setting"),
    *("object_pos", "object_quat_wxyz", "sides", "attempt", "source_ref"),
    *("hand_pos", "hand_quat_wxyz", "joints", "selected", "audit", "synth_status"),
)
"""What an import writes. `attempt` numbers the rows of a scene; nothing is known of attempts."""
_HAND = ("hand_pos", "hand_quat_wxyz")


def scenes_of(
    object_id: str, unit: float, places: Sequence[Placed], setting: Setting
) -> list[Scene]:
    """The scene of each place; poses on a table are numbered as they first appear.

    Args:
        object_id: The object.
        unit: Length of the object frame's unit in the object's files (`unit_in_file`).
        places: Where the object stands, in the order of the files.
        setting: Whether it floats or stands on a table.
    """
    numbers: dict[tuple[float, ...], int] = {}
    found = []
    for place in places:
        pose = -1
        if setting == "tabletop":
            pose = numbers.setdefault(place.quat_wxyz, len(numbers))
        found.append(Scene(object_id, size_mm(place.scale * unit), setting, pose))
    return found


def size_mm(size: float) -> int:
    """A size in metres as whole millimetres, at least one."""
    return max(1, round(1000 * size))


def joint_orders(form: Format, hands: Sequence[Hand]) -> list[NDArray[np.intp]]:
    """For each hand the place in the file of each of its joints.

    Raises:
        NotUsable: A hand has other joints than the format.
    """
    orders = []
    for hand, names in zip(hands, form.joint_names, strict=True):
        odd = sorted(set(hand.joint_names) ^ set(names))
        if odd:
            raise NotUsable(
                f"--hand: {form.name} holds joints of another hand than {hand.name} "
                f"({hand.side}); they differ in {', '.join(odd[:4])}"
            )
        orders.append(np.array([names.index(n) for n in hand.joint_names], np.intp))
    return orders


def record_rows(
    parts: Sequence[tuple[str, ForeignGrasps]],
    obj: Solid,
    hands: Sequence[Hand],
    form: Format,
    *,
    setting: Setting,
    run_fingerprint: str,
    fingerprints: Mapping[str, str],
    version: str,
) -> GraspBatch:
    """Turn the grasps of one object into rows, in the order of files and of rows in them.

    Args:
        parts: Path of a file relative to the imported folder, and its grasps.
        obj: Their object, with `unit_in_file` in its provenance.
        hands: In the order of the format's sides.
        form: The format.
        setting: What the scenes are.
        run_fingerprint: Names the run in the ids.
        fingerprints: For the header.
        version: Of this package, for the header.
    """
    header = Header(
        hands=tuple(h.header() for h in hands), fingerprints=dict(fingerprints), version=version
    )
    grasps = [g for _, g in parts]
    unit = float(obj.provenance["unit_in_file"])
    scenes = scenes_of(obj.object_id, unit, [p for g in grasps for p in placed(g)], setting)
    made = empty_columns(header, COLUMNS, len(scenes))
    made["scene_id"] = np.array([s.scene_id for s in scenes], np.str_)
    made["object_id"] = np.full(len(scenes), obj.object_id)
    made["size_mm"] = np.array([s.size_mm for s in scenes], np.int32)
    made["setting"] = np.full(len(scenes), setting)
    made["sides"][:] = [SIDES.index(h.side) for h in hands]
    made["attempt"] = _count_within(made["scene_id"])
    ids = zip(made["scene_id"].tolist(), made["attempt"].tolist(), strict=True)
    made["grasp_id"] = np.array([grasp_ids(run_fingerprint, s, [n])[0] for s, n in ids], np.str_)
    made["source_ref"] = np.array(
        [f"{name}#{row}" if g.several else name for name, g in parts for row in g.row], np.str_
    )
    size = np.concatenate([g.scale for g in grasps]) * unit
    made["size"] = size.astype(np.float32)
    parts_of_hands = _staged(grasps, hands, form)
    possible = all_possible(parts_of_hands)
    made["selected"][:], made["audit"][:] = possible, ~possible
    made["synth_status"][:] = np.where(possible, Status.OK, Status.JOINT_RANGE)
    _write_poses(made, grasps, parts_of_hands, size, obj, setting)
    for h, part in enumerate(parts_of_hands):
        made["joints"][:, h, :, : part.joints.shape[-1]] = part.joints
    for name in ("hand_pos", "hand_quat_wxyz", "joints"):
        made[name][~possible] = np.nan
    return GraspBatch(header, made)


def _staged(
    grasps: Sequence[ForeignGrasps], hands: Sequence[Hand], form: Format
) -> tuple[Staged, ...]:
    """Every stage of each hand, joints in the hand's order."""
    pos, quat = (np.concatenate([getattr(g, n) for g in grasps]) for n in _HAND)
    found = []
    for h, order in enumerate(joint_orders(form, hands)):
        joints = np.concatenate([g.joints[h] for g in grasps])[..., order]
        found.append(staged(pos[:, h], quat[:, h], joints, hands[h]))
    return tuple(found)


def _write_poses(
    made: dict[str, np.ndarray],
    grasps: Sequence[ForeignGrasps],
    hands: Sequence[Staged],
    size: FloatArray,
    obj: Solid,
    setting: Setting,
) -> None:
    def joined(name: str) -> FloatArray:
        return np.concatenate([getattr(g, name) for g in grasps])

    quat = joined("object_quat_wxyz")
    hand_pos = np.stack([hand.pos for hand in hands], axis=1)
    hand_quat = np.stack([hand.quat_wxyz for hand in hands], axis=1)
    # The file gives where the source's origin is; ours is the centre of mass.
    pos = joined("object_pos") - quat_rotate(quat, size[:, None] * obj.source_origin)
    if setting == "floating":
        back = quat_conjugate(quat)[:, None, None]
        hand_pos = quat_rotate(back, hand_pos - pos[:, None, None])
        hand_quat = quat_multiply(np.broadcast_to(back, hand_quat.shape), hand_quat)
        pos, quat = np.zeros_like(pos), np.tile([1.0, 0, 0, 0], (len(pos), 1))
    else:
        shift = pos * (1.0, 1.0, 0.0)
        pos, hand_pos = pos - shift, hand_pos - shift[:, None, None]
    made["object_pos"] = pos.astype(np.float32)
    made["object_quat_wxyz"] = quat_canonical(quat).astype(np.float32)
    made["hand_pos"] = hand_pos.astype(np.float32)
    made["hand_quat_wxyz"] = quat_canonical(hand_quat).astype(np.float32)


def _count_within(names: np.ndarray) -> NDArray[np.int32]:
    """For each name how many equal ones come before it."""
    seen: dict[str, int] = {}
    counts = np.zeros(len(names), np.int32)
    for i, name in enumerate(names.tolist()):
        counts[i] = seen.get(name, 0)
        seen[name] = counts[i] + 1
    return counts
