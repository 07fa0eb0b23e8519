"""Laws of the rows of a release: values, order, kinematics, verdicts.

Each function returns what it counted, or raises `Contradiction` with the first row that breaks
the law.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction
from bidexdata.formats.hand_files import contact_centres
from bidexdata.formats.table_checks import read_tree
from bidexdata.formats.tables import SORTED_BY
from bidexdata.frames import matrix_from_quat
from bidexdata.record import GraspBatch, Status

if TYPE_CHECKING:
    from bidexdata.formats.release import Release
    from bidexdata.objects.prepared import Solid

UNIT_TOLERANCE = 1e-5
"""A unit quaternion in float32 misses length 1 by less than this [-]."""
JOINT_TOLERANCE = 1e-4
"""Joints may lie this far outside their limits [rad]: float32 and the optimiser's clamp."""
CONTACT_GAP = 0.01
"""Largest distance between a pad and its stored contact point [m]. Source: the start check of
protocol paper-1 uses the same 10 mm."""
CONTACT_SLIDE = 0.004
"""Largest tangential distance between a contact centre and the foot of its stored point [m]: the
stored point is the closest one on a surface sampled in float32."""
GRASP_STAGE = 1


def rows(release: Release) -> str:
    """Check order, ids, flags, NaN rules, padding and unit quaternions of every row."""
    count = 0
    for configuration in release.configurations:
        for split in release.splits:
            last: tuple = ()
            seen: set[str] = set()
            for batch in release.batches(configuration, split):
                if not len(batch):
                    continue
                last = _check_order(batch, last, seen)
                if not np.all(batch[configuration]):
                    raise Contradiction(
                        f"{_first(batch, ~batch[configuration])} is not {configuration}"
                    )
                _check_values(batch)
                count += len(batch)
    return f"{count} rows in order, finite where they must be, with unit quaternions"


def joint_limits(release: Release) -> str:
    """Check every joint of every grasp against the limits in the hands' trees."""
    trees = [read_tree(release, h.name, h.side) for h in release.hands]
    count = 0
    for batch in _ok_batches(release):
        for h, tree in enumerate(trees):
            lower, upper = np.asarray(tree["joint_lower"]), np.asarray(tree["joint_upper"])
            q = batch["joints"][:, h, :, : len(lower)]
            inside = (q >= lower - JOINT_TOLERANCE) & (q <= upper + JOINT_TOLERANCE)
            # The squeeze is a command: it may ask for more than the joint can give.
            bad = ~inside[:, : GRASP_STAGE + 1].all(axis=(1, 2))
            if bad.any():
                raise Contradiction(f"{_first(batch, bad)} has joints outside the limits")
        count += len(batch)
    return f"joints of {count} rows within limits"


def contacts(release: Release) -> str:
    """Pose the hands by the stored joints and compare with the stored contact points."""
    trees = [read_tree(release, h.name, h.side) for h in release.hands]
    worst_gap = worst_slide = 0.0
    count = 0
    for batch in _ok_batches(release):
        gap, slide = contact_errors(batch, trees)
        bad = np.nanmax(gap, axis=(1, 2), initial=0) > CONTACT_GAP
        bad |= np.nanmax(slide, axis=(1, 2), initial=0) > CONTACT_SLIDE
        if bad.any():
            raise Contradiction(
                f"{_first(batch, bad)}: its contact points are not where its joints put the pads "
                f"(gap {1000 * np.nanmax(gap[bad]):.1f} mm, slide {1000 * np.nanmax(slide[bad]):.1f} mm)"
            )
        worst_gap = max(worst_gap, float(np.nanmax(gap, initial=0)))
        worst_slide = max(worst_slide, float(np.nanmax(slide, initial=0)))
        count += len(batch)
    return (
        f"{count} rows posed again: gaps up to {1000 * worst_gap:.2f} mm, "
        f"slides up to {1000 * worst_slide:.2f} mm"
    )


