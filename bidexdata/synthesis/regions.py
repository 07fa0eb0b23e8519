"""Region pairs: where on the object the two hands may grasp with a chance to hold it.

Everything is metric, in the object frame. Anchors are the object's first farthest-point samples; a
region is what a hand can reach around its anchor. Pairs that are far enough apart and accessible
are scored by what the contacts of two hands on them could resist.

Source: BiDexGrasp 4.2 and appendix B. The torque score is ours: positions do not enter the paper's
score, so it cannot tell facing regions from shifted ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata import frames
from bidexdata.config import refuse_outside
from bidexdata.objects.prepared import PreparedObject
from bidexdata.record.scene import Scene
from bidexdata.synthesis.optimise_config import ClosureConfig
from bidexdata.synthesis.regions_build import (
    LAST_ANCHOR,
    accessible_anchors,
    build_regions,
    flatness,
)
from bidexdata.synthesis.regions_gap import PairFilter
from bidexdata.synthesis.regions_rank import diverse, force_order, random_order, torque_order
from bidexdata.synthesis.table import table_plane
from bidexdata.wrench.qp import QPConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class RegionConfig:
    """Which regions are made, which pairs are allowed and how they are ranked.

    "Measurements, n" is docs/measurements.md, section n, on 13 meshes at three sizes; lengths given
    there as shares of the longest side of the bounding box are so here too.
    """

    anchors: int = 200
    """Regions per object. Paper 4.2, K_a."""
    radius: float = 0.08
    """Farthest point of a region from its anchor [m]. Paper 4.2."""
    points: int = 256
    """Points per region, at most as many different ones as the object has within the radius.
    Paper 4.2, k."""
    contacts: int = 5
    """Contacts drawn per region for the score; fewer where a hand has fewer contact points.
    Paper 4.2, N."""
    same_side: float = -0.2
    """Points whose normal has a smaller cosine with the anchor's normal belong to the other sheet
    of a thin wall and are left out [-]; below -1 none are. Measurements, 2."""
    gap: float = 0.05
    """Least distance between the points of two regions [m]. Paper, appendix B, tau_2."""
    wide: float = 0.55
    """Anchors this far apart are accepted whatever the gap, so that small objects have pairs; share
    of the object's longest side [-]. Measurements, 2; on objects over 0.38 m it changes nothing."""
    depth: float = 0.03
    """Deepest accessible anchor below the convex hull [m]. Measurements, 2."""
    facing: float = 0.6
    """Least cosine between a region's mean normal and the hull's normal [-]; below -1 any will do.
    Measurements, 2."""
    least_accessible: int = 40
    """If fewer anchors are accessible, those closest to the hull are taken. Measurements, 2."""
    table_reach: float = 0.08
    """On a table, regions are left out where a palm this far along the hull's normal would be below
    it [m]: how far the back of a hand stands off. Ours."""
    table_fingertip: float = 0.010
    """On a table, points are left out that a ball of this radius cannot touch above it [m]: a
    fingertip of 8 mm and the distance it keeps. Ours."""
    score: Literal["random", "force", "torque"] = "torque"
    """`force`: the paper's score. `torque`: those best by force and as many random ones, ranked by
    the residual of the coupled contact QP, torques included. Measurements, 2: success of unselected
    grasps is 45 % by lot, 67 % by `force`, 86 % by `torque`."""
    force_friction: float = 0.3
    """Friction coefficient of the force score [-]. Measurements, 4; the paper gives none."""
    reranked: int = 400
    """Pairs best by force, and as many random ones, for the torque score. Measurements, 4."""
    sets: int = 6
    """Contacts are drawn so many times per region, and scores are means over the draws [-].
    Measurements, 14; the paper draws once."""
    refined: int = 160
    """Pairs, best by the first draw, whose torque score is the mean over all draws [-]. Ours: four
    times as many as are kept, since the QPs of all pairs would take most of the time."""
    disturbances: Literal["forces", "zero"] = "zero"
    """What the QP of the torque score balances: six unit forces, or nothing but the hands' own
    pressure, which is one QP in place of six. Measurements, 14, beside six draws."""
    iterations: int = 40
    """QP steps per pair of the torque score. Measurements, 2: ranks like 1500 (0.99)."""
    qp: QPConfig = field(default_factory=QPConfig)
    """The QP of the torque score."""
    diversity: float = 0.12
    """Two kept pairs have one anchor at least this far apart; share of the longest side [-].
    Measurements, 4."""
    kept: int = 40
    """Pairs kept. Paper 4.2, K_r."""
    sides: Literal["preferred", "table", "random"] = "table"
    """Which hand gets which region. `preferred`: the left hand the one farther to the left (world
    +y), so that arms in front of the robot do not cross. `random`: by lot. `table`: preferred on a
    table, by lot when floating, where no arm crosses. Measurements, 15."""

    def __post_init__(self) -> None:
        refuse_outside(self, "anchors", 2, LAST_ANCHOR)
        refuse_outside(self, "radius", 1e-3, 1.0)
        refuse_outside(self, "contacts", 1, 64)
        for name in ("points", "kept"):
            refuse_outside(self, name, 1, 100_000)
        for name in ("same_side", "facing"):
            refuse_outside(self, name, -2.0, 1.0)
        for name in ("gap", "table_reach"):
            refuse_outside(self, name, 0.0, 1.0)
        for name in ("wide", "depth", "force_friction", "diversity"):
            refuse_outside(self, name, 0.0, 10.0)
        refuse_outside(self, "table_fingertip", 0.0, 0.1)
        refuse_outside(self, "least_accessible", 2, 100_000)
        refuse_outside(self, "reranked", 1, 10_000_000)
        refuse_outside(self, "refined", 0, 10_000_000)
        refuse_outside(self, "sets", 1, 1000)
        refuse_outside(self, "iterations", 0, 100_000)


