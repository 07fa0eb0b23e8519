"""Where BimanGrasp's hands start: far off, palms towards the object, left and right mirrored.

Source: BimanGrasp's released code, initialisation; what is ours stands in the configuration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from bidexdata import frames
from bidexdata.errors import BadConfig
from bidexdata.hands.device import free_limits
from bidexdata.record import Scene, Status
from bidexdata.synthesis.attempts import Attempts, scene_seed
from bidexdata.synthesis.baselines.hull_points import from_origin, hull_points
from bidexdata.synthesis.regions import no_pairs
from bidexdata.synthesis.workspace import Start, free_variables

if TYPE_CHECKING:
    from bidexdata.arms.reach import Reach
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import PreparedObject
    from bidexdata.synthesis.baselines.bimangrasp_config import (
        BimanGraspConfig,
        BimanGraspStartConfig,
    )

OPPOSITE = np.array([-1.0, -1.0, 1.0])
"""The right hand's hull point and direction from the left's: half a turn about z."""
_DRAWS = 4
"""Numbers that place one hand: way back, tilt, its direction, roll."""


def draw_starts(
    obj: PreparedObject,
    hands: tuple[Hand, Hand],
    scene: Scene,
    config: BimanGraspConfig,
    seed: int,
    count: int,
    *,
    grown: bool = False,
    device: str = "cpu",
    reach: Reach | None = None,
) -> Attempts:
    """Place both hands for `count` attempts of a scene; no start is refused.

    Args:
        obj: Gives the hull.
        hands: Left and right.
        scene: A floating one.
        config: Of the method.
        seed: Of this round of the run.
        count: M.
        grown: Has no effect: every round has a seed of its own.
        device: Has no effect: starts are drawn on the CPU.
        reach: Has no effect: arms are asked about the grasps alone.

    Raises:
        BadConfig: The scene has a table, which BimanGrasp's energies do not know.
    """
    if scene.setting != "floating":
        raise BadConfig("the method bimangrasp knows no table; use --setting floating")
    own = scene_seed(seed, scene.scene_id)
    rng = np.random.default_rng([own, 1])
    spread = config.starts
    hull = from_origin(obj, scene.size, spread.dilation)
    on_hull = hull_points(hull, spread.points, np.random.default_rng([own, 0]))
    position, rotation = np.zeros((count, 2, 3)), np.zeros((count, 2, 3, 3))
    joints: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    for i in range(count):
        k = i % len(on_hull.points)
        for h, hand in enumerate(hands):
            turn = OPPOSITE if h == 1 else np.ones(3)
            drawn = _start(hand, turn * on_hull.points[k], -turn * on_hull.normals[k], spread, rng)
            position[i, h], rotation[i, h] = drawn
            joints[h].append(_posture(hand, spread.joint_spread, rng))
    return Attempts(
        scene=scene,
        seed=own,
        status=np.full(count, Status.OK, np.int8),
        region_id=np.full((count, 2), -1),
        region_score=np.full(count, np.nan),
        contact_set=("fingertips",) * count,
        pairs=no_pairs(),
        placed=None,
        start=Start(
            size=np.full(count, scene.size),
            position=position,
            rotation=rotation,
            joints=(np.stack(joints[0]), np.stack(joints[1])),
            regions=np.full((count, 2, 1, 3), np.nan),
            plane=np.zeros((count, 4)),
        ),
    )


def _start(
    hand: Hand,
    point: Float[np.ndarray, " 3"],
    inward: Float[np.ndarray, " 3"],
    config: BimanGraspStartConfig,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Put a hand's palm behind a hull point; hand frame, object frame [m]."""
    way, tilt, heading, roll = rng.random(_DRAWS)
    out = frames.rotation_with_z(inward)
    angle, around = config.cone * tilt, 2.0 * np.pi * heading
    # A direction of the cone about the hull's inward normal, then any roll about it.
    direction = out @ np.array(
        [np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)]
    )
    c, s = np.cos(2.0 * np.pi * roll), np.sin(2.0 * np.pi * roll)
    palm = frames.rotation_with_z(direction) @ np.array(
        [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    )
    back = config.least_distance + way * (config.largest_distance - config.least_distance)
    R = palm @ hand.T_hand_palm[:3, :3].T
    return point - back * direction - R @ hand.T_hand_palm[:3, 3], R


def _posture(hand: Hand, spread: float, rng: np.random.Generator) -> Float[np.ndarray, " J"]:
    """Draw joints about the open posture, normal and cut off at the limits [rad]."""
    lower, upper = free_limits(hand)
    middle = free_variables(hand, hand.posture_open[None])[0]
    u = _truncated(middle, spread * (upper - lower), lower, upper, rng)
    return hand.coupling @ u


def _truncated(
    middle: np.ndarray,
    deviation: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    from scipy.special import ndtr, ndtri

    wide = np.maximum(deviation, 1e-12)
    low, high = ndtr((lower - middle) / wide), ndtr((upper - middle) / wide)
    drawn = middle + wide * ndtri(low + rng.random(len(middle)) * (high - low))
    return np.clip(drawn, lower, upper)
