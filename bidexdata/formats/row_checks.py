"""Laws of the rows of a release: values, order, kinematics, verdicts.

Each function returns what it counted, or raises `Contradiction` with the first row that breaks
the law.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction
from bidexdata.formats.closest import distance_to_triangles
from bidexdata.formats.figures import rows_text
from bidexdata.formats.hand_files import contact_centres
from bidexdata.formats.table_checks import read_tree
from bidexdata.formats.tables import SORTED_BY
from bidexdata.frames import matrix_from_quat
from bidexdata.record import GraspBatch, Status
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.formats.release import Release
    from bidexdata.objects.prepared import Solid

UNIT_TOLERANCE = 1e-5
"""A unit quaternion in float32 misses length 1 by less than this [-]."""
JOINT_TOLERANCE = 1e-4
"""Joints may lie this far outside their limits [rad]: float32 and the optimiser's clamp."""
CONTACT_GAP = 0.004
"""How far the pads' distance from the surface, as a mean square root over a grasp, may be from what
its stored energy says [m]."""
CONTACT_SLIDE = 0.001
"""Offset of a pad across its stored normal [m] up to which the stored point is its foot; near
edges the closest point is not a foot, and the distance to the solid decides."""
CONTACT_ABSOLUTE, CONTACT_RELATIVE = 0.001, 0.005
"""How much farther than the closest point the stored one may be [m, fraction of the size]: the
optimiser looks it up on a distance grid."""
SIZE_ROUNDING = 0.51
"""Largest difference of `size` and `size_mm` [mm]: half a millimetre and float32's share."""
GRASP_STAGE = 1
_NOT_THERE = "its contact points are not where its joints put the pads"


def rows(release: Release) -> str:
    """Check number, order, ids, flags, NaN rules, padding and unit quaternions of every row."""
    ids: set[str] = set()
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
                ids.update(batch["grasp_id"].tolist())
    if len(ids) != release.figures["n"]:
        raise Contradiction(f"{len(ids)} rows are stored, the manifest says {release.figures['n']}")
    return f"{rows_text(release.figures)} in order, finite where they must be, unit quaternions"


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
    return f"joints of {counted(count, 'row')} within limits"


def contacts(release: Release) -> str:
    """Pose the hands by the stored joints and compare with the stored contact points.

    Every stored point must be the closest surface point to its pad, and the pads as far from theirs as
    the grasp's stored distance energy says, which is the sum of these distances' squares.
    """
    trees = [read_tree(release, h.name, h.side) for h in release.hands]
    worst_gap = worst_slide = 0.0
    count = 0
    for batch in _ok_batches(release):
        pads = contact_offsets(batch, trees)
        distance = np.sign(pads.along) * np.hypot(pads.along, pads.slide)
        gap = np.abs(distance - pads.radius)
        stored = batch["energy_distance"].astype(np.float64)
        off = np.abs(_mean_square(gap) - np.sqrt(stored / np.isfinite(gap).sum(axis=(1, 2))))
        _refuse(batch, off > CONTACT_GAP, _NOT_THERE)
        doubtful = (pads.slide > CONTACT_SLIDE) & (distance > 0)
        for row in np.flatnonzero(doubtful.any(axis=(1, 2))):
            use = doubtful[row]
            size = float(batch["size"][row])
            nearest = _distance_to_solid(release, batch["object_id"][row], pads.pad[row][use], size)
            excess = float((distance[row][use] - nearest).max())
            if excess > CONTACT_ABSOLUTE + CONTACT_RELATIVE * size:
                bad = np.arange(len(batch)) == row
                raise Contradiction(
                    f"{_first(batch, bad)}: {_NOT_THERE} ({1000 * excess:.1f} mm from the closest)"
                )
        worst_gap = max(worst_gap, float(np.nanmax(off, initial=0)))
        worst_slide = max(worst_slide, float(np.nanmax(pads.slide, initial=0)))
        count += len(batch)
    return (
        f"{counted(count, 'row')} posed again: pads {1000 * worst_gap:.2f} mm from where their "
        f"energies have them (limit {1000 * CONTACT_GAP:g}), offsets across the normal up to {1000 * worst_slide:.2f} mm "
        f"(beyond {1000 * CONTACT_SLIDE:g} mm the distance was measured on the pieces)"
    )


