"""HandSpec: what the YAML file of a hand says, checked.

A spec names one model per side and adds what MJCF lacks: root body, contact points, palm frame,
postures, coupling, fingers and the settings of the sphere fit. Body and joint names stand without
the side's prefix. Geometry is written for the side `written_for`; the other side's is its mirror
image (mirror.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

import numpy as np

from bidexdata.config import OMIT_NONE, fingerprint, from_plain, load_yaml
from bidexdata.errors import BadConfig
from bidexdata.hands.model import Part, Side

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactSpec:
    """One predefined contact point: a small sphere that models a finger pad or a place of the palm."""

    name: str
    body: str
    pos: Vector
    """Centre of the sphere in the body's frame [m]."""
    radius: float
    """[m]."""
    normal: Vector
    """Outward direction in which the pad should meet the object, body frame; any length."""
    finger: str = ""
    """Key of `fingers`; empty for a place of the palm."""
    part: Part = "fingertip"
    """What of the hand it is; contact sets (contact_sets.py) are made of parts."""

    def __post_init__(self):
        if (self.part == "palm") != (self.finger == ""):
            raise BadConfig(
                f"contact {self.name}: name its finger, or say part: palm for a place without one"
            )
        if not 0 < self.radius < 0.1:
            raise BadConfig(f"contact {self.name}: radius must be in (0, 0.1) m, not {self.radius}")
        if not np.linalg.norm(self.normal) > 1e-6:
            raise BadConfig(f"contact {self.name}: the normal has no length")


@dataclass(frozen=True, slots=True, kw_only=True)
class PalmFrameSpec:
    """The palm frame in the hand frame."""

    pos: Vector
    """A point on the palm's surface [m]."""
    x: Vector
    """Towards the fingertips."""
    z: Vector
    """Out of the palm, towards the object."""

    def __post_init__(self):
        if abs(np.linalg.norm(self.x) - 1) > 1e-6 or abs(np.linalg.norm(self.z) - 1) > 1e-6:
            raise BadConfig("palm_frame: x and z must be unit vectors")
        if abs(np.dot(self.x, self.z)) > 1e-6:
            raise BadConfig("palm_frame: x and z must be perpendicular")


@dataclass(frozen=True, slots=True, kw_only=True)
class SideSpec:
    """Where the model of one side comes from."""

    source: str
    """`menagerie:ROBOT/ENTRY`, `builtin:FILE` (beside the spec) or the path of an MJCF file."""
    prefix: str = ""
    """What this side's names carry before the names of the spec."""
    palm_frame: PalmFrameSpec | None = field(default=None, metadata=OMIT_NONE)
    """The palm frame of the side that the spec is not written for, where the two hand frames are
    no mirror images of each other; the mirror image is then taken from palm frame to palm frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PostureSpec:
    """Two starting postures as joint angles [rad]; joints that are not named stand at zero."""

    open: Mapping[str, float]
    """For flat regions."""
    curved: Mapping[str, float]
    """For curved regions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SphereFitSpec:
    """Settings of the greedy sphere cover (spheres.py); lengths in metres."""

    min_radius: float = 0.006
    max_radius: float = 0.0135
    protrusion: float = 0.0015
    """How far a sphere may stand out of the collision geometry."""
    slack: float = 0.3
    """A surface sample within this share of a sphere's radius outside it counts as covered [-]."""
    worth: float = 4e-4
    """Area that a further sphere must newly cover [m^2]: corners of boxes are not worth one ..."""
    worth_share: float = 0.06
    """... or this share of the body's surface, if that is less [-]: fingertips are small."""
    thin: float = 0.003
    """Parts of less than twice this thickness get no sphere."""
    spacing: float = 0.004
    """Distance between candidate centres and between surface samples."""

    def __post_init__(self):
        if not 0 < self.min_radius <= self.max_radius:
            raise BadConfig("spheres: 0 < min_radius <= max_radius is required")
        if not self.worth > 0:
            raise BadConfig(f"spheres: worth must be positive, not {self.worth}")
        if not 0 < self.spacing <= 0.01:
            raise BadConfig(f"spheres: spacing must be in (0, 0.01] m, not {self.spacing}")


