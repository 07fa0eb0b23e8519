"""What the bilevel optimisation minimises and how: weights, closure, margins, steps.

Sources: "paper" = BiDexGrasp with the section; "BODex" = its configuration files; "measurements,
n" = docs/measurements.md, section n, on 13 meshes x 3 sizes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from bidexdata.config import refuse_outside
from bidexdata.wrench.qp import QPConfig
from bidexdata.wrench.qp_groups import Coupling

Disturbances = Literal["forces", "zero"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosureConfig:
    """The lower level: which contacts must balance which wrenches with which forces."""

    groups: Coupling = "mix"
    """`decoupled`: each hand its own closure (paper 4.3); `coupled`: all contacts of both hands
    with each hand pressing; `mix`: both. Measurements, 3: equal within noise."""
    weight_decoupled: float = 10.0
    """Weight of the sum of both hands' Q [-]. Measurements, 3: 10 and 40 are equal within noise.
    Ours, the smaller: finger-object distances spread less with it."""
    weight_coupled: float = 20.0
    """Weight of the coupled Q [-]. Measurements, 14."""
    shift: float = 0.012
    """How far from where the pads are closest the closure has its contacts [m]: they circle in the
    tangent plane, each at its own pace, so that the balance does not hang on exact places.
    Measurements, 14; the paper has 0."""
    turns: float = 16.0
    """Mean number of circles during the approach [-]. Measurements, 14: not varied there."""
    disturbances: Disturbances = "zero"
    """`forces`: six unit forces +-x, +-y, +-z (paper 3); `zero`: the zero wrench alone.
    Measurements, 3: equal success within noise, and half the time of a step."""
    qp: QPConfig = field(default_factory=QPConfig)
    """The contact QP of all groups."""
    torque_length: float = 0.5
    """Length that makes torques comparable with forces, as a share of the object's longest side
    [-]; in the torque score of regions too. Measurements, 4; BODex uses half the diagonal."""
    least_torque_length: float = 0.1
    """Lower bound of that length [m]. Measurements, 4."""
    iterations: int = 4
    """Projected-gradient iterations per optimiser step, warm started [-]. Measurements, 3: within
    0.1 % (decoupled) and 5 % (coupled) of 2000 iterations after 80 steps."""
    start_iterations: int = 40
    """Iterations before the first step [-]. Measurements, 3."""

    def __post_init__(self) -> None:
        for name in ("weight_decoupled", "weight_coupled"):
            refuse_outside(self, name, 0.0, 1e6)
        refuse_outside(self, "shift", 0.0, 0.1)
        refuse_outside(self, "turns", 0.0, 1000.0)
        refuse_outside(self, "torque_length", 0.0, 10.0)
        refuse_outside(self, "least_torque_length", 1e-3, 10.0)
        refuse_outside(self, "iterations", 1, 10_000)
        refuse_outside(self, "start_iterations", 0, 100_000)

    def torque_lengths(self, longest: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Length that divides torques [m], for longest sides of bounding boxes [m]."""
        return np.asarray(np.maximum(self.torque_length * longest, self.least_torque_length))


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergyConfig:
    """The upper level: weights and thresholds of the other energy terms."""

    distance: float = 1000.0
    """Weight of the squared contact distances [1/m2]. Measurements, 4; paper 6.2 has 100."""
    region: float = 2.0
    """Weight of E_region [1/m]. Measurements, 4; paper 6.2 has 50."""
    region_distance: Literal["anchor", "points"] = "anchor"
    """Distance of a contact point to its region: to the region's centre, or to the nearest of its
    points. Measurements, 3, had the centre; paper, appendix B, has the points."""
    region_threshold: float = 0.06
    """Threshold a of phi [m]; b = 2 a. Measurements, 3 and 4: for the distance to the centre, and
    not varied there; the paper gives no value."""
    penetration: float = 20_000.0
    """Weight of squared hand-object sphere depths [1/m2]. Measurements, 3; the paper gives no
    value."""
    self_penetration: float = 2_000.0
    """Weight of squared sphere overlaps within and between hands [1/m2]. Measurements, 4; the paper
    gives no value."""
    pad: float = 0.1
    """Weight of the pad-angle hinge [-]. Measurements, 4."""
    pad_cosine: float = 0.75
    """Least cosine between pad normal and inward surface normal that costs nothing.
    Measurements, 4."""
    object_margin: float = 0.002
    """Spheres keep this far from the object [m]: about as far as a hand stands out of its spheres.
    Measurements, 15."""
    contact_margin: float = 0.002
    """The same of the spheres that fingertips touch with [m]; negative: they may lie as deep in it.
    Ours, the same as for the others; BODex lets them 2 mm in."""
    table_margin: float = 0.002
    """Spheres keep this far from the table [m]. Ours, the same as for the object."""
    self_margin: float = 0.002
    """Spheres of one hand keep this far apart [m]. BODex, activation 2 mm; measurements, 4."""
    inter_margin: float = 0.005
    """Spheres of different hands keep this far apart [m]. Measurements, 4."""
    normal_step: float = 0.008
    """Half width of the differences that give surface normals and their change [m].
    Measurements, 4; BODex draws 10 to 20 mm."""

    def __post_init__(self) -> None:
        for name in ("distance", "region", "penetration", "self_penetration", "pad"):
            refuse_outside(self, name, 0.0, 1e9)
        refuse_outside(self, "region_threshold", 1e-4, 10.0)
        refuse_outside(self, "pad_cosine", -1.0, 1.0)
        refuse_outside(self, "normal_step", 1e-4, 0.1)
        refuse_outside(self, "contact_margin", -0.1, 0.1)
        for name in ("object_margin", "table_margin", "self_margin", "inter_margin"):
            refuse_outside(self, name, 0.0, 0.1)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseConfig:
    """One of the three phases: how long, how far from the surface, how large the steps."""

    steps: int
    """Optimiser steps [-]."""
    distance: float
    """Distance of the pads from the surface that the phase aims at [m]."""
    step_position: float
    """First step length of the base translation [m]."""
    step_rotation: float
    """First step length of the base rotation [rad]."""
    step_joints: float
    """First step length of the joints [rad]."""

    def __post_init__(self) -> None:
        refuse_outside(self, "steps", 0, 100_000)
        refuse_outside(self, "distance", 0.0, 0.1)
        for name in ("step_position", "step_rotation", "step_joints"):
            refuse_outside(self, name, 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class AdamConfig:
    """The step rule: Adam with one second moment per base part and per joint."""

    beta1: float = 0.9
    """Decay of the first moment [-]. Measurements, 4."""
    beta2: float = 0.95
    """Decay of the second moment [-]. Measurements, 4."""
    final_fraction: float = 0.15
    """Step length at a phase's last step over its first [-]; linear in between.
    Measurements, 4."""

    def __post_init__(self) -> None:
        for name in ("beta1", "beta2"):
            refuse_outside(self, name, 0.0, 0.9999)
        refuse_outside(self, "final_fraction", 0.0, 1.0)


def _approach() -> PhaseConfig:
    return PhaseConfig(
        steps=120, distance=0.010, step_position=0.002, step_rotation=0.02, step_joints=0.03
    )


def _pregrasp() -> PhaseConfig:
    return PhaseConfig(
        steps=30, distance=0.010, step_position=0.001, step_rotation=0.01, step_joints=0.015
    )


def _grasp() -> PhaseConfig:
    return PhaseConfig(
        steps=70, distance=0.0, step_position=0.0007, step_rotation=0.007, step_joints=0.015
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class OptimiseConfig:
    """Decoupled bilevel optimisation in three phases (paper 4.3, 4.4; measurements, 3 and 4)."""

    closure: ClosureConfig = field(default_factory=ClosureConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    adam: AdamConfig = field(default_factory=AdamConfig)
    approach: PhaseConfig = field(default_factory=_approach)
    """Closure, distance, region: finds where to touch. Pads held 10 mm off (paper 4.4)."""
    pregrasp: PhaseConfig = field(default_factory=_pregrasp)
    """Contact points frozen; pads go to 10 mm above them. Ends in the pre-grasp."""
    grasp: PhaseConfig = field(default_factory=_grasp)
    """The same contact points; pads go to the surface. Ends in the grasp."""

    @property
    def steps(self) -> int:
        """Optimiser steps of all phases."""
        return self.approach.steps + self.pregrasp.steps + self.grasp.steps
