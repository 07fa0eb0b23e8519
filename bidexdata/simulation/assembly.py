"""Put hands, one object and an optional table into one `mujoco.MjSpec`, and compile it.

Frames: the spec's world is the record's world; the object's body frame is the object frame, with
the centre of mass at its origin; each hand's root body is the hand frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from bidexdata.hands.model import Hand
from bidexdata.objects.prepared import Solid
from bidexdata.objects.simulated import add_pieces

from .settings import SceneSettings

if TYPE_CHECKING:
    import mujoco

OBJECT_BODY = "object"
TABLE_GEOM = "table"


def hand_prefix(index: int) -> str:
    """Prefix of every name of hand number `index` in the scene; hands may share their names."""
    return f"hand{index}/"


def mocap_name(index: int) -> str:
    """Name of the mocap body to which hand number `index` is welded."""
    return f"mocap{index}"


def base_names(index: int) -> tuple[str, ...]:
    """Names of the joints, and of their actuators, that carry hand number `index` on slides."""
    return tuple(f"{hand_prefix(index)}base_{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz"))


def joint_actuator(joint: str) -> str:
    """Name of the actuator of one joint where every joint has its own."""
    return f"own_{joint}"


def scene_spec(
    hands: Sequence[Hand], solid: Solid | None, size: float, settings: SceneSettings, *, table: bool
) -> mujoco.MjSpec:
    """Assemble the scene as a spec.

    Contact, gain and solver numbers are set by `scene.apply_settings`.

    Args:
        hands: Hands in the order of the record's H axis.
        solid: The object; none for a scene of hands alone.
        size: Bounding-box diagonal of the object [m].
        settings: Numbers of the scene.
        table: Add the plane z = 0.
    """
    import mujoco

    spec = mujoco.MjSpec()
    spec.modelname = "scene"
    for index, hand in enumerate(hands):
        _add_hand(spec, hand, index, settings)
    if solid is not None:
        add_object(spec, solid, size, settings.density_of(solid, size))
    if table:
        spec.worldbody.add_geom(
            name=TABLE_GEOM, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0]
        )
    return spec


def _add_hand(spec: mujoco.MjSpec, hand: Hand, index: int, settings: SceneSettings) -> None:

    child = hand.make_spec()
    # Options of the scene are set on the compiled model: equal ones here keep `attach` quiet.
    child.option = spec.option
    drop_pictures(child)
    for body in child.bodies:
        body.gravcomp = settings.hand_gravity_compensation
    if settings.actuators == "joints":
        _actuate_every_joint(child, hand)
    prefix = hand_prefix(index)
    spec.attach(child, prefix=prefix, frame=spec.worldbody.add_frame())
    root = spec.body(prefix + hand.root_body)
    root.pos, root.quat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    if settings.base == "weld":
        _weld(spec, root, hand, index, settings)
    else:
        _slide(spec, root, index, settings)
    exclude_bodies(spec, hand, index, settings)


def exclude_bodies(spec: mujoco.MjSpec, hand: Hand, index: int, settings: SceneSettings) -> None:
    """Let the bodies of a hand in the scene pass each other that the settings exclude."""
    prefix = hand_prefix(index)
    names = dict(zip(hand.plain_body_names, hand.body_names, strict=True))
    for first, second in settings.excluded_bodies:
        if first in names and second in names:
            spec.add_exclude(bodyname1=prefix + names[first], bodyname2=prefix + names[second])


def _weld(
    spec: mujoco.MjSpec, root: mujoco.MjsBody, hand: Hand, index: int, settings: SceneSettings
) -> None:
    import mujoco

    prefix = hand_prefix(index)
    root.add_freejoint(name=prefix + "root")
    spec.worldbody.add_body(name=mocap_name(index), mocap=True)
    weld = spec.add_equality(
        name=prefix + "weld",
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=mocap_name(index),
        name2=prefix + hand.root_body,
        solref=list(settings.weld_solref),
        solimp=list(settings.weld_solimp),
    )
    # anchor, relative position, relative quaternion, torque scale
    data = np.zeros_like(weld.data)
    data[:3] = data[3:6] = settings.weld_anchor
    data[6], data[10] = 1.0, settings.weld_torque_scale
    weld.data = data


def _slide(spec: mujoco.MjSpec, root: mujoco.MjsBody, index: int, settings: SceneSettings) -> None:
    """Carry a hand on three slides and three hinges, z last: R = Rx Ry Rz."""
    import mujoco

    for number, name in enumerate(base_names(index)):
        slides = number < 3
        kp, damping = settings.slide_gains if slides else settings.hinge_gains
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        root.add_joint(
            name=name,
            type=kind,
            axis=list(np.eye(3)[number % 3]),
            pos=list(settings.weld_anchor),
            damping=[damping],
        )
        servo = spec.add_actuator(
            name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrllimited=False
        )
        servo.set_to_position(kp=kp)


def _actuate_every_joint(child: mujoco.MjSpec, hand: Hand) -> None:
    """Replace a hand's actuators by one of every joint: gain and force are those of the one before."""
    import mujoco

    model = child.copy().compile()
    gains, limits = model.actuator_gainprm[:, 0], model.actuator_forcerange
    strongest = np.abs(hand.actuator_moment) > 0
    for actuator in list(child.actuators):
        child.delete(actuator)
    for j, joint in enumerate(hand.joint_names):
        mine = np.flatnonzero(strongest[:, j])
        servo = child.add_actuator(
            name=joint_actuator(joint), target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        servo.set_to_position(kp=float(gains[mine[0]]) if len(mine) else 1.0)
        if len(mine) and model.actuator_forcelimited[mine[0]]:
            servo.forcelimited, servo.forcerange = 1, limits[mine[0]]


def drop_pictures(child: mujoco.MjSpec) -> None:
    """Remove geoms that never collide from a model, where the body's inertia is given without them.

    Their meshes are most of the time that compiling takes.
    """
    for body in child.bodies:
        if not body.explicitinertial:
            continue
        for geom in list(body.geoms):
            if geom.contype == 0 and geom.conaffinity == 0:
                child.delete(geom)
    used = {geom.meshname for geom in child.geoms}
    for mesh in list(child.meshes):
        if mesh.name not in used:
            child.delete(mesh)


def add_object(spec: mujoco.MjSpec, solid: Solid, size: float, density: float) -> None:
    """Add the object on a free joint, its mass explicit."""
    body = spec.worldbody.add_body(name=OBJECT_BODY)
    body.add_freejoint(name=OBJECT_BODY)
    inertia = solid.inertia_at(size, density)
    body.explicitinertial = True
    body.mass = solid.mass(size, density)
    body.ipos = [0.0, 0.0, 0.0]
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    add_pieces(spec, body, solid.pieces, size)
