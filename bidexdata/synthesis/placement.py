"""Where the hands start: palms facing their regions from outside the dilated convex hull.

A hand hangs over the point of the hull that is nearest to its region, palm normal against the
hull's, so far out that its lowest fingertip and all its spheres are clear of the hull. The object
lies inside its hull, so no start touches it. On a table, fingers point down rather than up, and a
hand that would reach into the table is moved up along the hull, as far as it may. Starts in which
the hands meet each other or the table are drawn anew, and so are those that the arms of a rig cannot
bring the hands to, where there is one.

Source: BiDexGrasp 4.2 and appendix B; distances and spreads are ours (the paper gives none).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bidexdata import frames
from bidexdata.config import refuse_outside
from bidexdata.errors import BadConfig
from bidexdata.hands.contact_sets import ContactSet
from bidexdata.hands.model import Hand
from bidexdata.objects.prepared import PreparedObject
from bidexdata.record.scene import Scene
from bidexdata.synthesis.placement_shapes import (
    StartShape,
    hands_apart,
    roll_from_down,
    start_shapes,
    tangent_frames,
)
from bidexdata.synthesis.pose import Pose
from bidexdata.synthesis.regions import RegionPairs
from bidexdata.synthesis.regions_build import hull_depth
from bidexdata.synthesis.table import raise_hands, table_plane

if TYPE_CHECKING:
    from bidexdata.arms.reach import Reach

# Numbers that one hand's start draws: roll, tilt angle, tilt direction, two shifts; and where
# within its region it hangs, if that is drawn: which point, and how far towards it.
_DRAWS = 5
_PLACE_DRAWS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementConfig:
    """How palms start. "Measurements, n" is docs/measurements.md, section n."""

    contacts: tuple[ContactSet, ...] = ("fingertips", "with_palm")
    """What the hands touch with: `fingertips` (paper), `pads` (fingertips and the links behind them)
    or `with_palm` (fingertips and places of the palm). Attempts take several in turn.
    Measurements, 18."""
    table_contacts: tuple[ContactSet, ...] = ("fingertips",)
    """The same on a table, where palms meet it before they meet the object. Measurements, 18."""
    pairs: int = 40
    """Best region pairs that attempts take in turn. Paper 4.2: all K_r = 40.
    Measurements, 2: ranks 1-8 succeed in 91 %, ranks 9-12 in 85 %."""
    standoff: float = 0.02
    """Lowest contact sphere to the hull [m]. Measurements, 4."""
    clearance: float = 0.005
    """Every collision sphere to the hull, to the table and to the other hand [m]. The margin
    between hands of measurements, 4."""
    over: Literal["contacts", "palm"] = "contacts"
    """What hangs over the hull point: the middle of the contact points, or the palm. Ours; the
    paper has the palm."""
    repeats: Literal["centre", "region"] = "centre"
    """Where a pair's attempts after its first start. `centre`: over the region's centre again, so
    that roll, tilt and shift alone tell them apart. `region`: over a point drawn within the region
    (paper 4.2: initial poses are sampled within the regions). Ours: the paper does not say how the
    20 grasps of a world differ."""
    roll: float = pi
    """Largest turn about the palm normal from the preferred direction [rad]: pi is any roll.
    Measurements, 2: no effect on success; the paper has 0, the preferred direction."""
    table_fingers: Literal["down", "preferred"] = "down"
    """Where the fingers point on a table. `down`: within `table_roll` of straight down, so that the
    arms come from above; a palm that faces down has any roll. `preferred`: as when
    floating. Ours; the paper has one direction for each hand."""
    table_roll: float = pi / 2
    """Largest turn from fingers down [rad]. Ours."""
    table_raise: float = 0.06
    """Farthest way along the hull that a hand is moved up to clear the table [m]. Ours."""
    left_direction: tuple[float, float, float] = (1.0, -1.0, -1.0)
    """Preferred direction of the left hand's fingers in the world. Paper, appendix B."""
    right_direction: tuple[float, float, float] = (1.0, 1.0, -1.0)
    """The same for the right hand. Paper, appendix B."""
    tilt: float = pi / 36
    """Largest angle between palm normal and inward hull normal [rad], 5 degrees. Measurements,
    4."""
    shift: float = 0.015
    """Largest shift along each palm axis [m]. Measurements, 4."""
    flat: float = 0.02
    """Regions with V below this start with the open posture. Measurements, 4; paper, appendix B:
    0.005."""
    draws: int = 8
    """Draws per attempt before it counts as not placeable. Ours."""

    def __post_init__(self) -> None:
        for name in ("contacts", "table_contacts"):
            sets = getattr(self, name)
            if not sets or len(set(sets)) != len(sets):
                raise BadConfig(f"PlacementConfig.{name} must name contact sets, each once")
        refuse_outside(self, "pairs", 1, 100_000)
        for name in ("standoff", "clearance", "table_raise", "shift"):
            refuse_outside(self, name, 0.0, 1.0)
        for name in ("roll", "table_roll"):
            refuse_outside(self, name, 0.0, pi)
        refuse_outside(self, "tilt", 0.0, pi / 4)
        refuse_outside(self, "flat", 0.0, 2.0)
        refuse_outside(self, "draws", 1, 1000)
        for name in ("left_direction", "right_direction"):
            if not np.linalg.norm(getattr(self, name)) > 0:
                raise BadConfig(f"PlacementConfig.{name} must not be the zero vector")


