"""Where BODex's hands start: over drawn points of a dilated hull, palms towards the object.

Each hand draws for itself, as in BimanBODex. Source: BODex, task configuration of the seeds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata import frames
from bidexdata.hands.kinematics import hand_points
from bidexdata.record import Scene, Status
from bidexdata.synthesis.attempts import Attempts, scene_seed
from bidexdata.synthesis.baselines.hull_points import HullPoints, along_normals, hull_points
from bidexdata.synthesis.placement_shapes import hands_apart, tangent_frames
from bidexdata.synthesis.regions import no_pairs
from bidexdata.synthesis.table import table_plane
from bidexdata.synthesis.workspace import Start

if TYPE_CHECKING:
    from bidexdata.arms.reach import Reach
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.synthesis.baselines.bodex_config import BodexConfig, BodexStartConfig

_DRAWS = 7
"""Numbers that place one hand: which point, three turns, three shifts."""


class Hung(NamedTuple):
    """One hand of n starts, object frame."""

    position: Float[np.ndarray, "n 3"]
    """[m]."""
    rotation: Float[np.ndarray, "n 3 3"]
    spheres: Float[np.ndarray, "n K 3"]
    """[m]."""


def draw_starts(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    scene: Scene,
    config: BodexConfig,
    seed: int,
    count: int,
    *,
    grown: bool = False,
    device: str = "cpu",
    reach: Reach | None = None,
) -> Attempts:
    """Place both hands for `count` attempts of a scene, clear of each other and of the table.

    Args:
        obj: Gives the surface whose hull is dilated.
        hands: Left and right.
        scene: Size, pose and setting.
        config: Of the method.
        seed: Of this round of the run.
        count: M; an attempt's draws do not depend on it.
        grown: Has no effect: every round has a seed of its own.
        device: Has no effect: starts are drawn on the CPU.
        reach: Has no effect: arms are asked about the grasps alone.
    """
    own, starts = scene_seed(seed, scene.scene_id), config.starts
    plane = table_plane(scene)
    vertices = along_normals(obj, scene.size, starts.dilation)
    over = hull_points(vertices, starts.points, np.random.default_rng([own, 0]))
    if plane.any():
        high = over.points @ plane[:3] + plane[3] >= starts.table_clearance
        over = HullPoints(over.points[high], over.normals[high])
    lots = np.random.default_rng([own, 1]).random((count, starts.draws, 2, _DRAWS))
    across = frames.quat_rotate(
        frames.quat_conjugate(np.array(scene.object_quat_wxyz)), np.array([0.0, 1.0, 0.0])
    )
    postures = [posture(hand, starts.posture) for hand in hands]
    position, rotation = np.zeros((count, 2, 3)), np.tile(np.eye(3), (count, 2, 1, 1))
    ok = np.zeros(count, bool)
    for draw in range(starts.draws if len(over.points) else 0):
        todo = np.flatnonzero(~ok)
        free, balls = np.ones(len(todo), bool), []
        for h, hand in enumerate(hands):
            hung = hang(hand, postures[h], over, across, lots[todo, draw, h], starts)
            position[todo, h], rotation[todo, h] = hung.position, hung.rotation
            balls.append([hung.spheres, hand.sphere_radius])
            if plane.any():
                height = hung.spheres @ plane[:3] + plane[3] - hand.sphere_radius
                free &= np.min(height, axis=1) >= starts.clearance
        ok[todo] = free & hands_apart(balls[0], balls[1], starts.clearance)
    joints = [np.tile(q, (int(ok.sum()), 1)) for q in postures]
    return Attempts(
        scene=scene,
        seed=own,
        status=np.where(ok, Status.OK, Status.NO_PLACEMENT).astype(np.int8),
        region_id=np.full((count, 2), -1),
        region_score=np.full(count, np.nan),
        contact_set=("fingertips",) * count,
        pairs=no_pairs(),
        placed=None,
        start=Start(
            size=np.full(ok.sum(), scene.size),
            position=position[ok],
            rotation=rotation[ok],
            joints=(joints[0], joints[1]),
            regions=np.full((ok.sum(), 2, 1, 3), np.nan),
            plane=np.tile(plane, (ok.sum(), 1)),
        ),
    )


def posture(hand: Hand, angles: dict[str, float]) -> Float[np.ndarray, " J"]:
    """Joint angles by name without the side's prefix; the others as near to zero as they may."""
    q = np.array([angles.get(n.removeprefix(hand.prefix), 0.0) for n in hand.joint_names])
    return np.clip(q, hand.joint_lower, hand.joint_upper)


def hang(
    hand: Hand,
    joints: Float[np.ndarray, " J"],
    over: HullPoints,
    across: Float[np.ndarray, " 3"],
    lots: Float[np.ndarray, "n 7"],
    config: BodexStartConfig,
) -> Hung:
    """Hang one hand over drawn hull points.

    The start frame has x towards the object and y as close to the world's y as may be; fingers
    point along its z.

    Args:
        hand: The hand.
        joints: Its start posture [rad].
        over: Points of the dilated hull.
        across: The world's y axis in the object frame.
        lots: Uniform numbers.
        config: Spreads.
    """
    which = (lots[:, 0] * len(over.points)).astype(np.int64)
    # Columns of tangent_frames: x along the direction given, z along the vector given.
    framed = tangent_frames(-over.normals[which], across)
    start = framed[:, :, [2, 0, 1]]
    largest = np.array([config.roll, config.tilt, config.tilt])
    turns = frames.matrix_from_quat(_euler((2.0 * lots[:, 1:4] - 1.0) * largest))
    start = np.einsum("nij,njk->nik", start, turns)
    spread = np.stack([lots[:, 4], 2 * lots[:, 5] - 1, 2 * lots[:, 6] - 1], axis=1)
    shift = spread * np.array([config.back, config.shift, config.shift])
    # Palm frame: x along the fingers, z out of the palm.
    palm = np.stack([start[:, :, 2], -start[:, :, 1], start[:, :, 0]], axis=-1)
    rotation = np.einsum("nij,kj->nik", palm, hand.T_hand_palm[:3, :3])
    position = over.points[which] - np.einsum("nij,nj->ni", start, shift)
    position -= config.ahead * start[:, :, 2]
    points = hand_points(hand, joints).sphere
    spheres = np.einsum("nij,kj->nki", rotation, points) + position[:, None]
    return Hung(position, rotation, spheres)


def _euler(angles: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """Turns about x, then about the turned y and z; wxyz."""
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(angles), 1))
    for axis in range(3):
        turn = np.zeros_like(angles)
        turn[:, axis] = angles[:, axis]
        q = frames.quat_multiply(q, frames.quat_from_rotation_vector(turn))
    return q
