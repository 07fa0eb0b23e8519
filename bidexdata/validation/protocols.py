"""Named, versioned validation protocols: every setting that can change a verdict.

A protocol is data. Any other setting is another name; execution choices that change no verdict
(early stops) are `validate.Execution` and no part of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from bidexdata.errors import BadConfig, NotUsable, UnknownName
from bidexdata.simulation.settings import SceneSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """How grasps are tested and measured. Times are simulated seconds."""

    name: str
    description: str
    """One sentence for `bidexdata protocols`."""
    tests: tuple[str, ...] = ("f",)
    """Tests that the protocol defines: f force closure."""
    scene: SceneSettings = field(default_factory=SceneSettings)

    start_depth: float = 0.01
    """The pre-grasp may overlap no deeper, hand-object or hand-hand [m] (DexGraspBench)."""
    segment_changes: int = 10
    """Equal control changes from pre-grasp to grasp, and again from grasp to squeeze."""
    segment_steps: int = 10
    """Simulation steps after each control change; 10 x 10 x 4 ms = 0.4 s a segment."""

    gravity: float = 9.8
    """Load of test f, along each object axis in both directions [m/s^2] (paper, section 6)."""
    hold: float = 3.0
    """Duration of each load [s] (paper, section 6)."""
    check_every: float = 0.1
    """Time between comparisons with the pose before closing [s]."""
    limit_pos: float = 0.05
    """The object's origin must stay closer than this [m] (paper, section 6)."""
    limit_rot: float = math.radians(15.0)
    """The object must turn less than this [rad] (paper, section 6)."""
    unstable_speed: float = 50.0
    """Faster than this the simulation counts as blown up [m/s]; free fall of 3 s reaches 29."""

    reach: float = 0.01
    """Finger distances are capped here, for CDC and contact distance [m] (DexGraspBench)."""
    contact_within: float = 0.002
    """A body closer than this to the object, or inside it, counts as in contact [m]."""

    def __post_init__(self) -> None:
        for name in ("segment_changes", "segment_steps", "hold", "check_every", "limit_pos"):
            if not getattr(self, name) > 0:
                raise BadConfig(f"protocol.{name} must be positive, not {getattr(self, name)!r}")
        if not 0 < self.limit_rot <= math.pi:
            raise BadConfig(f"protocol.limit_rot must be in (0, pi], not {self.limit_rot!r}")
        if self.steps_per_check < 1 or self.checks < 1:
            raise BadConfig("protocol.check_every must be at least a timestep and at most hold")

    @property
    def steps_per_check(self) -> int:
        """Simulation steps between checks."""
        return round(self.check_every / self.scene.timestep)

    @property
    def checks(self) -> int:
        """Checks per load."""
        return round(self.hold / self.check_every)

    @property
    def closing_time(self) -> float:
        """Duration of both closing segments [s]."""
        return 2 * self.segment_changes * self.segment_steps * self.scene.timestep


_PROTOCOLS = {
    "paper-1": Protocol(
        name="paper-1",
        description=(
            "BiDexGrasp, section 6: hands on welds, density 2.5 kg/m^3, gravity 9.8 m/s^2 along "
            "each object axis for 3 s after closing, limits 5 cm and 15 degrees"
        ),
    )
}


def protocol_names() -> tuple[str, ...]:
    """Names that `load_protocol` knows."""
    return tuple(_PROTOCOLS)


def load_protocol(name: str) -> Protocol:
    """Give a protocol by name.

    Raises:
        UnknownName: No protocol is called so.
    """
    if name not in _PROTOCOLS:
        raise UnknownName("protocol", name, protocol_names(), "`bidexdata protocols` lists them")
    return _PROTOCOLS[name]


def require_test(protocol: Protocol, test: str) -> None:
    """Refuse a test that the protocol does not define.

    Raises:
        NotUsable: It does not.
    """
    if test not in protocol.tests:
        known = ", ".join(protocol.tests)
        raise NotUsable(f"protocol {protocol.name!r} has no test {test!r}; it has: {known}")