class RegionPairs(NamedTuple):
    """R region pairs, best first; side 0 is the left hand's region. Object frame, metric."""

    anchors: Int[np.ndarray, "R 2"]
    """Indices of the anchors among the object's surface points."""
    points: Float[np.ndarray, "R 2 k 3"]
    """The regions' points [m]; regions with fewer repeat theirs."""
    normals: Float[np.ndarray, "R 2 k 3"]
    """Outward unit normals at `points`."""
    centres: Float[np.ndarray, "R 2 3"]
    """The anchors [m]."""
    mean_normals: Float[np.ndarray, "R 2 3"]
    """Mean outward normals, unit length."""
    flatness: Float[np.ndarray, "R 2"]
    """V = 2 (1 - |mean unit normal|): 0 for a plane."""
    score: Float[np.ndarray, " R"]
    """Best first: the force score [caps], or minus the QP residual of the torque score."""


def no_pairs() -> RegionPairs:
    """Give the region pairs of a method that has no regions."""
    none, vectors = np.zeros((0, 2)), np.zeros((0, 2, 3))
    return RegionPairs(
        anchors=none.astype(int),
        points=vectors[:, :, None],
        normals=vectors[:, :, None],
        centres=vectors,
        mean_normals=vectors,
        flatness=none,
        score=none[:, 0],
    )


def select_region_pairs(
    obj: PreparedObject,
    scene: Scene,
    config: RegionConfig,
    rng: np.random.Generator,
    *,
    closure: ClosureConfig | None = None,
    device: str = "cpu",
) -> RegionPairs:
    """Choose the region pairs of one scene; empty when no two regions are allowed together.

    Args:
        obj: The object; its surface points must be in farthest-point order.
        scene: Gives the size, the pose that decides what left means, and the table.
        config: Numbers and the score.
        rng: Draws contacts, random pairs and random sides.
        closure: Gives the torque length of the torque score; the default one when omitted.
        device: Warp device.
    """
    size = scene.size
    table = table_plane(scene) if scene.setting == "tabletop" else None
    regions = build_regions(obj, size, config, rng, table=table, device=device)
    longest = obj.longest_side * size
    usable = accessible_anchors(obj, size, regions, config, table=table)
    allowed = PairFilter(regions, usable, config.gap, config.wide * longest, device=device)

    if config.score == "random":
        pairs, score = random_order(allowed, 8 * config.kept, rng)
    elif config.score == "force":
        pairs, score = force_order(regions, allowed, 8 * config.kept, config.force_friction)
    else:
        length = float((closure or ClosureConfig()).torque_lengths(np.array(longest)))
        pairs, score = torque_order(regions, allowed, config, length, rng, device=device)

    keep = diverse(regions.anchor_points, pairs, config.diversity * longest, config.kept)
    pairs = _assign_sides(pairs[keep], regions.anchor_points, scene, config.sides, rng)
    return RegionPairs(
        anchors=regions.anchors[pairs],
        points=regions.points[pairs],
        normals=regions.normals[pairs],
        centres=regions.anchor_points[pairs],
        mean_normals=regions.mean_normals[pairs],
        flatness=flatness(regions.normals[pairs]),
        score=score[keep],
    )


def _assign_sides(
    pairs: Int[np.ndarray, "R 2"],
    anchors: Float[np.ndarray, "A 3"],
    scene: Scene,
    sides: str,
    rng: np.random.Generator,
) -> Int[np.ndarray, "R 2"]:
    """Order each pair (left, right)."""
    if sides == "random" or (sides == "table" and scene.setting == "floating"):
        swap = rng.random(len(pairs)) < 0.5
    else:
        left_of = frames.quat_rotate(np.array(scene.object_quat_wxyz), anchors)[:, 1]
        swap = left_of[pairs[:, 0]] < left_of[pairs[:, 1]]
    return np.where(swap[:, None], pairs[:, ::-1], pairs)
