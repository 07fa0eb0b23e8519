"""What the baseline `bodex` minimises and how: BODex over both hands at once.

Sources: "BODex" = its configuration for the Shadow hand without a table; "BimanBODex" = its public
extension to two hands; "paper" = BiDexGrasp. What no description fixes is marked "ours".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi

from bidexdata.config import refuse_outside
from bidexdata.errors import BadConfig
from bidexdata.synthesis.optimise_config import ClosureConfig, EnergyConfig
from bidexdata.synthesis.selection import KEEP_EVERYTHING, SelectionConfig
from bidexdata.synthesis.staging import PLAIN_SQUEEZE, StagingConfig
from bidexdata.wrench.qp import QPConfig


def _posture() -> dict[str, float]:
    return {
        **{"THJ4": 1.2, "THJ2": -0.2},
        **{"FFJ4": -0.1, "FFJ3": 0.3, "MFJ3": 0.3, "RFJ4": -0.1, "RFJ3": 0.3},
        **{"LFJ4": -0.2, "LFJ3": 0.3},
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class BodexStartConfig:
    """Where the hands start: each over its own point of a dilated hull."""

    dilation: float = 0.1
    """Way that the surface is moved out along its normals before its hull is taken [m]. BODex."""
    points: int = 128
    """Even points on that hull, of which each hand draws one [-]. BODex."""
    table_clearance: float = 0.09
    """Points nearer to the table are left out [m]. BODex: a sphere of this radius."""
    roll: float = pi
    """Largest turn about the palm normal, either way [rad]. BODex."""
    tilt: float = pi / 12
    """Largest turn about each of the other two axes, either way [rad]. BODex."""
    back: float = 0.03
    """Largest way back from the hull point along the palm normal [m]. BODex."""
    shift: float = 0.03
    """Largest way along each of the other two axes, either way [m]. BODex."""
    ahead: float = 0.08
    """Way from the hand's origin along the fingers to what lies at the hull point [m]. BODex."""
    posture: dict[str, float] = field(default_factory=_posture)
    """Start joints by name without the side's prefix [rad]; joints that are not named, or whose
    hand has no such joint, stand at zero, as far as limits allow. BODex."""
    clearance: float = 0.005
    """Least gap between the hands' spheres, and to the table [m]. Ours: that of the default
    method."""
    draws: int = 8
    """Draws per attempt before it counts as not placeable [-]. Ours: as the default method."""

    def __post_init__(self) -> None:
        for name in ("dilation", "table_clearance", "back", "shift", "ahead", "clearance"):
            refuse_outside(self, name, 0.0, 1.0)
        refuse_outside(self, "points", 1, 10_000)
        refuse_outside(self, "roll", 0.0, pi)
        refuse_outside(self, "tilt", 0.0, pi / 2)
        refuse_outside(self, "draws", 1, 1000)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodexEnergyConfig:
    """Weights of the terms; those of means are over all contacts of both hands."""

    closure: float = 100.0
    """Weight of the mean squared wrench residual over the six targets [-]. BODex."""
    distance: float = 1000.0
    """Weight of the mean squared deviation of the contact distances, and of the way to the frozen
    contacts [1/m2]. BODex."""
    collision: float = 100.0
    """Weight w of cuRobo's collision cost, w x^2 / (2 eta) for the depth x in a margin eta [1/m].
    BODex; ours goes on as a square where cuRobo's becomes linear."""
    least_eta: float = 0.005
    """eta is the stage's contact distance, at least this [m]. BODex."""
    contact_margin: float = -0.002
    """Margin of the contact spheres over the stage's contact distance [m]. BODex."""
    other_margin: float = 0.002
    """Least margin of all other spheres, else the stage's contact distance [m]. BODex."""
    self_collision: float = 25_000.0
    """Weight of squared sphere overlaps within and between hands [1/m2]. Ours: as steep at the 2 mm
    of BODex's activation as its cost, 100 times the largest overlap."""
    self_margin: float = 0.002
    """Spheres keep this far apart [m]. BODex."""
    normal_step: float = 0.01
    """Half width of the differences that give surface normals and their change [m]. BODex draws
    10 to 20 mm."""

    def __post_init__(self) -> None:
        for name in ("closure", "distance", "collision", "self_collision"):
            refuse_outside(self, name, 0.0, 1e9)
        refuse_outside(self, "least_eta", 1e-4, 0.1)
        refuse_outside(self, "contact_margin", -0.1, 0.1)
        for name in ("other_margin", "self_margin"):
            refuse_outside(self, name, 0.0, 0.1)
        refuse_outside(self, "normal_step", 1e-4, 0.1)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodexScheduleConfig:
    """Steps, their lengths and the three stages."""

    steps: int = 500
    """Optimiser steps of all stages [-]. BODex."""
    progress: tuple[float, float] = (0.6, 0.8)
    """Share of the steps after which the second and the third stage begin [-]. BODex."""
    distances: tuple[float, float, float] = (0.01, 0.01, 0.0)
    """Contact distance of each stage [m]; the second ends in the pre-grasp. BODex."""
    step_position: float = 0.001
    """First step length of the base translation [m]. BODex: 0.1 times 0.01."""
    step_rotation: float = 0.02
    """First step length of the base rotation [rad]. BODex: 0.1 times 0.1 of a quaternion, which is
    half of the angle."""
    step_joints: float = 0.01
    """First step length of the joints [rad]. BODex: 0.1 times 0.1."""
    decay: float = 0.95
    """Factor of the step lengths after every period [-]. BODex."""
    period: int = 50
    """Steps of such a period [-]. BODex."""
    momentum: float = 0.9
    """m in v <- (m v + g) / 2, where g is the gradient of unit length [-]. BODex."""
    solve_every: int = 5
    """Steps between two solutions of the QPs; in between their forces stay [-]. BODex."""
    iterations: int = 40
    """Projected-gradient iterations of each solution, warm started [-]. Ours: BODex has ReLU-QP
    from zero, up to 1000."""

    def __post_init__(self) -> None:
        refuse_outside(self, "steps", 1, 100_000)
        if not 0.0 <= self.progress[0] <= self.progress[1] <= 1.0:
            raise BadConfig(
                f"BodexScheduleConfig.progress must be two shares in order, not {self.progress!r}"
            )
        for name in ("step_position", "step_rotation", "step_joints", "decay", "momentum"):
            refuse_outside(self, name, 0.0, 1.0)
        refuse_outside(self, "period", 1, 100_000)
        refuse_outside(self, "solve_every", 1, 100_000)
        refuse_outside(self, "iterations", 1, 100_000)

    @property
    def stage_ends(self) -> tuple[int, int, int]:
        """Step before which each stage ends."""
        first, second = (round(share * self.steps) for share in self.progress)
        return first, second, self.steps


