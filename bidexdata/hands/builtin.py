"""Hands built from a list of links with `MjSpec`: no mesh, no download.

The list (specs/capsule_links.yaml) gives the right hand; the left hand is its mirror image x -> -x.
A mirrored rotation about axis a by angle q is the rotation about -M a by q, with M = diag(-1, 1, 1),
so both hands have the same limits and the same joint vector makes the mirrored pose.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bidexdata.config import from_plain, load_yaml
from bidexdata.errors import BadConfig
from bidexdata.frames import quat_from_rotation_vector
from bidexdata.hands.model import Side

if TYPE_CHECKING:
    import mujoco

Vector = tuple[float, float, float]
_MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """A fixed rotation of a link against its parent."""

    axis: Vector
    angle: float
    """[degrees]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkJoint:
    """The hinge of a link, through the link's origin."""

    name: str
    axis: Vector
    range: tuple[float, float]
    """[degrees]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """A box, sphere or capsule in the link's frame; exactly one of the three is given."""

    box: Vector | None = None
    """Centre [m]."""
    half: Vector | None = None
    """Half edges of the box [m]."""
    sphere: Vector | None = None
    """Centre [m]."""
    capsule: tuple[float, float, float, float, float, float] | None = None
    """Both ends of the axis [m]."""
    radius: float = 0.0
    """Of the sphere or capsule [m]."""
    colour: str = "skin"

    def __post_init__(self):
        if sum(x is not None for x in (self.box, self.sphere, self.capsule)) != 1:
            raise BadConfig("a shape is exactly one of box, sphere and capsule")


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """One body of the list."""

    name: str
    mass: float
    """[kg]; spread evenly over the volume of the shapes."""
    shapes: tuple[Shape, ...]
    parent: str = ""
    pos: Vector = (0.0, 0.0, 0.0)
    """Origin in the parent's frame [m]."""
    turn: Turn | None = None
    joint: LinkJoint | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkFile:
    """All links of a hand and how they are driven."""

    name: str
    joint: Mapping[str, float]
    actuator: Mapping[str, float]
    skin: tuple[float, float, float, float]
    frame: tuple[float, float, float, float]
    tip: tuple[float, float, float, float]
    links: tuple[Link, ...]
    finger: tuple[Link, ...]
    """Links of one finger, with {f} and {F} where its name goes."""
    fingers: tuple[str, ...]
    thumb: tuple[Link, ...]
    tendons: Mapping[str, tuple[str, str]]
    exclude: tuple[tuple[str, str], ...]

    def all_links(self) -> list[Link]:
        """Every link, parents before children."""
        fingers = [_named(link, f) for f in self.fingers for link in self.finger]
        return [*self.links, *fingers, *self.thumb]


def read_links(path: str | Path) -> LinkFile:
    """Read a list of links.

    Raises:
        PathNotFound: The file does not exist.
        BadConfig: It is no list of links.
    """
    return from_plain(LinkFile, load_yaml(path), f"link list {Path(path).name}:")


def build_hand(links: LinkFile, side: Side, prefix: str) -> mujoco.MjSpec:
    """Make the hand's `MjSpec`; the first link hangs under the world body without a joint.

    Args:
        links: The right hand.
        side: `left` builds the mirror image.
        prefix: Put before every name.
    """
    import mujoco

    spec = mujoco.MjSpec()
    spec.modelname = f"{links.name}_{side}"
    spec.compiler.degree = False
    bodies = {"": spec.worldbody}
    for link in links.all_links():
        bodies[link.name] = _add_link(bodies[link.parent], link, links, side, prefix)
    _add_actuators(spec, links, prefix)
    for a, b in links.exclude:
        spec.add_exclude(bodyname1=prefix + a, bodyname2=prefix + b)
    return spec


def _named(link: Link, finger: str) -> Link:
    def name(text: str) -> str:
        return text.format(f=finger, F=finger.upper())

    joint = link.joint and LinkJoint(
        name=name(link.joint.name), axis=link.joint.axis, range=link.joint.range
    )
    return Link(
        name=name(link.name), parent=name(link.parent), pos=link.pos, turn=link.turn,
        mass=link.mass, shapes=link.shapes, joint=joint,
    )  # fmt: skip


