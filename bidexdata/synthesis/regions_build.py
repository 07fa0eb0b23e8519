"""Regions around anchors: their points, normals, contacts, flatness and accessibility."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bidexdata.devices import start_warp
from bidexdata.objects.prepared import PreparedObject
from bidexdata.synthesis.table import reachable_regions, touchable_points

if TYPE_CHECKING:
    from bidexdata.synthesis.regions import RegionConfig

LAST_ANCHOR = np.iinfo(np.int16).max
"""Highest number that an anchor may have among the surface points: `region_id` is int16."""


class Regions(NamedTuple):
    """A regions of k points each, object frame, metric; normals point out."""

    anchors: Int[np.ndarray, " A"]
    """Numbers of the anchors among the object's surface points."""
    anchor_points: Float[np.ndarray, "A 3"]
    """[m]."""
    anchor_normals: Float[np.ndarray, "A 3"]
    points: Float[np.ndarray, "A k 3"]
    """Farthest-point order; regions with fewer points repeat theirs [m]."""
    normals: Float[np.ndarray, "A k 3"]
    mean_normals: Float[np.ndarray, "A 3"]
    """Unit length."""
    reach: Float[np.ndarray, " A"]
    """Distance of the region's farthest point from its anchor [m]."""
    contact_points: Float[np.ndarray, "A S C 3"]
    """S sets of C, drawn from the region for the scores [m]."""
    contact_normals: Float[np.ndarray, "A S C 3"]
    """Outward."""


def build_regions(
    obj: PreparedObject,
    size: float,
    config: RegionConfig,
    rng: np.random.Generator,
    *,
    table: Float[np.ndarray, " 4"] | None = None,
    device: str = "cpu",
) -> Regions:
    """Make one region around each of the first surface points; none where no point can be touched.

    A region takes the first k points of the object's farthest-point order that lie within the
    radius and on the same sheet, which spreads them evenly over it.

    Args:
        obj: The object; its surface points must be in farthest-point order.
        size: Bounding-box diagonal [m].
        config: Numbers.
        rng: Draws the contacts.
        table: The plane under the object, in its frame; points that no fingertip can touch above
            it are left out, which keeps the order of the others.
        device: Warp device.

    Source:
        BiDexGrasp 4.2, step 1.
    """
    points = np.ascontiguousarray(obj.surface_points * np.float32(size))
    normals = np.ascontiguousarray(obj.surface_normals)
    number = np.arange(len(points))
    if table is not None:
        number = number[touchable_points(points, normals, table, config.table_fingertip)]
        points, normals = points[number], normals[number]
    count = min(config.anchors, int(np.searchsorted(number, LAST_ANCHOR, side="right")))
    index, filled = _members(points, normals, count, config, device)
    members, member_normals = (np.take(values, index, axis=0) for values in (points, normals))
    mean = member_normals.mean(axis=1, dtype=np.float64)
    length = np.linalg.norm(mean, axis=-1, keepdims=True)
    # Normals may cancel on a needle's tip; the anchor's own normal stands in there.
    mean = np.where(length > 1e-6, mean / np.maximum(length, 1e-6), normals[:count])
    offset = members - points[:count, None]
    places = _draw(filled, config.sets * config.contacts, rng)
    drawn = np.take_along_axis(index, places, axis=1).reshape(count, config.sets, config.contacts)
    return Regions(
        anchors=number[:count],
        anchor_points=points[:count].astype(np.float64),
        anchor_normals=normals[:count].astype(np.float64),
        points=members,
        normals=member_normals,
        mean_normals=mean,
        reach=np.sqrt(np.einsum("aki,aki->ak", offset, offset).max(axis=1)),
        contact_points=points[drawn],
        contact_normals=normals[drawn],
    )


def flatness(normals: Float[np.ndarray, "*b k 3"]) -> Float[np.ndarray, "*b"]:
    """Give the angular variance V = 2 (1 - |mean unit normal|) of regions.

    Source:
        BiDexGrasp, appendix B.
    """
    mean = normals.mean(axis=-2, dtype=np.float64)
    return np.asarray(2.0 * (1.0 - np.linalg.norm(mean, axis=-1)))