def _mean_square(gap: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean square root over the contacts of each grasp; NaN without contacts."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.sqrt(np.nanmean(gap**2, axis=(1, 2))))


class PadOffsets(NamedTuple):
    """Where forward kinematics puts the pads of a batch; NaN where contacts are padded."""

    pad: NDArray[np.float64]
    """Centres of the contact spheres at the grasp, object frame [m], (N, H, C, 3)."""
    along: NDArray[np.float64]
    """Offset from the stored contact point along the stored outward normal [m], (N, H, C)."""
    slide: NDArray[np.float64]
    """Offset across it [m], (N, H, C)."""
    radius: NDArray[np.float64]
    """Radius of the contact sphere [m], (N, H, C)."""


def contact_offsets(batch: GraspBatch, trees: list[dict]) -> PadOffsets:
    """Pose the hands of a batch at the grasp and measure from the stored contacts."""
    shape = batch["contact_index"].shape
    found = PadOffsets(np.full((*shape, 3), np.nan), *(np.full(shape, np.nan) for _ in range(3)))
    R_world_object = matrix_from_quat(batch["object_quat_wxyz"])
    p_world_object = batch["object_pos"].astype(np.float64)
    for h, tree in enumerate(trees):
        centres = contact_centres(tree, batch["joints"][:, h, GRASP_STAGE])
        R_world_hand = matrix_from_quat(batch["hand_quat_wxyz"][:, h, GRASP_STAGE])
        p_world_hand = batch["hand_pos"][:, h, GRASP_STAGE].astype(np.float64)
        world = centres @ np.swapaxes(R_world_hand, 1, 2) + p_world_hand[:, None]
        centre_object = (world - p_world_object[:, None]) @ R_world_object
        index = batch["contact_index"][:, h]
        row, slot = np.nonzero(index >= 0)
        which = index[row, slot]
        pad = centre_object[row, which]
        offset = pad - batch["contact_point"][row, h, slot]
        normal = batch["contact_normal"][row, h, slot].astype(np.float64)
        along = np.einsum("ki,ki->k", offset, normal)
        found.pad[row, h, slot] = pad
        found.along[row, h, slot] = along
        found.slide[row, h, slot] = np.linalg.norm(offset - along[:, None] * normal, axis=1)
        found.radius[row, h, slot] = np.asarray(tree["contact_radius"], np.float64)[which]
    return found


def _distance_to_solid(
    release: Release, object_id: str, points: NDArray[np.float64], size: float
) -> NDArray[np.float64]:
    """Distance from points outside to the union of the pieces at a size [m], (n,)."""
    solid = release.load_solid(str(object_id))
    triangles = np.concatenate([piece.vertices[piece.faces] for piece in solid.pieces])
    return distance_to_triangles(points, triangles * size)


def verdicts(
    release: Release,
    resimulate: Callable[[Release, GraspBatch, Solid], np.ndarray],
    sample: int,
    seed: int,
) -> str:
    """Judge a random sample of tested rows again and compare with their stored verdicts."""
    name = release.default_protocol
    engine = release.protocol_settings.get(name, {}).get("engine")
    if engine is not None:  # its last digits vary from run to run
        words = ", ".join(f"{key} {value}" for key, value in engine.items())
        return f"not judged again, for {name} is not MuJoCo's C engine ({words})"
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
    apart = np.abs(1000 * batch["size"] - batch["size_mm"]) > SIZE_ROUNDING
    _refuse(batch, apart | ~np.isfinite(batch["size"]), "size does not round to size_mm")
    if "success" in batch:
        _refuse(batch, batch["success"] & ~ok, "an attempt without a grasp is marked successful")


def _refuse(batch: GraspBatch, bad: Any, text: str) -> None:
    if np.any(bad):
        raise Contradiction(f"{_first(batch, bad)}: {text} ({int(bad.sum())} such rows)")


def _first(batch: GraspBatch, bad: Any) -> str:
    at = int(np.flatnonzero(bad)[0])
    return f"grasp {batch['grasp_id'][at]} of {batch['scene_id'][at]}"
