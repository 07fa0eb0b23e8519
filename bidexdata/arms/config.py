"""ArmConfig: how the motion of two arms is searched, smoothed, timed and checked."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from bidexdata.arms.inverse_kinematics import IkConfig
from bidexdata.config import refuse_outside
from bidexdata.errors import BadConfig
from bidexdata.record.fields import PHASES


@dataclass(frozen=True, slots=True, kw_only=True)
class ClearanceConfig:
    """What counts as a collision."""

    margin: float = 0.0
    """Clearance by spheres below which a posture of the search collides [m]."""
    enough: float = 0.03
    """Clearance beyond which more does not make a posture better [m]."""
    asked: float = 0.03
    """Clearance by spheres below which MuJoCo is asked [m], at the place itself and half way to those
    that are looked at before and behind it: links stand out of their spheres by 0.025 m at most."""
    spacing: float = 0.05
    """Farthest that a link or a hand goes between two places that spheres look at [m]. More of them cost
    spheres, fewer cost MuJoCo, which is asked the sooner the farther they are apart."""
    finest: float = 0.0065
    """Farthest that one goes between two places that MuJoCo is asked about, where it finds so little
    room that an overlap may lie between them [m]. Motions that were played ten times as finely meet
    nothing that this misses."""
    depth: float = 0.001
    """Overlap that MuJoCo may find [m]."""
    reach: float = 0.01
    """Larger clearances are stored as this [m]. Half of it costs MuJoCo as much: it is asked at more
    places."""

    def __post_init__(self) -> None:
        refuse_outside(self, "margin", -0.1, 0.1)
        refuse_outside(self, "enough", 0, 1)
        refuse_outside(self, "asked", 0, 1)
        refuse_outside(self, "spacing", 0.005, 1)
        refuse_outside(self, "finest", 0.001, 1)
        refuse_outside(self, "depth", 0, 0.01)
        refuse_outside(self, "reach", 0.001, 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class PathConfig:
    """Where the hands go, and at how many knots."""

    standoff: float = 0.12
    """From the pre-grasp back: along the palm's normal, or where the open hand would come through the
    object that way, in the direction of those tried that leaves most room [m]."""
    lowest: float = 0.02
    """Least height of a hand's lowest point over the table at the stand-off [m]."""
    lift: float = 0.10
    """Way up after the squeeze [m] (BODex, and the paper's test l)."""
    squeeze_palm: Literal["moves", "fixed"] = "moves"
    """Whether the palms go on to the stored squeeze (the paper's formula on all of G), or stay at
    the grasp and fingers alone close (BODex)."""
    knots: tuple[int, int, int, int, int] = (40, 5, 5, 3, 5)
    """Knots of approach, reach, close, squeeze and lift, the first knot of all not counted. Straight
    lines in space need about one knot in two centimetres."""
    seconds: tuple[float, float, float, float, float] = (1.0, 0.5, 0.4, 0.4, 1.0)
    """Least time of each of them [s]; closing and squeezing as in test l."""
    speed: float = 0.5
    """Share of the joints' largest speeds that is used [-]."""
    largest_step: float = 0.2
    """Largest turn of a joint between two knots [rad]."""

    def __post_init__(self) -> None:
        refuse_outside(self, "standoff", 0.01, 1)
        refuse_outside(self, "lowest", -1, 1)
        refuse_outside(self, "lift", 0.001, 1)
        refuse_outside(self, "speed", 0.01, 1)
        refuse_outside(self, "largest_step", 0.01, 1)
        if len(self.knots) != len(PHASES) or not all(1 <= n <= 1000 for n in self.knots):
            raise BadConfig(
                f"PathConfig.knots must be a number from 1 to 1000 for each of "
                f"{', '.join(PHASES)}, not {self.knots!r}"
            )
        if len(self.seconds) != len(PHASES) or not all(0 < s <= 60 for s in self.seconds):
            raise BadConfig(
                f"PathConfig.seconds must be a time up to 60 s for each of {', '.join(PHASES)}, "
                f"not {self.seconds!r}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchConfig:
    """How much is tried before a grasp is given up."""

    near_rest: int = 16
    """Starts of the inverse kinematics near the rest posture, besides `ik.starts` [-]."""
    rest_spread: float = 1.0
    """How far they lie beside it [rad]."""
    kept: int = 8
    """Postures of an arm that are taken through their waypoints, best first; the next as many only
    where none of those is free [-]."""
    pairs: int = 12
    """Pairs of postures of the two arms that are tried [-]."""
    words: int = 3
    """Of those, how many MuJoCo may refuse [-]."""
    straight: float = 5.0
    """What a metre that the hand leaves the straight line to the stand-off by counts, where joints move
    in straight lines, against turns away from rest [rad/m]: of postures that are about as good, the one
    whose way looks least roundabout."""
    back_off: float = 0.15
    """Where the straight way from home to the stand-off is blocked, it goes by a pose this much
    farther back, one this much higher, or both [m]."""
    detours: int = 3
    """Postures of an arm for which that is tried [-]."""
    plans: int = 1
    """Postures of an arm to which a way is planned after that [-]."""
    nodes: int = 96
    """Postures that a plan may go over [-]; 0: none is made."""
    neighbours: int = 8
    """Nearest postures that each of them may go on to [-]."""
    spread: float = 1.5
    """How far they lie beside the straight line in joint space [rad]."""
    replans: int = 16
    """Ways that the planner checks, shortest first [-]."""
    standoffs: int = 3
    """Stand-offs of a hand that are tried, where the open hand meets something on its way from one to
    the pre-grasp [-]."""
    step: float = 0.1
    """Largest turn of a joint between checks of a way [rad]."""

    def __post_init__(self) -> None:
        for name in (
            "near_rest",
            "kept",
            "pairs",
            "words",
            "detours",
            "plans",
            "neighbours",
            "replans",
        ):
            refuse_outside(self, name, 1, 1024)
        refuse_outside(self, "standoffs", 1, 6)
        refuse_outside(self, "nodes", 0, 4096)
        refuse_outside(self, "straight", 0, 1000)
        refuse_outside(self, "back_off", 0.01, 1)
        refuse_outside(self, "spread", 0, 10)
        refuse_outside(self, "rest_spread", 0, 10)
        refuse_outside(self, "step", 0.01, 1)


def just_above(clearance: float) -> float:
    """A clearance that is surely not below another after rounding: more need not be known [m]."""
    return clearance + 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmConfig:
    """Everything that decides which motion a grasp gets, besides the robot."""

    ik: IkConfig = field(default_factory=lambda: IkConfig(starts=16))
    """Both arms must find a posture that is free, so there are more starts than for one target."""
    clearance: ClearanceConfig = field(default_factory=ClearanceConfig)
    path: PathConfig = field(default_factory=PathConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