def accessible_anchors(
    obj: PreparedObject,
    size: float,
    regions: Regions,
    config: RegionConfig,
    *,
    table: Float[np.ndarray, " 4"] | None = None,
) -> Bool[np.ndarray, " A"]:
    """Tell which regions a palm outside the convex hull, and above the table, can reach.

    The anchor lies close below the hull, and the region faces the same way as the hull there.
    """
    depth, hull_normal = hull_depth(obj, size, regions.anchor_points)
    facing = np.einsum("ai,ai->a", regions.mean_normals, hull_normal)
    usable = (depth <= config.depth) & (facing > config.facing)
    above = np.ones(len(depth), bool)
    if table is not None:
        above = reachable_regions(regions.anchor_points, hull_normal, table, config.table_reach)
    usable &= above
    if usable.sum() < config.least_accessible:
        nearest = np.argsort(np.where(above, depth, np.inf), kind="stable")
        usable[nearest[: min(config.least_accessible, above.sum())]] = True
    return usable


def hull_depth(
    obj: PreparedObject, size: float, points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Measure how deep points of the object lie below its hull [m], and the nearest face's normal.

    For a point inside a convex body the nearest boundary point lies on the nearest face plane.
    """
    normals, offsets = hull_planes(obj)
    depth = offsets * size - np.asarray(points, np.float64) @ normals.T
    nearest = np.argmin(depth, axis=1)
    return depth[np.arange(len(points)), nearest], normals[nearest]


def hull_planes(obj: PreparedObject) -> tuple[Float[np.ndarray, "F 3"], Float[np.ndarray, " F"]]:
    """Give the hull's face planes: outward unit normals and offsets n . x, unit diagonal."""
    corners = obj.hull.vertices[obj.hull.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice_area = np.linalg.norm(cross, axis=-1)
    # Slivers have no reliable normal; their neighbours bound the hull.
    solid = twice_area > 1e-9
    normals = cross[solid] / twice_area[solid, None]
    return normals, np.einsum("fi,fi->f", normals, corners[solid, 0])


def _members(
    points: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    count: int,
    config: RegionConfig,
    device: str,
) -> tuple[Int[np.ndarray, "A k"], Int[np.ndarray, " A"]]:
    """List the points of each region, and how many of its k places hold different points."""
    import warp as wp

    from bidexdata.synthesis.regions_kernels import region_members_kernel

    start_warp()
    members = wp.empty((count, config.points), dtype=int, device=device)
    filled = wp.empty(count, dtype=int, device=device)
    wp.launch(
        region_members_kernel,
        dim=count,
        inputs=[
            wp.array(points, dtype=wp.vec3, device=device),
            wp.array(normals, dtype=wp.vec3, device=device),
            config.radius,
            config.same_side,
        ],
        outputs=[members, filled],
        device=device,
    )
    return members.numpy(), filled.numpy()


def _draw(
    filled: Int[np.ndarray, " A"], contacts: int, rng: np.random.Generator
) -> Int[np.ndarray, "A C"]:
    """Draw places of each region without repetition where it holds enough points."""
    lot = rng.random((len(filled), int(filled.max(initial=1))), np.float32)
    place = np.arange(lot.shape[1])
    lot[place[None] >= filled[:, None]] = 2.0
    # Positive floats are ordered as their bits are; the place behind them decides between equals.
    key = (lot.view(np.uint32).astype(np.uint64) << 32) | place.astype(np.uint64)
    if contacts < lot.shape[1]:
        key = np.partition(key, contacts, axis=1)[:, :contacts]
    order = (np.sort(key, axis=1) & 0xFFFFFFFF).astype(np.int64)
    return np.take_along_axis(order, np.arange(contacts)[None] % filled[:, None], axis=1)
