"""SceneSettings: every number of the simulated scene that is not a pose.

The defaults are those of protocol `paper-1`. The paper fixes density, friction and gravity. Solver,
contacts of the hand, gains, exclusions and the softness of the weld are DexGraspBench's
(`hand_util.py` and the hand's notes); the point that the weld holds is not, and docs/protocols.md
lists where else the protocol departs from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from bidexdata.errors import BadConfig

if TYPE_CHECKING:
    from bidexdata.objects.prepared import Solid

GRAVITY = 9.8
"""Of protocols, of what hands squeeze for and of what arms must carry [m/s^2] (paper, section 6)."""
HANDS_DEPTH = 0.010
"""Hands deeper in each other than this are no grasp [m]. DexGraspBench start check: 10 mm."""
TABLE_DEPTH = 0.005
"""Nor are hands deeper in the table [m]. Ours: half the start check, because the squeeze's target,
which the hands only press towards, reaches deeper than the start."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneSettings:
    """Contact, solver, weld and actuator parameters of a scene.

    Source:
        DexGraspBench `hand_util.py` (solver, contacts, gains, welds but for their anchor,
        exclusions); BiDexGrasp, section 6 (density, friction).
    """

    timestep: float = 0.004
    """Time from one simulation step to the next [s]."""
    impratio: float = 10.0
    """Frictional to normal constraint impedance of elliptic cones [-]."""
    noslip_iterations: int = 2
    """Passes of the no-slip post-processor; without it grips creep and light objects fall late."""
    elliptic: bool = True
    """Elliptic friction cones; pyramids lose grasps that hold (measured: 4 of 24)."""
    solver_iterations: int = 100
    """Upper bound of Newton iterations per step."""
    tolerance: float = 1e-8
    """Relative improvement at which the solver stops [-]."""

    friction_slide: float = 0.6
    """Tangential friction of every geom [-] (paper, section 6)."""
    friction_spin: float = 0.02
    """Torsional friction of every geom [m] (paper, section 6)."""
    friction_roll: float = 1e-4
    """Rolling friction [m]; without effect at condim 4, MuJoCo's default."""
    condim: int = 4
    """Contact dimension: normal, two tangents, spin."""
    density: float = 2.5
    """Density of the solid [kg/m^3] (paper, section 6, as printed)."""
    mass: float | None = None
    """Nominal mass of every object in place of a density [kg]; it belongs to the solid's nominal
    volume, so pieces of another volume weigh a little else (DexGraspBench)."""

    hand_solref: tuple[float, float] = (0.005, 1.0)
    """Time constant [s] and damping ratio of the hand's geoms; the object keeps the defaults."""
    hand_solimp: tuple[float, float, float] = (0.5, 0.99, 0.0001)
    """Impedance range [-] and width [m] of the hand's geoms."""
    excluded_bodies: tuple[tuple[str, str], ...] = (
        ("palm", "ffproximal"),
        ("palm", "mfproximal"),
        ("palm", "rfproximal"),
        ("lfmetacarpal", "lfproximal"),
        ("ffknuckle", "mfknuckle"),
        ("mfknuckle", "rfknuckle"),
    )
    """Pairs of one hand's bodies that do not collide, besides those that the hand's own model
    excludes; names without side prefix, pairs that a hand lacks are skipped."""

    actuators: Literal["hand", "joints"] = "hand"
    """The hand's own actuators (tendons of coupled joints included), or one for every joint."""
    actuator_kp: float | None = 5.0
    """Stiffness of every position actuator [N m/rad]; no derivative gain. None: the hand's own;
    a joint without an actuator of its own gets that of the tendon that moves it."""
    actuator_force: float | None = 3.0
    """Largest torque of an actuator, both signs [N m]; controls have no range. None: the hand's
    own, as for the stiffness."""

    base: Literal["weld", "slides"] = "weld"
    """How a hand is carried: a free joint welded to a mocap body, or three slides and three hinges
    with position actuators (the dummy arm of BimanDexGraspBench)."""

    weld_solref: tuple[float, float] = (0.02, 1.0)
    """Time constant [s] and damping ratio of the weld between hand root and mocap body."""
    weld_solimp: tuple[float, float, float, float, float] = (0.9, 0.95, 0.001, 0.5, 2.0)
    """Impedance of the weld."""
    weld_torque_scale: float = 1.0
    """Weight of the weld's rotation against its translation [m]."""
    weld_anchor: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Point of the hand frame that the weld holds, or that the hinges turn about [m]; ours is its
    origin, DexGraspBench's the root of its Shadow hand, 34 mm below the palm."""
    slide_gains: tuple[float, float] = (1000.0, 100.0)
    """Stiffness [N/m] and joint damping [N s/m] of a slide of the base."""
    hinge_gains: tuple[float, float] = (100.0, 10.0)
    """Stiffness [N m/rad] and joint damping [N m s/rad] of a hinge of the base."""
    hand_gravity_compensation: float = 0.0
    """Share of gravity that does not act on the hands [-]."""

    def __post_init__(self) -> None:
        for name in ("timestep", "impratio", "density", "tolerance", "weld_torque_scale"):
            self._require(name, "positive", good=0 < getattr(self, name) < math.inf)
        for name in ("mass", "actuator_kp", "actuator_force"):
            value = getattr(self, name)
            self._require(name, "positive", good=value is None or 0 < value < math.inf)
        for name in ("friction_slide", "friction_spin", "friction_roll", "noslip_iterations"):
            self._require(name, "zero or more", good=0 <= getattr(self, name) < math.inf)
        self._require("solver_iterations", "at least 1", good=self.solver_iterations >= 1)
        self._require("condim", "1, 3, 4 or 6", good=self.condim in (1, 3, 4, 6))
        for name in ("hand_solref", "weld_solref"):
            good = all(0 < v < math.inf for v in getattr(self, name))
            self._require(name, "two positive numbers", good=good)
        for name in ("hand_solimp", "weld_solimp"):
            self._require(name, _SOLIMP, good=_is_solimp(getattr(self, name)))
        for name in ("slide_gains", "hinge_gains"):
            stiffness, damping = getattr(self, name)
            good = 0 < stiffness < math.inf and 0 <= damping < math.inf
            self._require(name, "a positive stiffness and a damping of zero or more", good=good)
        finite = all(math.isfinite(v) for v in self.weld_anchor)
        self._require("weld_anchor", "three finite numbers", good=finite)
        share = self.hand_gravity_compensation
        self._require("hand_gravity_compensation", "a share from 0 to 1", good=0 <= share <= 1)

    def _require(self, name: str, what: str, *, good: bool) -> None:
        if not good:
            raise BadConfig(f"SceneSettings.{name} must be {what}, not {getattr(self, name)!r}")

    def density_of(self, solid: Solid, size: float) -> float:
        """Density [kg/m^3] of a solid at bounding-box diagonal `size` [m]."""
        return self.density if self.mass is None else self.mass / (solid.nominal_volume * size**3)


_SOLIMP = (
    "two impedances between 0 and 1, a width of zero or more, a midpoint in (0, 1), a power >= 1"
)


def _is_solimp(values: tuple[float, ...]) -> bool:
    """Whether MuJoCo would take an impedance, all of it or its first three numbers, as it stands."""
    least, most, width, *shape = values
    midpoint, power = shape or (0.5, 2.0)
    bounded = all(0 < v < 1 for v in (least, most, midpoint))
    return bounded and 0 <= width < math.inf and 1 <= power < math.inf
