"""The law of contacts: the hands posed by their stored joints touch where the rows say.

Forward kinematics is that of `hand_files.contact_centres`, which shares nothing with the code that
made the grasps; distances to an object are measured on its convex pieces.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction
from bidexdata.formats.closest import distance_to_triangles
from bidexdata.formats.hand_files import contact_centres
from bidexdata.formats.row_groups import RowGroup, grasps_of
from bidexdata.formats.table_checks import read_tree
from bidexdata.frames import matrix_from_quat
from bidexdata.record import GraspBatch
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.formats.release import Release

CONTACT_GAP = 0.004
"""How far the pads' distance from the surface, as a mean square root over a grasp, may be from what
its stored energy says [m]."""
CONTACT_SLIDE = 0.001
"""Offset of a pad across its stored normal [m] up to which the stored point is its foot; near
edges the closest point is not a foot, and the distance to the solid decides."""
CONTACT_ABSOLUTE, CONTACT_RELATIVE = 0.001, 0.005
"""How much farther than the closest point the stored one may be [m, fraction of the size]: the
optimiser looks it up on a distance grid."""
GRASP_STAGE = 1
_NOT_THERE = "its contact points are not where its joints put the pads"
_COLUMNS = (
    *("size_mm", "size", "object_pos", "object_quat_wxyz", "hand_pos", "hand_quat_wxyz", "joints"),
    *("energy_distance", "contact_index", "contact_point", "contact_normal"),
)


def contacts(release: Release) -> str:
    """Pose the hands by the stored joints and compare with the stored contact points.

    Every stored point must be the closest surface point to its pad, and the pads as far from theirs as
    the grasp's stored distance energy says, which is the sum of these distances' squares.
    """
    trees = [read_tree(release, h.name, h.side) for h in release.hands]
    triangles = _Triangles(release)
    worst_gap = worst_slide = 0.0
    count = posed = 0
    for group in grasps_of(release, _COLUMNS):
        batch = group.batch
        pads = contact_offsets(batch, trees)
        distance = np.sign(pads.along) * np.hypot(pads.along, pads.slide)
        gap = np.abs(distance - pads.radius)
        stored = batch["energy_distance"].astype(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):  # rows without contacts
            stored = np.sqrt(stored / np.isfinite(gap).sum(axis=(1, 2)))
        off = np.abs(_mean_square(gap) - stored)
        group.refuse(off > CONTACT_GAP, _NOT_THERE)
        if release.has_shapes:
            _check_closest(group, pads, distance, triangles)
        worst_gap = max(worst_gap, float(np.nanmax(off, initial=0)))
        worst_slide = max(worst_slide, float(np.nanmax(pads.slide, initial=0)))
        count += len(batch)
        posed += int((batch["contact_index"] >= 0).sum())
    if not posed:
        return f"{counted(count, 'row')}, none of which states a contact"
    measured = "measured on the pieces" if release.has_shapes else "not measured, without pieces"
    return (
        f"hands of {counted(count, 'row')} posed again, with {counted(posed, 'contact point')}: how far "
        f"pads are from the surface differs by at most {1000 * worst_gap:.2f} mm from what the rows' "
        f"energies say (limit {1000 * CONTACT_GAP:g}); pads lie up to {1000 * worst_slide:.2f} mm beside "
        f"the normal of their point (beyond {1000 * CONTACT_SLIDE:g} mm the closest point was {measured})"
    )


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


def _check_closest(
    group: RowGroup, pads: PadOffsets, distance: NDArray[np.float64], triangles: _Triangles
) -> None:
    """Measure on the pieces what pads lie far across their normal, object by object."""
    batch = group.batch
    doubtful = (pads.slide > CONTACT_SLIDE) & (distance > 0)
    rows = np.flatnonzero(doubtful.any(axis=(1, 2)))
    owners = np.array(group.names.column("object_id").take(rows).to_pylist(), str)
    for object_id in np.unique(owners).tolist():
        row, side, slot = np.nonzero(doubtful[rows[owners == object_id]])
        row = rows[owners == object_id][row]
        size = batch["size"][row].astype(np.float64)
        points = pads.pad[row, side, slot] / size[:, None]  # at unit diagonal
        nearest = size * distance_to_triangles(points, triangles.of(object_id))
        excess = distance[row, side, slot] - nearest
        bad = np.flatnonzero(excess > CONTACT_ABSOLUTE + CONTACT_RELATIVE * size)
        if len(bad):
            name = group.name_of(int(row[bad[0]]))
            far = f"{1000 * excess[bad[0]]:.1f} mm from the closest"
            raise Contradiction(f"{name}: {_NOT_THERE} ({far})")


class _Triangles:
    """Triangles of an object's pieces at unit diagonal; the last object's are kept."""

    def __init__(self, release: Release):
        self._release = release
        self._last: tuple[str, NDArray[np.float64]] | None = None

    def of(self, object_id: str) -> NDArray[np.float64]:
        """Corners (f, 3, 3)."""
        if self._last is None or self._last[0] != object_id:
            pieces = self._release.load_solid(object_id).pieces
            corners = np.concatenate([piece.vertices[piece.faces] for piece in pieces])
            self._last = (object_id, corners)
        return self._last[1]


def _mean_square(gap: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean square root over the contacts of each grasp; NaN without contacts."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.sqrt(np.nanmean(gap**2, axis=(1, 2))))