def _add_link(
    parent: mujoco.MjsBody,
    link: Link,
    links: LinkFile,
    side: Side,
    prefix: str,
) -> mujoco.MjsBody:
    import mujoco

    body = parent.add_body(name=prefix + link.name, pos=_vector(link.pos, side))
    if link.turn is not None:
        axis = _axis(link.turn.axis, side)
        body.quat = quat_from_rotation_vector(axis * np.radians(link.turn.angle))
    if link.joint is not None:
        body.add_joint(
            name=prefix + link.joint.name,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=_axis(link.joint.axis, side),
            range=np.radians(link.joint.range),
            limited=True,
            **_joint_constants(links),
        )
    volume = sum(_volume(shape) for shape in link.shapes)
    for shape in link.shapes:
        geom = _add_shape(body, shape, side)
        geom.mass = link.mass * _volume(shape) / volume
        geom.rgba = np.array(getattr(links, shape.colour))
    return body


def _joint_constants(links: LinkFile) -> dict[str, object]:
    # MuJoCo 4 keeps damping as a polynomial; its first coefficient is the linear one.
    constants = dict(links.joint)
    return {**constants, "damping": [constants["damping"], 0.0, 0.0]}


def _add_shape(body: mujoco.MjsBody, shape: Shape, side: Side) -> mujoco.MjsGeom:
    import mujoco

    if shape.box is not None:
        assert shape.half is not None
        kind = mujoco.mjtGeom.mjGEOM_BOX
        return body.add_geom(type=kind, pos=_vector(shape.box, side), size=list(shape.half))
    if shape.sphere is not None:
        kind = mujoco.mjtGeom.mjGEOM_SPHERE
        size = [shape.radius, 0.0, 0.0]
        return body.add_geom(type=kind, pos=_vector(shape.sphere, side), size=size)
    assert shape.capsule is not None
    ends = [_vector(shape.capsule[:3], side), _vector(shape.capsule[3:], side)]
    return body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=np.concatenate(ends),
        size=[shape.radius, 0.0, 0.0],
    )


def _add_actuators(spec: mujoco.MjSpec, links: LinkFile, prefix: str) -> None:
    import mujoco

    joints = {link.joint.name: link.joint for link in links.all_links() if link.joint is not None}
    tendon_of = {joint: name for name, pair in links.tendons.items() for joint in pair}
    for name, pair in links.tendons.items():
        tendon = spec.add_tendon(name=prefix + name)
        for joint in pair:
            tendon.wrap_joint(prefix + joint, 1.0)
    gain, force = links.actuator["gain"], links.actuator["force"]
    for target in dict.fromkeys(tendon_of.get(joint, joint) for joint in joints):
        parts = links.tendons.get(target, (target,))
        limits = np.radians(np.sum([joints[p].range for p in parts], axis=0))
        kind = "TENDON" if target in links.tendons else "JOINT"
        spec.add_actuator(
            name=f"{prefix}A_{target}",
            target=prefix + target,
            trntype=getattr(mujoco.mjtTrn, f"mjTRN_{kind}"),
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            gainprm=_padded([gain]),
            biasprm=_padded([0.0, -gain]),
            forcerange=[-force, force],
            forcelimited=True,
            ctrlrange=limits,
            ctrllimited=True,
        )


def _padded(values: list[float]) -> NDArray[np.float64]:
    return np.concatenate([values, np.zeros(10 - len(values))])


def _vector(v: tuple[float, ...], side: Side) -> NDArray[np.float64]:
    return np.asarray(v, np.float64) * (_MIRROR if side == "left" else 1.0)


def _axis(a: Vector, side: Side) -> NDArray[np.float64]:
    return np.asarray(a, np.float64) * (-_MIRROR if side == "left" else 1.0)


def _volume(shape: Shape) -> float:
    if shape.half is not None:
        return 8.0 * float(np.prod(shape.half))
    sphere = 4.0 / 3.0 * np.pi * shape.radius**3
    if shape.capsule is None:
        return sphere
    length = float(np.linalg.norm(np.subtract(shape.capsule[3:], shape.capsule[:3])))
    return sphere + np.pi * shape.radius**2 * length
