"""ArmRules: how test a drives two arms, and what else than in test l counts as a failure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from bidexdata.config import OMIT_NONE
from bidexdata.errors import BadConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmRules:
    """Numbers of test a; docs/protocols.md says where they come from.

    Torque limits of the motors are those of the rig.
    """

    gravity_compensation: float = 1.0
    """Share of gravity that does not act on arms and hands [-], as controllers of arms take away
    what gravity asks of the motors; a servo alone sags by 19 to 44 mm."""
    arm_gain: float = 1.0
    """Multiple of the stiffness of the servos in the arm's model; damping grows with its root [-]."""
    wrist_gain: float = 1.0
    """The same for wrist joints of the hand, which move with the arm [-]."""
    servo_bound: float | None = field(default=None, metadata=OMIT_NONE)
    """Damping of a servo is at most this times I / dt, I being the inertia that the motor feels at
    rest, and stiffness is scaled with it [-]; with more than 1 a motor that once reaches its torque
    limit may swing between both limits for good. None: as in the arm's model."""
    settle: float = 0.2
    """Time at the pre-grasp before the hands close [s]."""
    wait: float = 1.0
    """Time after the lift before the object is judged [s]: servos lag behind by a centimetre when
    the lift ends, and by nothing a second later."""
    depth: float = 0.001
    """Arms may overlap table, object, each other and themselves no deeper at any step [m]."""

    def __post_init__(self) -> None:
        if not 0 <= self.gravity_compensation <= 1:
            raise BadConfig(
                "ArmRules.gravity_compensation must be a share from 0 to 1, not "
                f"{self.gravity_compensation!r}"
            )
        for name in ("arm_gain", "wrist_gain", "servo_bound"):
            value = getattr(self, name)
            if not (value is None or 0 < value < math.inf):
                raise BadConfig(f"ArmRules.{name} must be positive, not {value!r}")
        for name in ("settle", "wait", "depth"):
            if not 0 <= getattr(self, name) < math.inf:
                raise BadConfig(
                    f"ArmRules.{name} must not be negative, got {getattr(self, name)!r}"
                )