@dataclass(frozen=True, slots=True, kw_only=True)
class HandSpec:
    """One hand, both sides."""

    name: str
    description: str
    licence: str
    sides: Mapping[str, SideSpec]
    """Keys `left`, `right`."""
    written_for: Literal["left", "right"]
    """The side whose geometry `contacts` and `palm_frame` give."""
    root: str
    """Body that becomes the root; what lies above it is removed."""
    fingers: Mapping[str, tuple[str, ...]]
    """Bodies of each finger, base to tip."""
    contacts: tuple[ContactSpec, ...]
    palm_frame: PalmFrameSpec
    postures: PostureSpec
    coupled: Mapping[str, str]
    """Follower joint -> the joint whose angle it takes in the optimiser."""
    exclude_contacts: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies that never collide, besides those of the source."""
    spheres: SphereFitSpec = field(default_factory=SphereFitSpec)
    mirror: Literal["x", "y", "z"] | None = field(default=None, metadata=OMIT_NONE)
    """Axis of the hand frame that the other side's mirror image turns round: x where it is omitted.
    Without effect where that side gives its own palm frame."""
    joint_armature: float | None = field(default=None, metadata=OMIT_NONE)
    """Inertia that every joint gets, in place of the model's [kg m^2]: that of the motor's rotor,
    times the gear ratio squared. Without it fingers are so light that contacts throw light objects."""

    def __post_init__(self):
        if not self.sides or not set(self.sides) <= {"left", "right"}:
            raise BadConfig(f"hand {self.name}: sides must be left, right or both")
        if self.joint_armature is not None and not 0 < self.joint_armature < 1:
            raise BadConfig(
                f"hand {self.name}: joint_armature must lie in (0, 1) kg m^2, not "
                f"{self.joint_armature}"
            )
        if self.written_for not in self.sides:
            raise BadConfig(f"hand {self.name}: written_for names a side that sides lacks")
        for contact in self.contacts:
            if contact.part != "palm" and contact.finger not in self.fingers:
                raise BadConfig(
                    f"hand {self.name}: contact {contact.name} names finger {contact.finger!r}; "
                    f"fingers are {', '.join(self.fingers)}"
                )
        if self.sides[self.written_for].palm_frame is not None:
            raise BadConfig(
                f"hand {self.name}: the {self.written_for} side's palm frame is the spec's own; only "
                "the other side may give one under `sides`"
            )
        if not self.contacts:
            raise BadConfig(
                f"hand {self.name}: contacts is empty; a hand touches with at least one"
            )
        tips = [contact.part == "fingertip" for contact in self.contacts]
        if not tips[0] or tips != sorted(tips, reverse=True):
            raise BadConfig(
                f"hand {self.name}: contacts must begin with the fingertips (at least one); pads and "
                "places of the palm come behind them"
            )
        names = [contact.name for contact in self.contacts]
        if len(set(names)) != len(names):
            raise BadConfig(f"hand {self.name}: two contacts have the same name")

    def side(self, side: Side) -> SideSpec:
        """Give the source of one side.

        Raises:
            BadConfig: The spec has no such side.
        """
        if side not in self.sides:
            raise BadConfig(
                f"hand {self.name} has no {side} side; its spec gives {', '.join(self.sides)}"
            )
        return self.sides[side]

    def content_hash(self) -> str:
        """sha256 over what the spec says; comments, layout and omitted keys do not count."""
        return fingerprint(self, length=64)


def read_spec(path: str | Path) -> HandSpec:
    """Read and check a YAML spec.

    Raises:
        PathNotFound: The file does not exist.
        BadConfig: It is no YAML mapping, or a value is impossible.
        UnknownKey: A key does not exist.
    """
    data = load_yaml(path)
    where = f"hand spec {Path(path).name}"
    optional = {"exclude_contacts", "spheres", "mirror", "joint_armature"}
    missing = {f.name for f in fields(HandSpec)} - set(data) - optional
    if missing:
        raise BadConfig(f"{where} lacks {', '.join(sorted(missing))}")
    return from_plain(HandSpec, data, f"{where}:")
