"""Laws of the single rows of a release: place, ids, flags, NaN rules, unit quaternions, limits.

Each function streams the row groups and returns what it counted, or raises `Contradiction` with
the first row that breaks the law. Where a row must lie follows from the scenes table
(`RowIndex`), so no text is kept; of a row only its id is, as eight bytes, so that one id in two
places of ten million rows is found.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction
from bidexdata.formats.figures import rows_text
from bidexdata.formats.row_groups import ID_DIGITS, RowGroup, grasps_of, id_numbers, row_groups
from bidexdata.formats.row_index import RowIndex
from bidexdata.formats.table_checks import read_tree
from bidexdata.record import Status
from bidexdata.wording import counted

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.formats.release import Release

UNIT_TOLERANCE = 1e-5
"""A unit quaternion in float32 misses length 1 by less than this [-]."""
JOINT_TOLERANCE = 1e-4
"""Joints may lie this far outside their limits [rad]: float32 and the optimiser's clamp."""
SIZE_ROUNDING = 0.51
"""Largest difference of `size` and `size_mm` [mm]: half a millimetre and float32's share."""
GRASP_STAGE = 1
_PLACE = ("scene_id", "object_id", "setting")
_CHECKED = (
    *("size_mm", "size", "selected", "audit", "object_pos", "object_quat_wxyz", "hand_pos"),
    *("hand_quat_wxyz", "joints", "contact_index", "contact_point", "contact_normal"),
)


class _Ids(NamedTuple):
    """Ids of one configuration as numbers."""

    every: NDArray[np.uint64]
    both: NDArray[np.uint64]
    """Of the rows that are selected and audit rows, sorted."""


def rows(release: Release) -> str:
    """Check place, order, ids, flags, NaN rules, padding and unit quaternions of every row."""
    ids = {c: _check_configuration(release, c) for c in release.configurations}
    for configuration, found in ids.items():
        twice = _first_repeated(found.every)
        if twice is not None:
            raise Contradiction(f"grasp {twice:016x} is there twice in {configuration}")
    first, *others = ids.values()
    for other in others:
        odd = np.setxor1d(first.both, other.both)
        if len(odd):
            raise Contradiction(
                f"grasp {int(odd[0]):016x} is a row of both configurations by its flags, and is "
                "not in both"
            )
    n = sum(len(i.every) for i in ids.values()) - sum(len(o.both) for o in others)
    if n != release.figures["n"]:
        raise Contradiction(f"{n} rows are stored, the manifest says {release.figures['n']}")
    return f"{rows_text(release.figures)} in order, finite where they must be, unit quaternions"


def joint_limits(release: Release) -> str:
    """Check every joint of every grasp against the limits in the hands' trees."""
    trees = [read_tree(release, h.name, h.side) for h in release.hands]
    count = 0
    for group in grasps_of(release, ("joints",)):
        for h, tree in enumerate(trees):
            lower, upper = np.asarray(tree["joint_lower"]), np.asarray(tree["joint_upper"])
            q = group.batch["joints"][:, h, :, : len(lower)]
            inside = (q >= lower - JOINT_TOLERANCE) & (q <= upper + JOINT_TOLERANCE)
            # The squeeze is a command: it may ask for more than the joint can give.
            bad = ~inside[:, : GRASP_STAGE + 1].all(axis=(1, 2))
            group.refuse(bad, "it has joints outside the limits")
        count += len(group.batch)
    return f"joints of {counted(count, 'row')} within limits"


def _check_configuration(release: Release, configuration: str) -> _Ids:
    every, both = [np.zeros(0, np.uint64)], [np.zeros(0, np.uint64)]
    for split in release.split_names:
        index, at = RowIndex(release, configuration, split), 0
        scenes = release.scenes.take(index.scene_rows)
        for group in row_groups(release, configuration, split, _CHECKED):
            batch, end = group.batch, at + len(group.batch)
            numbers = _check_place(scenes, index.scene_index[at:end], group)
            at = end
            group.refuse(~batch[configuration], f"it is not {configuration}")
            _check_values(group)
            every.append(numbers)
            both.append(numbers[batch["selected"] & batch["audit"]])
    return _Ids(np.concatenate(every), np.sort(np.concatenate(both)))