def contact_errors(
    batch: GraspBatch, trees: list[dict]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distances between posed pads and stored contacts [m], each (N, H, C), NaN where padded.

    Returns:
        The gap between pad and surface along the stored normal, and the offset across it.
    """
    shape = batch["contact_index"].shape
    gap, slide = np.full(shape, np.nan), np.full(shape, np.nan)
    R_world_object = matrix_from_quat(batch["object_quat_wxyz"])
    p_world_object = batch["object_pos"].astype(np.float64)
    for h, tree in enumerate(trees):
        centres = contact_centres(tree, batch["joints"][:, h, GRASP_STAGE])
        R_world_hand = matrix_from_quat(batch["hand_quat_wxyz"][:, h, GRASP_STAGE])
        p_world_hand = batch["hand_pos"][:, h, GRASP_STAGE].astype(np.float64)
        world = centres @ np.swapaxes(R_world_hand, 1, 2) + p_world_hand[:, None]
        centre_object = (world - p_world_object[:, None]) @ R_world_object
        radius = np.asarray(tree["contact_radius"], np.float64)
        index = batch["contact_index"][:, h]
        used = index >= 0
        row, slot = np.nonzero(used)
        which = index[row, slot]
        offset = centre_object[row, which] - batch["contact_point"][row, h, slot]
        normal = batch["contact_normal"][row, h, slot].astype(np.float64)
        along = np.einsum("ki,ki->k", offset, normal)
        gap[row, h, slot] = np.abs(along - radius[which])
        slide[row, h, slot] = np.linalg.norm(offset - along[:, None] * normal, axis=1)
    return gap, slide


def verdicts(
    release: Release,
    resimulate: Callable[[Release, GraspBatch, Solid], np.ndarray],
    sample: int,
    seed: int,
) -> str:
    """Judge a random sample of tested rows again and compare with their stored verdicts."""
    index = release.index("selected", columns=["object_id", "suc_f"])
    tested = np.flatnonzero(index.column("suc_f").is_valid().to_numpy())
    rng = np.random.default_rng(seed)
    drawn = rng.choice(tested, min(sample, len(tested)), replace=False)
    owners = np.array(index.column("object_id").to_pylist())
    count = 0
    for object_id in np.unique(owners[drawn]).tolist():
        # Rows of one object are contiguous within its split.
        first = int(np.flatnonzero(owners == object_id)[0])
        mine = np.sort(drawn[owners[drawn] == object_id]) - first
        batch = release.grasps(object_id).select(mine)
        again = np.asarray(resimulate(release, batch, release.load_solid(object_id)))
        differ = again != batch["success"]
        if differ.any():
            raise Contradiction(
                f"{_first(batch, differ)} was judged {'' if again[differ][0] else 'not '}successful "
                "when simulated again"
            )
        count += len(batch)
    return f"{count} sampled rows judged again with the stored verdict"


def _ok_batches(release: Release):
    for configuration in release.configurations:
        for batch in release.batches(configuration):
            kept = batch.select(batch["synth_status"] == Status.OK)
            if len(kept):
                yield kept


def _check_order(batch: GraspBatch, last: tuple, seen: set[str]) -> tuple:
    for key in zip(*(batch[c].tolist() for c in SORTED_BY), strict=True):
        if last and key[0] != last[0]:
            seen.clear()  # ids are compared within an object: rows of one object are together
        if last and key <= last:
            raise Contradiction(f"grasp {key[-1]} of {key[2]} is out of order or there twice")
        if key[-1] in seen:
            raise Contradiction(f"grasp {key[-1]} of {key[2]} is there twice")
        seen.add(key[-1])
        last = key
    return last


def _check_values(batch: GraspBatch) -> None:
    header = batch.header
    ok = batch["synth_status"] == Status.OK
    poses = {
        "object_pos": np.ones(len(batch), bool),
        "object_quat_wxyz": np.ones(len(batch), bool),
        "hand_pos": ok,
        "hand_quat_wxyz": ok,
    }
    for name, must in poses.items():
        finite = np.isfinite(batch[name]).reshape(len(batch), -1).all(axis=1)
        _refuse(batch, must & ~finite, f"{name} is not finite")
    for name, must in (("object_quat_wxyz", poses["object_quat_wxyz"]), ("hand_quat_wxyz", ok)):
        length = np.linalg.norm(batch[name].astype(np.float64), axis=-1)
        off = np.abs(length - 1).reshape(len(batch), -1).max(axis=1) > UNIT_TOLERANCE
        _refuse(batch, must & off, f"{name} is not unit")
        negative = (batch[name][..., 0] < 0).reshape(len(batch), -1).any(axis=1)
        _refuse(batch, must & negative, f"{name} has w < 0")
    for h, hand in enumerate(header.hands):
        joints, count = batch["joints"][:, h], len(hand.joint_names)
        finite = np.isfinite(joints[..., :count]).all(axis=(1, 2))
        _refuse(batch, ok & ~finite, "joints are not finite")
        _refuse(
            batch,
            ~np.isnan(joints[..., count:]).all(axis=(1, 2)),
            "joints past the hand's own are not NaN",
        )
        index = batch["contact_index"][:, h]
        wrong = (index < -1) | (index >= len(hand.contact_names))
        _refuse(batch, wrong.any(axis=1), "contact_index names no contact point")
        used = index >= 0
        for name in ("contact_point", "contact_normal"):
            finite = np.isfinite(batch[name][:, h]).all(axis=-1)
            _refuse(batch, ok & (used & ~finite).any(axis=1), f"{name} is not finite")
    _refuse(batch, batch["size_mm"] <= 0, "size_mm is not positive")
    if "success" in batch:
        _refuse(batch, batch["success"] & ~ok, "an attempt without a grasp is marked successful")


def _refuse(batch: GraspBatch, bad: Any, text: str) -> None:
    if np.any(bad):
        raise Contradiction(f"{_first(batch, bad)}: {text} ({int(bad.sum())} such rows)")


def _first(batch: GraspBatch, bad: Any) -> str:
    at = int(np.flatnonzero(bad)[0])
    return f"grasp {batch['grasp_id'][at]} of {batch['scene_id'][at]}"
