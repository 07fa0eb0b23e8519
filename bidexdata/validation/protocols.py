"""Named, versioned validation protocols: every setting that can change a verdict or a metric.

A protocol is data. Any other setting is another name; choices of execution that are not meant to
change a verdict (early ends) are `stages.Execution` and no part of it: `benchmarks/truth.py` counts
how often they do. The named ones are in `named.py`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from bidexdata.config import OMIT_NONE, from_plain, load_yaml, merge, to_plain
from bidexdata.errors import BadConfig, NotUsable, PathNotFound, UnknownName
from bidexdata.record.fields import DIRECTIONS, JUDGED, WITH_ARMS
from bidexdata.simulation.settings import GRAVITY, SceneSettings

from .arm_rules import ArmRules

WARP_SUFFIX = "-warp"
"""How the names of protocols end whose verdicts are MuJoCo Warp's, and no others."""
_FILES = (".yaml", ".yml")
_NAME = re.compile(r"[a-z0-9][a-z0-9_.-]{0,63}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Engine:
    """The engine that judged, where it is not MuJoCo's own: MuJoCo Warp, as it was.

    Versions count because the engine changes with them; the kind of device because a GPU adds in
    another order than a CPU.
    """

    backend: Literal["mujoco_warp"] = "mujoco_warp"
    device: Literal["cpu", "cuda"]
    mujoco_warp: str
    """Version of the engine."""
    warp: str
    """Version of Warp."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiftRules:
    """How test l lifts an object off the table."""

    height: float = 0.10
    """Way of the hands' targets along +z [m]."""
    changes: int = 50
    """Equal steps of the targets; 50 steps of 0.10 m are 2 mm each."""
    steps: int = 5
    """Simulation steps after each; 50 x 5 x 4 ms = 1.0 s."""
    hold: float = 3.0
    """Time after the lift through which the object is judged [s]; 0: once, at its end."""

    def __post_init__(self) -> None:
        _require_positive(self, "height", "changes", "steps")
        if not 0 <= self.hold < math.inf:
            raise BadConfig(f"LiftRules.hold must not be negative, got {self.hold!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricRules:
    """What PD, SPD, CDC and the contact figures count."""

    reach: float = 0.01
    """Finger distances are capped here, for CDC and contact distance [m] (DexGraspBench)."""
    contact_within: float = 0.002
    """A body closer than this to the object counts as in contact [m]."""
    uncounted_bodies: tuple[str, ...] = (
        *("ffknuckle", "mfknuckle", "rfknuckle", "lfknuckle", "thbase", "thhub"),
    )
    """Bodies that are never in contact, without side prefix (DexGraspBench counts 17 bodies of the
    Shadow hand: palm, metacarpal, and three of each finger)."""
    deep_counts: bool = True
    """A body deeper inside than that is in contact too; DexGraspBench compares the absolute
    distance, so to it such a body has no contact (its trap 9)."""
    fingers_by_prefix: bool = False
    """A finger's bodies are all whose names begin with its own, so that the little finger has the
    metacarpal too (DexGraspBench, its trap 3)."""
    table_is_hand: bool = False
    """The table counts as a hand: its contacts with the object enter PD and the start check, with
    hands SPD (DexGraspBench, its trap 1)."""
    last_body_counts: bool = True
    """The last body of the left hand, the last of the fork's scene, enters SPD; BimanDexGraspBench
    leaves it out (trap 2)."""
    full_broad_phase: bool = True
    """Pairs up to `reach` apart are all found. DexGraspBench changes margins after compiling, and
    the broad phase then misses some, whose fingers read as being at the reach."""

    def __post_init__(self) -> None:
        _require_positive(self, "reach", "contact_within")


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """How grasps are tested and measured. Times are simulated seconds."""

    name: str
    """Under which verdicts are stored; other settings need another."""
    description: str
    """One sentence for `bidexdata protocols`."""
    tests: tuple[str, ...] = tuple(t for t in JUDGED if t not in WITH_ARMS)
    """Tests that the protocol defines: f force closure, l lift off a table, a lift with arms."""
    scene: SceneSettings = field(default_factory=SceneSettings)

    start_depth: float = 0.01
    """The pre-grasp may overlap no deeper, hand-object or hand-hand [m] (DexGraspBench)."""
    segment_changes: int = 10
    """Equal control changes from pre-grasp to grasp, and again from grasp to squeeze."""
    segment_steps: int = 10
    """Simulation steps after each control change; 10 x 10 x 4 ms = 0.4 s a segment."""

    load: Literal["gravity", "force"] = "gravity"
    """Gravity on everything, or a force at the object's centre of mass alone, which then is
    `gravity` times the nominal mass (DexGraspBench)."""
    gravity: float = GRAVITY
    """The load: along each direction in test f, down in test l [m/s^2] (paper, section 6)."""
    directions: tuple[str, ...] = DIRECTIONS
    """Loads of test f in the order in which they are applied, along the object's axes."""
    load_after: float | None = field(default=None, metadata=OMIT_NONE)
    """How long after closing the loads of test f begin [s]; None: at once."""
    hold: float = 3.0
    """Duration of each load of test f [s] (paper, section 6)."""
    lift: LiftRules = field(default_factory=LiftRules)
    check_every: float = 0.1
    """Time between comparisons with the pose before closing [s]."""
    check_closing: bool = True
    """Test f compares once before the load too: what leaves the limits while closing fails."""
    limit_pos: float = 0.05
    """The object's origin must stay closer than this [m] (paper, section 6)."""
    limit_rot: float = math.radians(15.0)
    """The object must turn less than this [rad] (paper, section 6)."""
    reference: Literal["centre_of_mass", "source_origin"] = "centre_of_mass"
    """The point whose displacement counts: the object frame's origin, or that of the source's
    coordinates, where DexGraspBench has its body frame."""
    unstable_speed: float = 50.0
    """Faster than this the simulation counts as blown up [m/s]; free fall of 3 s reaches 29."""

    metrics: MetricRules = field(default_factory=MetricRules)
    arm: ArmRules | None = field(default=None, metadata=OMIT_NONE)
    """How test a drives the arms; None where the protocol has no such test."""
    engine: Engine | None = field(default=None, metadata=OMIT_NONE)
    """Whose verdicts they are; None: those of MuJoCo's C engine. `backends.on_backend` sets it."""

    def __post_init__(self) -> None:
        counts = ("segment_changes", "segment_steps")
        times = ("hold", "check_every", *(("load_after",) if self.load_after is not None else ()))
        _require_positive(self, *counts, *times, "gravity", "limit_pos", "unstable_speed")
        if not 0 <= self.start_depth < math.inf:
            raise BadConfig(f"Protocol.start_depth must not be negative, got {self.start_depth!r}")
        if not 0 < self.limit_rot <= math.pi:
            raise BadConfig(f"Protocol.limit_rot must be in (0, pi], not {self.limit_rot!r}")
        if self.steps_per_check < 1 or self.checks < 1:
            raise BadConfig("Protocol.check_every must be at least a timestep and at most hold")
        if self.lift.hold > 0 and self.lift_checks < 1:
            raise BadConfig("Protocol.lift.hold must be 0 or at least check_every")
        for name, of, unit in (
            ("check_every", "scene.timestep", self.scene.timestep),
            ("load_after", "scene.timestep", self.scene.timestep),
            ("hold", "check_every", self.check_every),
            ("lift.hold", "check_every", self.check_every),
        ):
            time = self.lift.hold if name == "lift.hold" else getattr(self, name)
            if time is not None and not math.isclose(round(time / unit) * unit, time):
                raise BadConfig(
                    f"Protocol.{name} must be a multiple of {of} ({unit:g} s), not {time!r}"
                )
        unknown = [t for t in self.tests if t not in JUDGED]
        if unknown or not self.tests:
            known = ", ".join(JUDGED)
            raise BadConfig(f"Protocol.tests may name {known}, not {list(self.tests)!r}")
        if self.arm is None and set(self.tests) & set(WITH_ARMS):
            raise BadConfig("Protocol.tests: test a needs `arm`, how the arms are driven")
        wrong = [d for d in self.directions if d not in DIRECTIONS]
        if wrong or not self.directions or len(set(self.directions)) < len(self.directions):
            known = ", ".join(DIRECTIONS)
            raise BadConfig(
                f"Protocol.directions may name each of {known} once, not {list(self.directions)!r}"
            )
        if not _NAME.fullmatch(self.name):
            raise BadConfig(
                f"Protocol.name {self.name!r}: use lower-case letters, digits, dots and dashes"
            )
        if self.name.endswith(WARP_SUFFIX) != (self.engine is not None):
            raise BadConfig(
                f"Protocol.name {self.name!r}: {WARP_SUFFIX!r} ends the names of protocols whose "
                "verdicts are MuJoCo Warp's, and only theirs"
            )

    @property
    def backend(self) -> Literal["mujoco", "mujoco_warp"]:
        """The back end whose verdicts are this protocol's."""
        return "mujoco" if self.engine is None else self.engine.backend

    @property
    def steps_per_check(self) -> int:
        """Simulation steps between checks."""
        return round(self.check_every / self.scene.timestep)

    @property
    def checks(self) -> int:
        """Checks per load of test f."""
        return round(self.hold / self.check_every)

    @property
    def lift_checks(self) -> int:
        """Checks after the lift of test l; 0: one at its very end."""
        return round(self.lift.hold / self.check_every)

    @property
    def closing_time(self) -> float:
        """Duration of both closing segments [s]."""
        return 2 * self.segment_changes * self.segment_steps * self.scene.timestep


def _require_positive(rules: object, *names: str) -> None:
    for name in names:
        value = getattr(rules, name)
        if not 0 < value < math.inf:
            raise BadConfig(f"{type(rules).__name__}.{name} must be positive, not {value!r}")


def without_arms(protocol: Protocol) -> Protocol:
    """The protocol as tests of floating hands see it.

    Raises:
        NotUsable: It has no other test.
    """
    tests = tuple(test for test in protocol.tests if test not in WITH_ARMS)
    if not tests:
        raise NotUsable(f"protocol {protocol.name!r} has no test without arms")
    return replace(protocol, tests=tests, arm=None)


def protocol_names() -> tuple[str, ...]:
    """Names that `load_protocol` knows without a file."""
    from .named import NAMED

    return tuple(NAMED)


def load_protocol(name: str | Path) -> Protocol:
    """Give a protocol by name, or read one from a YAML file.

    A file may name a `base`, a known protocol or another file whose settings it changes; it needs
    a `name` and a `description` of its own.

    Args:
        name: A name from `protocol_names`, or the path of a `.yaml` or `.yml` file.

    Raises:
        UnknownName: No protocol is called so.
        PathNotFound: The file does not exist.
        BadConfig: The file has an unknown key or an impossible value, or is its own base.
        NotUsable: The file takes the name of a known protocol for other settings, or the name
            is that of verdicts of MuJoCo Warp.
    """
    from .named import NAMED

    text = str(name)
    if text.endswith(_FILES):
        return _from_file(Path(text))
    base = text.removesuffix(WARP_SUFFIX)
    if base != text and base in NAMED:
        raise NotUsable(
            f"{text!r} is how verdicts of MuJoCo Warp are stored: use --protocol {base} "
            "--backend mujoco_warp"
        )
    if text not in NAMED:
        raise UnknownName(
            "protocol", text, NAMED, "`bidexdata protocols` lists them, and a YAML file works"
        )
    return NAMED[text]


def protocol_from(data: Any, where: str) -> Protocol:
    """Rebuild a protocol from the plain data that a run or release stores.

    Raises:
        BadConfig: It is none.
    """
    return from_plain(Protocol, data, f"{where}:")


def _from_file(path: Path, above: tuple[Path, ...] = ()) -> Protocol:
    """Read a file.

    Args:
        path: The file.
        above: The files, resolved, whose base it is.
    """
    chain = (*above, path.resolve())
    if chain[-1] in above:
        names = " -> ".join(p.name for p in chain[above.index(chain[-1]) :])
        raise BadConfig(f"{path}: a protocol cannot be its own base ({names})")
    data = load_yaml(path)
    base = data.pop("base", None)
    missing = [key for key in ("name", "description") if key not in data]
    if missing:
        raise BadConfig(f"{path}: a protocol needs its own {' and '.join(missing)}")
    if base is not None:
        data = merge(to_plain(_base(str(base), path, chain)), data)
    protocol = protocol_from(data, str(path))
    require_own_name(protocol, f"{path}: ")
    return protocol


def _base(name: str, path: Path, chain: tuple[Path, ...]) -> Protocol:
    """The protocol that a file changes: a named one, or a file found from its own folder.

    Raises:
        BadConfig: There is none; the message names the file that asks for it.
    """
    if name.endswith(_FILES):
        other = path.parent / name
        if not other.is_file():
            raise BadConfig(f"{path}: base: {PathNotFound(other, 'a YAML file')}")
        return _from_file(other, chain)
    try:
        return load_protocol(name)
    except NotUsable as err:  # no such name, or one of MuJoCo Warp's verdicts
        raise BadConfig(f"{path}: base: {err}") from err


def require_own_name(protocol: Protocol, where: str = "") -> None:
    """Refuse other settings under the name of a known protocol, or of it judged by another engine.

    Args:
        protocol: Any.
        where: What the message begins with.

    Raises:
        NotUsable: The name is that of a known protocol and the settings are not.
    """
    from .named import NAMED

    known = NAMED.get(protocol.name.removesuffix(WARP_SUFFIX))
    if known is None:
        return
    if protocol.engine is not None:  # whose description says so in words of its own
        known = replace(
            without_arms(known),
            name=protocol.name,
            description=protocol.description,
            engine=protocol.engine,
        )
    if protocol.arm is None:  # stored before there were arms, or another engine's
        known = without_arms(known)
    if protocol != known:
        raise NotUsable(
            f"{where}{protocol.name!r} is the name of a protocol with other settings; choose "
            "another name"
        )


def require_test(protocol: Protocol, test: str) -> None:
    """Refuse a test that the protocol does not define.

    Raises:
        NotUsable: It does not.
    """
    if test not in protocol.tests:
        known = ", ".join(protocol.tests)
        raise NotUsable(f"protocol {protocol.name!r} has no test {test!r}; it has: {known}")