def _check_place(scenes: pa.Table, scene: NDArray[np.int32], group: RowGroup) -> NDArray[np.uint64]:
    """Check that rows lie where scenes.parquet says, ids rising within a scene; give the ids."""
    if len(scene) < len(group.batch):
        raise Contradiction("there are more rows than the scenes of scenes.parquet have")
    for name in _PLACE:
        expected, found = scenes.column(name).take(scene), group.names.column(name)
        wrong = _differs(found, expected)
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise Contradiction(
                f"{group.name_of(row)} is out of order: its {name} is {found[row].as_py()}, and "
                f"scenes.parquet has {expected[row].as_py()} there ({int(wrong.sum())} such rows)"
            )
    sizes = scenes.column("size_mm").to_numpy()[scene]
    group.refuse(group.batch["size_mm"] <= 0, "size_mm is not positive")
    group.refuse(group.batch["size_mm"] != sizes, "size_mm is not that of its scene")
    numbers, good = id_numbers(group.names.column("grasp_id"))
    group.refuse(~good, f"its id is not {ID_DIGITS} hexadecimal digits")
    falls = np.zeros(len(scene), bool)
    falls[1:] = (numbers[1:] <= numbers[:-1]) & (scene[1:] == scene[:-1])
    group.refuse(falls, "it is out of order or there twice")
    return numbers


def _differs(found: pa.ChunkedArray, expected: pa.ChunkedArray) -> NDArray[np.bool_]:
    import pyarrow.compute as pc

    compute: Any = pc
    return compute.fill_null(compute.not_equal(found, expected), True).to_numpy()


def _first_repeated(numbers: NDArray[np.uint64]) -> int | None:
    ordered = np.sort(numbers)
    again = np.flatnonzero(ordered[1:] == ordered[:-1])
    return int(ordered[again[0]]) if len(again) else None


def _check_values(group: RowGroup) -> None:
    batch = group.batch
    ok = batch["synth_status"] == Status.OK
    always = np.ones(len(batch), bool)
    for name, must in (("object_pos", always), ("hand_pos", ok)):
        group.refuse(must & ~_finite(batch[name]), f"{name} is not finite")
    for name, must in (("object_quat_wxyz", always), ("hand_quat_wxyz", ok)):
        group.refuse(must & ~_finite(batch[name]), f"{name} is not finite")
        length = np.linalg.norm(batch[name].astype(np.float64), axis=-1)
        off = np.abs(length - 1).reshape(len(batch), -1).max(axis=1) > UNIT_TOLERANCE
        group.refuse(must & off, f"{name} is not unit")
        negative = (batch[name][..., 0] < 0).reshape(len(batch), -1).any(axis=1)
        group.refuse(must & negative, f"{name} has w < 0")
    _check_hands(group, ok)
    apart = np.abs(1000 * batch["size"] - batch["size_mm"]) > SIZE_ROUNDING
    group.refuse(apart | ~np.isfinite(batch["size"]), "size does not round to size_mm")


def _check_hands(group: RowGroup, ok: NDArray[np.bool_]) -> None:
    batch = group.batch
    for h, hand in enumerate(batch.header.hands):
        joints, count = batch["joints"][:, h], len(hand.joint_names)
        group.refuse(ok & ~_finite(joints[..., :count]), "joints are not finite")
        padding = np.isnan(joints[..., count:]).all(axis=(1, 2))
        group.refuse(~padding, "joints past the hand's own are not NaN")
        index = batch["contact_index"][:, h]
        wrong = (index < -1) | (index >= len(hand.contact_names))
        group.refuse(wrong.any(axis=1), "contact_index names no contact point")
        used = index >= 0
        for name in ("contact_point", "contact_normal"):
            finite = np.isfinite(batch[name][:, h]).all(axis=-1)
            group.refuse(ok & (used & ~finite).any(axis=1), f"{name} is not finite")


def _finite(values: np.ndarray) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(values).reshape(len(values), -1).all(axis=1))