def _qp() -> QPConfig:
    return QPConfig(mu=0.1, cone_sides=8, gamma=1.0, cap=1.0, beta=0.21)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodexConfig:
    """The baseline `bodex`: one closure over both hands, starts from the hull, no regions."""

    starts: BodexStartConfig = field(default_factory=BodexStartConfig)
    energy: BodexEnergyConfig = field(default_factory=BodexEnergyConfig)
    qp: QPConfig = field(default_factory=_qp)
    """The QP of all contacts together. BODex: friction 0.1, pyramids with 8 sides, sum of a hand's normal forces at least
    1, and 0.21 of the target, to which its reversed bounds of 0.19 and 0.21 come."""
    torque_length: float = 0.5
    """Length that makes torques comparable with forces, as a share of the box diagonal [-].
    BODex: half the diagonal."""
    schedule: BodexScheduleConfig = field(default_factory=BodexScheduleConfig)
    staging: StagingConfig = PLAIN_SQUEEZE
    """The squeeze: joints 2 q - q_pre; the base stays, and no joint torques. BODex."""
    selection: SelectionConfig = KEEP_EVERYTHING
    """Every attempt is kept: BODex's output is unfiltered."""

    def __post_init__(self) -> None:
        refuse_outside(self, "torque_length", 1e-3, 10.0)

    @property
    def steps(self) -> int:
        """Optimiser steps of each attempt."""
        return self.schedule.steps

    @property
    def normal_step(self) -> float:
        """Half width of the differences that give normals [m]."""
        return self.energy.normal_step

    @property
    def closure(self) -> ClosureConfig:
        """QPs whose residuals stand in the record, those of the default method."""
        return ClosureConfig()

    def energy_at(self, distance: float, contacts: int) -> EnergyConfig:
        """Weights of sums at a stage: means become sums, margins go to the spheres' reach.

        Args:
            distance: Contact distance of the stage [m].
            contacts: Of both hands.
        """
        own = self.energy
        eta = max(distance, own.least_eta)
        return EnergyConfig(
            distance=own.distance / contacts,
            penetration=own.collision / (2.0 * eta),
            self_penetration=own.self_collision,
            object_margin=0.0,
            table_margin=eta,
            self_margin=own.self_margin,
            inter_margin=own.self_margin,
            normal_step=own.normal_step,
        )
