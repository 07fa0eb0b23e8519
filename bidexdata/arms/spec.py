"""RigSpec: what the YAML file of a rig says, checked.

A rig is two arms with their places in the world, and the mounts that hold hands. It names no hand of
a run: mounts are keyed by the names of hands, with `"*"` for any other. World frame: z up, x
forward from the robot, y left; the table's surface is z = 0. Lengths in metres, angles in radians.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from bidexdata.config import OMIT_NONE, fingerprint, from_plain, load_yaml
from bidexdata.errors import BadConfig
from bidexdata.hands.model import Side

Vector = tuple[float, float, float]
Quat = tuple[float, float, float, float]

ANY_HAND = "*"
"""Key of the mount for hands that have none of their own."""
LARGEST_ANGLE = math.pi + 1e-3
"""Joint limits lie within a turn [rad]: of the postures that differ by whole turns one is enough."""
MOST_JOINTS = 10
"""Joints of an arm and the wrist that it carries: the kernels keep that many in registers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSpec:
    """One joint of an arm."""

    lower: float
    """[rad]."""
    upper: float
    """[rad]."""
    velocity: float
    """Largest speed [rad/s]."""
    torque: float
    """Largest torque of the motor [N m]."""

    def __post_init__(self):
        if not -LARGEST_ANGLE <= self.lower < self.upper <= LARGEST_ANGLE:
            raise BadConfig(
                f"JointSpec.lower and upper must be rising and lie within -pi and pi, not "
                f"{self.lower:g} and {self.upper:g}"
            )
        for name in ("velocity", "torque"):
            if not 0 < getattr(self, name) < math.inf:
                raise BadConfig(f"JointSpec.{name} must be positive, not {getattr(self, name)!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmSpec:
    """One model of an arm."""

    source: str
    """`menagerie:ROBOT/ENTRY` or the path of an MJCF file beside the spec."""
    licence: str
    flange: str
    """Site or body of the model on which a hand is mounted, z out of the flange."""
    payload: float
    """Rated load [kg]: hand, adapter and what it holds."""
    joints: Mapping[str, JointSpec]
    """All joints of the model, base to flange."""

    def __post_init__(self):
        if not 0 < self.payload < math.inf:
            raise BadConfig(f"ArmSpec.payload must be positive, not {self.payload!r}")
        if not 1 <= len(self.joints) <= MOST_JOINTS:
            raise BadConfig(f"ArmSpec.joints must name 1 to {MOST_JOINTS}, not {len(self.joints)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceSpec:
    """Where one arm stands and where it rests."""

    pos: Vector
    """Origin of the arm's model in the world [m]."""
    quat_wxyz: Quat
    """Its orientation."""
    rest: tuple[float, ...]
    """Angles of the arm's joints at rest [rad]: home, and what postures are drawn to."""

    def __post_init__(self):
        _require_turn(self.quat_wxyz, "PlaceSpec.quat_wxyz")


@dataclass(frozen=True, slots=True, kw_only=True)
class MountSpec:
    """How a hand is held by a flange, in the flange's frame."""

    pos: Vector = (0.0, 0.0, 0.0)
    """Of the palm frame, or with `top` of that body's frame [m]."""
    quat_wxyz: Quat = (1.0, 0.0, 0.0, 0.0)
    """Orientation of the same."""
    mass: float = 0.0
    """Of the adapter [kg]."""
    top: str | None = field(default=None, metadata=OMIT_NONE)
    """Body of the hand's source above the hand's root that sits on the flange, such as a forearm;
    the root itself where it is omitted."""
    wrist_joints: tuple[str, ...] = ()
    """Joints between `top` and the root, from the arm to the hand; they move with the arm."""
    wrist_rest: tuple[float, ...] = ()
    """Their angles at rest [rad]."""
    wrist_velocity: float = 2.0
    """Their largest speed [rad/s]; Shadow's own URDF limits both joints so (sr_common, wrist and palm)."""

    def __post_init__(self):
        _require_turn(self.quat_wxyz, "MountSpec.quat_wxyz")
        if not 0 <= self.mass < math.inf:
            raise BadConfig(f"MountSpec.mass must be zero or more, not {self.mass!r}")
        if len(self.wrist_rest) != len(self.wrist_joints):
            raise BadConfig("MountSpec.wrist_rest must give one angle for each of wrist_joints")
        if self.wrist_joints and self.top is None:
            raise BadConfig("MountSpec.wrist_joints need `top`, the body that sits on the flange")
        if not self.wrist_velocity > 0:
            raise BadConfig(f"MountSpec.wrist_velocity must be positive, not {self.wrist_velocity}")


@dataclass(frozen=True, slots=True, kw_only=True)
class FixtureSpec:
    """A post, beam or pedestal that stands still: an upright box.

    It stops arms with their hands, and nothing else.
    """

    pos: Vector
    """Middle, world [m]."""
    half: Vector
    """Half edges along the world's axes [m]."""

    def __post_init__(self):
        if not all(0 < h < math.inf for h in self.half):
            raise BadConfig(f"FixtureSpec.half must be three positive lengths, not {self.half}")


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSpec:
    """Two arms."""

    name: str
    description: str
    arm: ArmSpec
    left: PlaceSpec
    right: PlaceSpec
    mounts: Mapping[str, MountSpec]
    """By the name of the hand; `"*"` for any other."""
    fixtures: tuple[FixtureSpec, ...] = ()
    exclude_contacts: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies of one arm that never collide, besides those of the model: links whose
    collision geometry always overlaps. The first moving link never collides with fixtures and
    table: it turns on what stands on them."""
    right_arm: ArmSpec | None = field(default=None, metadata=OMIT_NONE)
    """The right arm, where it is another model."""

    def __post_init__(self):
        for side in ("left", "right"):
            wanted, given = len(self.arm_of(side).joints), len(self.place(side).rest)
            if wanted != given:
                raise BadConfig(
                    f"RigSpec.{side}.rest must give {wanted} angles, one per joint, not {given}"
                )
            for (name, joint), angle in zip(
                self.arm_of(side).joints.items(), self.place(side).rest, strict=True
            ):
                if not joint.lower <= angle <= joint.upper:
                    raise BadConfig(
                        f"RigSpec.{side}.rest: {name} = {angle:g} lies outside its limits "
                        f"[{joint.lower:g}, {joint.upper:g}] rad"
                    )
        if not self.mounts:
            raise BadConfig("RigSpec.mounts is empty; give one for a hand, or '*' for any")
        for hand, mount in self.mounts.items():
            wrist = len(mount.wrist_joints)
            if max(len(self.arm_of(s).joints) for s in ("left", "right")) + wrist > MOST_JOINTS:
                raise BadConfig(
                    f"RigSpec.mounts.{hand}: arm and wrist have more than {MOST_JOINTS} joints"
                )

    def place(self, side: Side) -> PlaceSpec:
        """Where the arm of one side stands."""
        return self.left if side == "left" else self.right

    def arm_of(self, side: Side) -> ArmSpec:
        """The arm of one side."""
        return self.right_arm if side == "right" and self.right_arm is not None else self.arm

    def mount(self, hand: str) -> MountSpec:
        """The mount of a hand.

        Raises:
            BadConfig: The rig has none for it.
        """
        found = self.mounts.get(hand, self.mounts.get(ANY_HAND))
        if found is None:
            raise BadConfig(
                f"rig {self.name} has no mount for the hand {hand!r}, only for "
                f"{', '.join(self.mounts)}; add one under `mounts`"
            )
        return found

    def content_hash(self) -> str:
        """sha256 over what the spec says; comments, layout and omitted keys do not count."""
        return fingerprint(self, length=64)


def read_rig(path: str | Path) -> RigSpec:
    """Read and check a YAML spec.

    Raises:
        PathNotFound: The file does not exist.
        BadConfig: It is no YAML mapping, lacks a key, or a value is impossible.
        UnknownKey: A key does not exist.
    """
    where = f"rig {Path(path).name}"
    data = load_yaml(path)
    missing = {f.name for f in fields(RigSpec)} - set(data) - _OPTIONAL
    if missing:
        raise BadConfig(f"{where} lacks {', '.join(sorted(missing))}")
    for key, kind in (("arm", ArmSpec), ("right_arm", ArmSpec), ("left", PlaceSpec),
                      ("right", PlaceSpec)):  # fmt: skip
        part = data.get(key)
        lacking = {f.name for f in fields(kind)} - set(part) if isinstance(part, Mapping) else set()
        if lacking:
            raise BadConfig(f"{where}: {key} lacks {', '.join(sorted(lacking))}")
    return from_plain(RigSpec, data, f"{where}:")


_OPTIONAL = {"fixtures", "exclude_contacts", "right_arm"}


def _require_turn(quat: Quat, name: str) -> None:
    if abs(float(np.linalg.norm(quat)) - 1) > 1e-4:
        raise BadConfig(f"{name} must have length 1, not {float(np.linalg.norm(quat)):g}")
