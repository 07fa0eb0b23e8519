"""Arms, their hands and the fixtures of a rig in one `mujoco.MjSpec`.

Names in the spec: arm i carries the prefix `arm<i>/`, and the hand on it, with forearm and wrist,
`hand<i>/`, as in scenes of floating hands. Fixtures are geoms of the world body.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.arms.source import ArmMjcf
from bidexdata.arms.spec import MountSpec, PlaceSpec, RigSpec
from bidexdata.errors import BadConfig
from bidexdata.frames import invert, pos_quat, transform
from bidexdata.hands.model import FloatArray, Hand
from bidexdata.simulation.assembly import hand_prefix

if TYPE_CHECKING:
    import mujoco

FIXTURE = "fixture"


class Flange(NamedTuple):
    """Where a hand is mounted on the model of an arm."""

    body: str
    T_body_flange: FloatArray


def arm_prefix(index: int) -> str:
    """Prefix of every name of arm number `index` in the scene."""
    return f"arm{index}/"


def fixture_name(index: int) -> str:
    """Name of the geom of one fixture."""
    return f"{FIXTURE}{index}"


def top_body(hand: Hand, mount: MountSpec) -> str:
    """Name, with the side's prefix, of the hand's body that sits on the flange."""
    return hand.root_body if mount.top is None else hand.prefix + mount.top


def mounted_hand(hand: Hand, mount: MountSpec) -> mujoco.MjSpec:
    """The hand as an arm carries it.

    Raises:
        BadConfig: The mount names a body that the hand's source lacks.
    """
    if mount.top is None:
        return hand.make_spec()
    if hand.make_mounted is None:
        raise BadConfig(f"hand {hand.name} has no source to take the body {mount.top!r} from")
    return hand.make_mounted(mount.top)


def T_flange_top(hand: Hand, mount: MountSpec) -> FloatArray:
    """Frame of the hand's body on the flange, in the flange's frame, (4, 4)."""
    T = transform(
        np.array(mount.pos), np.asarray(mount.quat_wxyz) / np.linalg.norm(mount.quat_wxyz)
    )
    return T if mount.top is not None else T @ invert(hand.T_hand_palm)


def find_flange(arm: ArmMjcf) -> Flange:
    """Where the arm's model has its flange."""
    model = arm.make_spec().compile()
    name = arm.spec.flange
    sites = {model.site(i).name: i for i in range(model.nsite)}
    if name in sites:
        site = sites[name]
        T = transform(model.site_pos[site], model.site_quat[site])
        return Flange(model.body(int(model.site_bodyid[site])).name, T)
    return Flange(name, np.eye(4))


def add_arm(
    spec: mujoco.MjSpec,
    index: int,
    arm: ArmMjcf,
    place: PlaceSpec,
    hand: Hand | None,
    mount: MountSpec | None = None,
) -> None:
    """Attach an arm at its place, and the hand on its flange.

    Options of the scene, gains and contact numbers are the caller's to set, on the compiled model.

    Args:
        spec: The scene; written to.
        index: Number of the arm and its hand: 0 left, 1 right.
        arm: The arm's model.
        place: Where it stands.
        hand: The hand; none for an arm alone.
        mount: How it is held; needed with a hand.
    """
    child = arm.make_spec()
    child.option = spec.option
    quat = np.asarray(place.quat_wxyz) / np.linalg.norm(place.quat_wxyz)
    frame = spec.worldbody.add_frame(pos=list(place.pos), quat=quat)
    spec.attach(child, prefix=arm_prefix(index), frame=frame)
    if hand is None:
        return
    assert mount is not None
    flange = find_flange(arm)
    held = mounted_hand(hand, mount)
    held.option = spec.option
    pos, quat = pos_quat(flange.T_body_flange @ T_flange_top(hand, mount))
    carrier = spec.body(arm_prefix(index) + flange.body)
    spec.attach(held, prefix=hand_prefix(index), frame=carrier.add_frame(pos=pos, quat=quat))
    top = spec.body(hand_prefix(index) + top_body(hand, mount))
    top.pos, top.quat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    if mount.mass > 0:
        plate = carrier.add_body(name=f"{arm_prefix(index)}adapter")
        plate.explicitinertial, plate.mass = True, mount.mass
        plate.ipos = list(flange.T_body_flange[:3, 3])
        plate.inertia = [1e-3 * mount.mass] * 3


def add_fixtures(spec: mujoco.MjSpec, rig: RigSpec, arms: int = 2) -> None:
    """Add the boxes that stand still, and let them pass the links that always touch them.

    Args:
        spec: The scene with its arms; written to.
        rig: The rig.
        arms: Number of arms in the scene.
    """
    import mujoco

    for number, box in enumerate(rig.fixtures):
        spec.worldbody.add_geom(
            name=fixture_name(number),
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=list(box.pos),
            size=list(box.half),
        )
    for index in range(arms):
        for body in spec.bodies:
            if body.name.startswith(arm_prefix(index)) and body.joints:
                spec.add_exclude(bodyname1="world", bodyname2=body.name)
                break


def arm_spec(
    rig: RigSpec, index: int, arm: ArmMjcf, hand: Hand | None, mount: MountSpec | None
) -> mujoco.MjSpec:
    """One arm of a rig at its place with its hand, alone in the world: what chains are read from."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.modelname = rig.name
    add_arm(spec, index, arm, rig.place("right" if index else "left"), hand, mount)
    return spec