class Placement(NamedTuple):
    """Starts of M attempts; object frame."""

    pair_index: Int[np.ndarray, " M"]
    """Region pair of each attempt."""
    hand_pos: Float[np.ndarray, "M 2 3"]
    """Origins of the hand frames [m]."""
    hand_quat: Float[np.ndarray, "M 2 4"]
    """Their orientations, wxyz."""
    joints: Float[np.ndarray, "M 2 J"]
    """Start postures [rad]; the shorter hand's rows end in NaN."""
    ok: Bool[np.ndarray, " M"]
    """Clear of each other and of the table; the poses of the others are their last draw."""
    above: Bool[np.ndarray, " M"]
    """Whether the draw that is given is clear of the table."""
    reachable: Bool[np.ndarray, " M"]
    """False where draws were clear of all, and arms could bring the hands to none of them."""


def place_palms(
    obj: PreparedObject,
    hands: Sequence[Hand],
    scene: Scene,
    pairs: RegionPairs,
    config: PlacementConfig,
    rng: np.random.Generator,
    count: int,
    *,
    grown: bool = False,
    kind: tuple[int, int] = (0, 1),
    reach: Reach | None = None,
) -> Placement:
    """Place both hands for `count` attempts, which take the region pairs in turn.

    An attempt's draws do not depend on how many attempts follow it, nor on whether there are arms.

    Args:
        obj: Gives the hull.
        hands: (left, right).
        scene: Size, pose and setting.
        pairs: At least one region pair, object frame.
        config: Distances and spreads.
        rng: Draws `config.draws` variations of every attempt, used or not.
        count: M, of all kinds together.
        grown: Earlier attempts of the scene exist, so every pair may have had its first.
        kind: (k, n): of `count` attempts only every n-th from the k-th on, when n kinds of attempts
            take turns; each kind then takes the pairs in their order.
        reach: Arms that must be able to bring the hands there; any place will do without.
    """
    used = min(len(pairs.score), config.pairs)
    draws = _DRAWS + (_PLACE_DRAWS if config.repeats == "region" else 0)
    lots = rng.random((count, config.draws, 2, draws))[kind[0] :: kind[1]]
    count = len(lots)
    pair_index = np.arange(count) % used
    first = (np.arange(count) < used) & (not grown)
    places = _places(pairs, pair_index, first, lots[..., _DRAWS:])
    depth, normal = hull_depth(obj, scene.size, places.reshape(-1, 3))
    normal = normal.reshape(places.shape)
    over = places + depth.reshape(*places.shape[:-1], 1) * normal
    flat = pairs.flatness[pair_index] < config.flat
    shapes = [start_shapes(hand, config.over) for hand in hands]

    pos, quat = np.zeros((count, 2, 3)), np.zeros((count, 2, 4))
    ok, above, reachable = np.zeros(count, bool), np.ones(count, bool), np.ones(count, bool)
    on_table, plane = scene.setting == "tabletop", table_plane(scene)
    todo = np.arange(count)
    for draw in range(config.draws):
        spheres: list[list[np.ndarray]] = [[], []]
        place = min(draw, places.shape[1] - 1)
        free = np.ones(len(todo), bool)
        for h in range(2):
            direction = _preferred(scene, config, h)
            drawn = scaled_variation(lots[todo, draw, h, :_DRAWS], config, mirrored=h == 0)
            if on_table and config.table_fingers == "down":
                turn = drawn.share * config.table_roll
                palms = (normal[todo, place, h], direction, -plane[:3])
                drawn = drawn._replace(roll=roll_from_down(turn, drawn.roll, *palms))
            p, R, balls = hang_hand(
                shapes[h],
                flat[todo, h],
                over[todo, place, h],
                normal[todo, place, h],
                direction,
                drawn,
                config,
            )
            radius = shapes[h][0].sphere_radius
            if on_table:
                clear = (config.clearance, config.table_raise)
                raised = raise_hands(balls, radius, normal[todo, place, h], plane, *clear)
                p, balls = p + raised.shift, balls + raised.shift[:, None]
                free &= raised.ok
            pos[todo, h], quat[todo, h] = p, frames.quat_from_matrix(R)
            spheres[h] = [balls, radius]
        above[todo] = free
        free = free & hands_apart(spheres[0], spheres[1], config.clearance)
        if reach is not None:
            clear = todo[free]
            reached = _reached(reach, scene, pos[clear], quat[clear])
            free[free], reachable[clear] = reached, reached
        ok[todo[free]] = True
        todo = todo[~free]
        if not len(todo):
            break
    postures = _postures(hands, shapes, flat)
    return Placement(pair_index, pos, quat, postures, ok, above, reachable)


