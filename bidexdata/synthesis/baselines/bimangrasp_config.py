"""What the baseline `bimangrasp` minimises and how.

Sources: "BimanGrasp" = its released code; "fork" = the fork of it by DexGrasp-TH; "paper" =
BiDexGrasp. What no description fixes is marked "ours".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi

from bidexdata.config import refuse_outside
from bidexdata.synthesis.opening import LEAST_CLOSING
from bidexdata.synthesis.optimise_config import ClosureConfig
from bidexdata.synthesis.selection import KEEP_EVERYTHING, SelectionConfig
from bidexdata.synthesis.staging import PLAIN_SQUEEZE, StagingConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class BimanGraspStartConfig:
    """Where the hands start: behind mirrored points of a dilated hull."""

    dilation: float = 0.2
    """Way that the hull's vertices are moved out, away from the origin [m]. BimanGrasp."""
    least_distance: float = 0.2
    """Smallest way from the hull point back to the palm [m]. BimanGrasp."""
    largest_distance: float = 0.3
    """Largest [m]. BimanGrasp."""
    cone: float = pi / 6
    """Largest angle between the palm normal and the inward direction [rad]. BimanGrasp."""
    points: int = 128
    """Points on the dilated hull in farthest-point order that attempts take in turn [-]. Ours:
    BimanGrasp has as many as grasps in its batch."""
    joint_spread: float = 0.1
    """Standard deviation of each free joint variable over its range [-]. BimanGrasp; the middle,
    which its description leaves open, is the hand's open posture (ours)."""

    def __post_init__(self) -> None:
        refuse_outside(self, "dilation", 0.0, 1.0)
        refuse_outside(self, "least_distance", 0.0, 1.0)
        refuse_outside(self, "largest_distance", self.least_distance, 1.0)
        refuse_outside(self, "cone", 0.0, pi / 2)
        refuse_outside(self, "points", 1, 10_000)
        refuse_outside(self, "joint_spread", 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class BimanGraspEnergyConfig:
    """Weights and amounts of the energy terms."""

    fc: float = 1.0
    """Weight of the logarithm of the condition number of G [-]. BimanGrasp."""
    dis: float = 100.0
    """Weight of the contacts' absolute distances [1/m]. BimanGrasp."""
    pen: float = 125.0
    """Weight of the depths of object points in the hands [1/m]. BimanGrasp."""
    spen: float = 10.0
    """Weight of near keypoints and of hand points in the other hand [1/m]. BimanGrasp."""
    joints: float = 1.0
    """Weight of joints beyond their limits [1/rad]. BimanGrasp."""
    vew: float = 0.5
    """Weight of the wrench ellipsoid's term [-]. BimanGrasp."""
    contacts: int = 4
    """Contacts a hand [-]. BimanGrasp."""
    candidates: int = 10
    """Contact candidates on the palmar side of each of a finger's last three links [-]. BimanGrasp,
    which has none on the thumb's first."""
    object_points: int = 2000
    """Surface points of the object that must not lie in a hand [-]. BimanGrasp."""
    hand_points: int = 2000
    """Surface points of the right hand that must not lie in the left [-]. BimanGrasp."""
    keypoint_reach: float = 0.02
    """Keypoints nearer to each other than this cost [m]. BimanGrasp; keypoints are the centres of
    the collision spheres of links that must not overlap (ours)."""
    normal_step: float = 0.004
    """Half width of the differences that give surface normals [m]. Ours: BimanGrasp has the normal
    of the nearest triangle."""

    def __post_init__(self) -> None:
        for name in ("fc", "dis", "pen", "spen", "joints", "vew"):
            refuse_outside(self, name, 0.0, 1e6)
        refuse_outside(self, "contacts", 3, 100)
        refuse_outside(self, "candidates", 1, 1000)
        refuse_outside(self, "object_points", 1, 100_000)
        refuse_outside(self, "hand_points", 0, 100_000)
        refuse_outside(self, "keypoint_reach", 0.0, 1.0)
        refuse_outside(self, "normal_step", 1e-4, 0.1)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnnealingConfig:
    """The search: MALA with annealed step and temperature."""

    steps: int = 10_000
    """Proposals [-]. BimanGrasp, code and paper; the fork takes 3000."""
    step: float = 0.005
    """First step length of every variable, over the root of its mean squared gradient [m, rad].
    BimanGrasp."""
    step_decay: float = 0.95
    """Factor of the step length after every period [-]. BimanGrasp."""
    step_period: int = 50
    """Proposals of such a period [-]. BimanGrasp."""
    temperature: float = 18.0
    """First temperature [-]. BimanGrasp."""
    temperature_decay: float = 0.95
    """Factor of the temperature after every period [-]. BimanGrasp."""
    temperature_period: int = 30
    """Proposals of such a period [-]. BimanGrasp."""
    keep: float = 0.98
    """Share of the old value in the running mean of squared gradients, which is over the attempts
    of a scene [-]. BimanGrasp."""
    noise: float = 0.1
    """Factor of the Langevin noise [-]. BimanGrasp."""
    switch: float = 0.5
    """Probability that a contact is drawn anew, times sqrt(T / T0) [-]. BimanGrasp."""
    clamp: bool = True
    """Keep joints within their limits. The fork. Without, as in BimanGrasp, a joint that has no
    gradient at first is thrown tens of turns by noise over a mean of zero."""

    def __post_init__(self) -> None:
        refuse_outside(self, "steps", 1, 1_000_000)
        refuse_outside(self, "step", 0.0, 1.0)
        refuse_outside(self, "temperature", 1e-9, 1e6)
        for name in ("step_decay", "temperature_decay"):
            refuse_outside(self, name, 1e-3, 1.0)
        for name in ("step_period", "temperature_period"):
            refuse_outside(self, name, 1, 1_000_000)
        for name in ("keep", "noise", "switch"):
            refuse_outside(self, name, 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class BimanGraspStagingConfig:
    """Pre-grasp and squeeze, which BimanGrasp has not: the paper's rule for its grasps."""

    palm: float = 0.01
    """Way of the palm back along its normal at the pre-grasp, and on at the squeeze [m]. Paper,
    its table of the synthesis: palm +-1 cm."""
    joints: float = 0.1
    """Angle by which closing joints open at the pre-grasp, and close at the squeeze [rad]. Paper,
    the same: joints +-0.1 rad."""
    least_closing: float = LEAST_CLOSING
    """A joint closes when it moves its finger's pad along the pad's normal by at least this way per
    radian, in the curved posture [m]. Ours: joints that spread the fingers stay."""

    def __post_init__(self) -> None:
        refuse_outside(self, "palm", 0.0, 0.1)
        refuse_outside(self, "joints", 0.0, 1.0)
        refuse_outside(self, "least_closing", 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class BimanGraspConfig:
    """The baseline `bimangrasp`: contacts anywhere on the fingers, found by annealing."""

    starts: BimanGraspStartConfig = field(default_factory=BimanGraspStartConfig)
    energy: BimanGraspEnergyConfig = field(default_factory=BimanGraspEnergyConfig)
    annealing: AnnealingConfig = field(default_factory=AnnealingConfig)
    stages: BimanGraspStagingConfig = field(default_factory=BimanGraspStagingConfig)
    staging: StagingConfig = PLAIN_SQUEEZE
    """The squeeze 2 G - G_pre, without joint torques. Paper: palm and joints alone."""
    selection: SelectionConfig = KEEP_EVERYTHING
    """Every attempt is kept: BimanGrasp has thresholds for its log, and filters by simulation."""

    @property
    def steps(self) -> int:
        """Proposals of each attempt."""
        return self.annealing.steps

    @property
    def normal_step(self) -> float:
        """Half width of the differences that give normals [m]."""
        return self.energy.normal_step

    @property
    def closure(self) -> ClosureConfig:
        """QPs whose residuals stand in the record, those of the default method."""
        return ClosureConfig()
