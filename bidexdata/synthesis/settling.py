"""Settling: whether an object stays between two hands that close on it, without a simulator.

Objects of a few grams go wherever their contacts push them while the hands close, and whether they
come to rest depends on how the contacts lie, not on how heavy they are. So hands are contact points
on springs and inertia counts for nothing; friction is less than it will be, and the object lies a
little off its place, because a grasp that needs either exact is a bad one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bidexdata.config import refuse_outside
from bidexdata.hands.kinematics import hand_points
from bidexdata.synthesis.pose import Pose

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand

CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3.0)
"""Where the object lies off its place: the corners of a tetrahedron, object frame, (4, 3)."""

LEAST_PRESSED = 3e-4
"""Less counts as this [m]: a tenth of a newton at the stiffness of a finger."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SettlingConfig:
    """The quasi-static model. "Measurements, n" is docs/measurements.md, section n."""

    aside: float = 0.007
    """How far the object lies off its place, in each of four directions [m]. Measurements, 21."""
    friction: float = 0.3
    """Of contact points and object [-]; half of what the protocols have. Measurements, 21."""
    closing_moves: int = 2
    """Equal moves from pre-grasp to grasp [-]. Measurements, 21: more change little."""
    pressing_moves: int = 6
    """Equal moves from grasp to squeeze [-]. Measurements, 21: likewise."""
    waiting_moves: int = 4
    """Moves after that, with the targets at rest [-]. Measurements, 21: likewise."""
    repeats: int = 2
    """How often contact points and object give way to each other in a move [-]. Measurements, 21: likewise."""
    stride: float = 0.005
    """Farthest way of a contact point or the object in one of these [m]. Ours: less than the radius
    of a fingertip, so that none passes through a thin plate."""

    def __post_init__(self) -> None:
        refuse_outside(self, "aside", 0.0, 0.1)
        refuse_outside(self, "friction", 0.0, 10.0)
        for name in ("closing_moves", "pressing_moves", "repeats"):
            refuse_outside(self, name, 1, 10_000)
        refuse_outside(self, "waiting_moves", 0, 10_000)
        refuse_outside(self, "stride", 1e-4, 0.1)


class Settled(NamedTuple):
    """How N objects lie between the hands in the end; NaN for grasps that are not finite.

    Means over the places that the object starts from.
    """

    pressed: Float[np.ndarray, " N"]
    """How far the contact points of the hand that presses less would go on without the object,
    summed [m]: its normal forces over the stiffness of a finger. The geometric mean."""
    touching: Float[np.ndarray, " N"]
    """Contact points that press [-]."""
    turned: Float[np.ndarray, " N"]
    """By how much the object has turned [rad]."""


def settled(
    field: Any,
    hands: Sequence[Hand],
    stages: tuple[Pose, Pose, Pose],
    size: Float[np.ndarray, " N"],
    config: SettlingConfig,
    device: str = "cpu",
) -> Settled:
    """Close the hands on an object that follows its contacts at once.

    Args:
        field: `distance_field_kernels.DistanceField` of the object.
        hands: Left and right, with all their contact points.
        stages: Pre-grasp, grasp and squeeze, object frame.
        size: Bounding-box diagonals [m].
        config: Numbers of the model.
        device: Warp device.

    Source:
        Ours; docs/measurements.md, 21.
    """
    centres = np.stack([_contact_centres(hands, pose) for pose in stages], axis=1)
    side = np.repeat([0, 1], [len(hand.contact_names) for hand in hands])
    radius = np.concatenate([hand.contact_radius for hand in hands])
    return settled_contacts(field, centres, side, radius, size, config, device)


def settled_contacts(
    field: Any,
    centres: Float[np.ndarray, "N 3 M 3"],
    side: Int[np.ndarray, " M"],
    radius: Float[np.ndarray, " M"],
    size: Float[np.ndarray, " N"],
    config: SettlingConfig,
    device: str = "cpu",
) -> Settled:
    """The same for contact points that are spheres at the three stages.

    Args:
        field: `distance_field_kernels.DistanceField` of the object.
        centres: At pre-grasp, grasp and squeeze, object frame [m].
        side: 0 for contact points of the left hand, 1 for the right.
        radius: [m].
        size: Bounding-box diagonals [m].
        config: Numbers of the model.
        device: Warp device.
    """
    finite = np.asarray(np.isfinite(centres).all(axis=(1, 2, 3)))
    result = np.full((3, len(finite)), np.nan)
    if finite.any():
        parts = _settle(field, centres[finite], side, radius, size[finite], config, device)
        result[:, finite] = _means(*parts)
    return Settled(*result)


def _means(pressed: np.ndarray, touching: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Over the places of the object: pressing depths (n, S, 2), numbers and angles (n, S)."""
    weaker = np.maximum(pressed.min(axis=2).astype(np.float64), LEAST_PRESSED)
    return np.stack(
        [np.exp(np.log(weaker).mean(axis=1)), touching.mean(axis=1), turned.mean(axis=1)]
    )


def _settle(
    field: Any,
    centres: np.ndarray,
    side: np.ndarray,
    radius: np.ndarray,
    size: np.ndarray,
    config: SettlingConfig,
    device: str,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    import warp as wp

    from bidexdata.synthesis.settling_kernels import settle

    places = CORNERS * config.aside
    dim = (len(size), len(places))

    def given(values: np.ndarray, dtype: Any) -> Any:
        kind = np.int32 if dtype is int else np.float32
        return wp.array(np.ascontiguousarray(values, kind), dtype=dtype, device=device)

    def empty(dtype: Any, *more: int) -> Any:
        return wp.empty((*dim, *more), dtype=dtype, device=device)

    spheres, clearance = empty(wp.vec3, len(radius)), empty(wp.vec4, len(radius))
    pressed, touching, turned = empty(wp.vec2), empty(float), empty(float)
    wp.launch(
        settle,
        dim=dim,
        inputs=[
            *(field, given(size, float), given(places, wp.vec3)),
            *(given(side, int), given(radius, float)),
            *(config.friction, config.closing_moves, config.pressing_moves),
            *(config.waiting_moves, config.repeats, config.stride, given(centres, wp.vec3)),
        ],
        outputs=[spheres, clearance, pressed, touching, turned],
        device=device,
    )
    return pressed.numpy(), touching.numpy(), turned.numpy()


def _contact_centres(hands: Sequence[Hand], pose: Pose) -> np.ndarray:
    """Centres of the contact points of both hands [m], (n, M, 3)."""
    return np.concatenate(
        [
            hand_points(hand, pose.joints[h], pose.position[:, h], pose.quat_wxyz[:, h]).contact
            for h, hand in enumerate(hands)
        ],
        axis=1,
    )