def _reached(
    reach: Reach,
    scene: Scene,
    pos: Float[np.ndarray, "n 2 3"],
    quat: Float[np.ndarray, "n 2 4"],
) -> Bool[np.ndarray, " n"]:
    """Tell which starts arms can bring the hands to; poses in the object frame."""
    none = np.zeros((len(pos), 0))
    world = Pose(pos, quat, (none, none)).moved(
        np.array(scene.object_pos), np.array(scene.object_quat_wxyz)
    )
    return reach.placements(scene, world.position, world.quat_wxyz)


def interleaved(turns: Sequence[Placement]) -> Placement:
    """Put placements that took turns back into the order of their attempts."""
    count, n = sum(len(one.ok) for one in turns), len(turns)
    columns = []
    for parts in zip(*turns, strict=True):
        column = np.empty((count, *parts[0].shape[1:]), parts[0].dtype)
        for k, part in enumerate(parts):
            column[k::n] = part
        columns.append(column)
    return Placement(*columns)


def _places(
    pairs: RegionPairs,
    pair_index: Int[np.ndarray, " M"],
    first: Bool[np.ndarray, " M"],
    lots: Float[np.ndarray, "M d 2 n"],
) -> Float[np.ndarray, "M p 2 3"]:
    """Points of the object that the hands hang over in each draw [m], one draw where all are alike.

    Args:
        pairs: Gives the regions.
        pair_index: Region pair of each attempt.
        first: Attempts that take the regions' centres.
        lots: Which of a region's points, and how far from the centre to it; n = 0 where every
            attempt takes the centres.
    """
    centre = pairs.centres[pair_index][:, None]
    if lots.shape[-1] == 0:
        return centre
    which = (lots[..., 0] * pairs.points.shape[2]).astype(np.int64)
    point = pairs.points[pair_index[:, None, None], np.arange(2), which]
    drawn = centre + lots[..., 1:] * (point - centre)
    return np.where(first[:, None, None, None], centre, drawn)


class Variation(NamedTuple):
    """What one start draws; in the palm frame."""

    share: Float[np.ndarray, " n"]
    """Of the largest roll, -1 to 1."""
    roll: Float[np.ndarray, " n"]
    """About the palm normal [rad]."""
    tilt: Float[np.ndarray, "n 3"]
    """Rotation vector in the palm's plane [rad]."""
    shift: Float[np.ndarray, "n 2"]
    """Along the palm's x and y [m]."""


