"""Staging: what the hands are told to do after the grasp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from bidexdata.config import OMIT_NONE, refuse_outside
from bidexdata.errors import BadConfig
from bidexdata.frames import (
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    rotation_vector_from_quat,
)
from bidexdata.synthesis.forces import BaseGive
from bidexdata.synthesis.pose import Pose

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand


@dataclass(frozen=True, slots=True, kw_only=True)
class StagingConfig:
    """How the squeeze target follows from pre-grasp, grasp and contact forces.

    "Measurements, n" is docs/measurements.md, section n.
    """

    extrapolate: float = 0.25
    """Squeeze = grasp + extrapolate (grasp - pregrasp) [-]. It presses with whatever force the
    fingers' stiffness gives, the joint torques with balanced ones. Measurements, 17; paper 4.4:
    2 G - G_pre, so 1."""
    force_floor: float = 10.0
    """Sum of a hand's normal forces whose joint torques the squeeze adds, at least [N]; 0 with a
    zero `force_per_weight` leaves the joint torques out (the paper). Ours: between the 8 and 15 N
    of measurements, 17."""
    force_per_weight: float = 3.0
    """The same per newton of the object's weight [-]. Measurements, 17: 3 once the base leads;
    section 5 had 8."""
    stiffness: float = 5.0
    """Gain of the position actuators that will follow the target [N m/rad]. Protocol paper-1."""
    base_lead: float = 1.0
    """How far the base's target leads, as a share of how far the weld of paper-1 gives way under
    the forces that the joint torques are for [-]. Measurements, 17."""
    largest_offset: float = 0.6
    """Largest change of a joint by the torques [rad]; where it binds, the torques fall short of
    `force_scale`. Measurements, 5: never reached."""
    density: float = 2.5
    """Density that the weight is computed with [kg/m3]. Paper 6.1."""
    mass: float = 0.0
    """Mass that the weight is computed with, in place of the density's; 0 leaves it to that [kg].
    Ours."""
    opened: tuple[float, float] | None = field(default=None, metadata=OMIT_NONE)
    """In place of the optimised pre-grasp the grasp with its palms this far back [m] and its closing
    joints this far open [rad], as the paper tests grasps that have none (6.1: 0.01 and 0.1)."""

    def __post_init__(self) -> None:
        refuse_outside(self, "extrapolate", 0.0, 10.0)
        refuse_outside(self, "base_lead", 0.0, 10.0)
        refuse_outside(self, "force_floor", 0.0, 1000.0)
        refuse_outside(self, "force_per_weight", 0.0, 1000.0)
        refuse_outside(self, "stiffness", 1e-3, 1e6)
        refuse_outside(self, "largest_offset", 0.0, 3.2)
        refuse_outside(self, "density", 0.0, 1e5)
        refuse_outside(self, "mass", 0.0, 1e5)
        if self.opened is not None:
            palm, joints = self.opened
            if not (0.0 <= palm <= 0.1 and 0.0 <= joints <= 1.0):
                raise BadConfig(
                    "StagingConfig.opened must be a way from 0 to 0.1 m and an angle from 0 to 1 rad, "
                    f"not {list(self.opened)!r}"
                )


PLAIN_SQUEEZE = StagingConfig(extrapolate=1.0, base_lead=0.0, force_floor=0.0, force_per_weight=0.0)
"""The squeeze 2 G - G_pre and nothing else, that of the paper and of its peers."""


class Press(NamedTuple):
    """What the wanted contact forces ask of each hand."""

    torques: Sequence[Float[np.ndarray, "N D"]]
    """Generalised torques on the free variables, per hand [N m]."""
    give: BaseGive
    """Of the hands' bases."""


def squeeze(
    pregrasp: Pose,
    grasp: Pose,
    press: Press,
    hands: Sequence[Hand],
    config: StagingConfig,
) -> Pose:
    """Aim beyond the grasp: on along the closing motion, and by the torques that press.

    Args:
        pregrasp: Both hands before closing.
        grasp: Both hands touching.
        press: Exerts the wanted forces.
        hands: Left and right.
        config: How far, and how stiff the actuators are.

    Source:
        BiDexGrasp, section 4.4 (2 G - G_pre); joint torques J^T f as in Dexonomy, scaled with the
        weight (docs/measurements.md, 5: the base's weld absorbs most of a pure pose offset).
    """
    share = config.extrapolate
    turn = rotation_vector_from_quat(
        quat_multiply(grasp.quat_wxyz, quat_conjugate(pregrasp.quat_wxyz))
    )
    joints = []
    for h, hand in enumerate(hands):
        on = share * (grasp.joints[h] - pregrasp.joints[h])
        offset = torque_offsets(hand, press.torques[h], config)
        joints.append(grasp.joints[h] + on + offset)
    lead = config.base_lead
    position = grasp.position + share * (grasp.position - pregrasp.position)
    turn = share * turn + lead * press.give.turn
    return Pose(
        position=position + lead * press.give.shift,
        quat_wxyz=quat_multiply(quat_from_rotation_vector(turn), grasp.quat_wxyz),
        joints=(joints[0], joints[1]),
    )


def torque_offsets(
    hand: Hand, torques: Float[np.ndarray, "N D"], config: StagingConfig
) -> Float[np.ndarray, "N J"]:
    """Changes of the joint targets that make the actuators do the work of the torques [rad].

    Changing the targets by C du (C: coupling) changes the controls by M C du (M: moment matrix) and
    the actuators' torques by kp M C du, whose work along the free variables is kp (M C)^T M C du.
    That equals the torques asked for, or is closest to them where actuators are fewer than free
    variables; the targets change as little as they can. A tendon over two coupled joints pulls at
    both with one torque, and both targets add to its control: each changes by a quarter of the sum
    of the joints' torques over kp, and each joint gets half of that sum.

    Args:
        hand: Gives coupling and moment matrix.
        torques: Generalised torques on the free variables [N m].
        config: Stiffness kp, and the limit of each joint's change.
    """
    pull = hand.actuator_moment @ hand.coupling
    per_torque = hand.coupling @ np.linalg.pinv(pull.T @ pull) / config.stiffness
    # One product per joint, so that the batch's size cannot change the rounding.
    offsets = np.sum(torques[:, None, :] * per_torque[None], axis=2)
    return np.clip(offsets, -config.largest_offset, config.largest_offset)
