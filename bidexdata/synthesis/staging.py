"""Staging: what the hands are told to do after the grasp."""

from __future__ import annotations

from dataclasses import dataclass

from bidexdata.synthesis.optimise_config import refuse_outside


@dataclass(frozen=True, slots=True, kw_only=True)
class StagingConfig:
    """How the squeeze target follows from pre-grasp, grasp and contact forces."""

    extrapolate: float = 1.0
    """Squeeze = grasp + extrapolate (grasp - pregrasp) [-]. Paper 4.4: 2 G - G_pre, so 1."""
    force_floor: float = 3.0
    """Normal force per hand that the joint torques aim at, at least [N]; 0 with a zero
    `force_per_weight` leaves the joint torques out (the paper). Prototype 7."""
    force_per_weight: float = 8.0
    """The same per newton of the object's weight [-]. Prototype 3.3: SUC-F at 0.8 m 65 -> 84 %."""
    stiffness: float = 5.0
    """Gain of the position actuators that will follow the target [N m/rad]. Protocol paper-1."""
    largest_offset: float = 0.6
    """Largest change of a joint by the torques [rad]. Prototype."""
    density: float = 2.5
    """Density that the weight is computed with [kg/m3]. Paper 6.1."""

    def __post_init__(self) -> None:
        refuse_outside(self, "extrapolate", 0.0, 10.0)
        refuse_outside(self, "force_floor", 0.0, 1000.0)
        refuse_outside(self, "force_per_weight", 0.0, 1000.0)
        refuse_outside(self, "stiffness", 1e-3, 1e6)
        refuse_outside(self, "largest_offset", 0.0, 3.2)
        refuse_outside(self, "density", 0.0, 1e5)