def scaled_variation(
    lots: Float[np.ndarray, "n 5"], config: PlacementConfig, *, mirrored: bool
) -> Variation:
    """Scale uniform numbers; the left hand gets the mirror image (y -> -y) of the right's."""
    side = -1.0 if mirrored else 1.0
    angle, heading = config.tilt * lots[:, 1], 2.0 * pi * lots[:, 2]
    # A rotation vector is axial: the reflection turns its part in the mirror plane (x, z).
    tilt = np.stack(
        [side * angle * np.cos(heading), angle * np.sin(heading), np.zeros_like(angle)], axis=1
    )
    shift = config.shift * (2.0 * lots[:, 3:5] - 1.0) * np.array([1.0, side])
    share = 2.0 * lots[:, 0] - 1.0
    return Variation(side * share, side * config.roll * share, tilt, shift)


class HungHand(NamedTuple):
    """Where a hand hangs in n starts, object frame."""

    pos: Float[np.ndarray, "n 3"]
    """[m]."""
    R: Float[np.ndarray, "n 3 3"]
    spheres: Float[np.ndarray, "n K 3"]
    """Centres of its collision spheres [m]."""


def hang_hand(
    shapes: tuple[StartShape, StartShape],
    flat: Bool[np.ndarray, " n"],
    over: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
    direction: Float[np.ndarray, " 3"],
    drawn: Variation,
    config: PlacementConfig,
) -> HungHand:
    """Hang one hand over hull points.

    Args:
        shapes: The hand in its open and in its curved posture, palm frame.
        flat: Which starts take the open posture.
        over: Hull points [m].
        normal: Outward hull normals there.
        direction: Preferred direction of the fingers, object frame.
        drawn: Variations.
        config: Distances.
    """
    pick = np.where(flat, 0, 1)
    contacts = np.stack([s.contacts for s in shapes])[pick]
    balls = np.stack([s.spheres for s in shapes])[pick]
    middle = np.stack([s.middle for s in shapes])[pick]
    turn = np.zeros((len(flat), 3))
    turn[:, 2] = drawn.roll
    variation = frames.quat_multiply(
        frames.quat_from_rotation_vector(turn), frames.quat_from_rotation_vector(drawn.tilt)
    )
    R = tangent_frames(-normal, direction) @ frames.matrix_from_quat(variation)
    # Heights over the hull's supporting plane, with the palm's origin in that plane.
    up = np.einsum("nij,ni->nj", R, normal)
    tips = np.einsum("nci,ni->nc", contacts, up) - shapes[0].contact_radius
    lowest = np.einsum("nki,ni->nk", balls, up) - shapes[0].sphere_radius
    lift = np.maximum(config.standoff - tips.min(axis=1), config.clearance - lowest.min(axis=1))
    # The middle comes to lie over the hull point, up to the shift; its height is free.
    sideways = np.einsum("nij,nj->ni", R, np.pad(drawn.shift, ((0, 0), (0, 1))) - middle)
    sideways -= np.einsum("ni,ni->n", sideways, normal)[:, None] * normal
    palm = over + sideways + lift[:, None] * normal
    spheres = balls @ np.swapaxes(R, -1, -2) + palm[:, None]
    T_palm_hand = shapes[0].T_palm_hand
    return HungHand(palm + R @ T_palm_hand[:3, 3], R @ T_palm_hand[:3, :3], spheres)


def _preferred(scene: Scene, config: PlacementConfig, side: int) -> Float[np.ndarray, " 3"]:
    """Preferred direction of a side's fingers in the object frame, unit length."""
    world = np.array(config.left_direction if side == 0 else config.right_direction)
    to_object = frames.quat_conjugate(np.array(scene.object_quat_wxyz))
    return frames.quat_rotate(to_object, world / np.linalg.norm(world))


def _postures(
    hands: Sequence[Hand],
    shapes: list[tuple[StartShape, StartShape]],
    flat: Bool[np.ndarray, "M 2"],
) -> Float[np.ndarray, "M 2 J"]:
    """Start joints of every attempt [rad]."""
    widest = max(len(hand.joint_names) for hand in hands)
    joints = np.full((len(flat), 2, widest), np.nan)
    for h, (open_, curved) in enumerate(shapes):
        own = np.where(flat[:, h, None], open_.joints, curved.joints)
        joints[:, h, : own.shape[1]] = own
    return joints
