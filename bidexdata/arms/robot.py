"""Robot: a rig with the two hands of a run mounted on it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bidexdata.arms.arm_spheres import ArmSpheres, fit_arm_spheres
from bidexdata.arms.assembly import add_arm, add_fixtures, arm_spec, top_body
from bidexdata.arms.chain import Chain, read_chain
from bidexdata.arms.keyed_cache import KeyedCache
from bidexdata.arms.registry import Rig
from bidexdata.arms.source import ArmMjcf
from bidexdata.arms.spec import FixtureSpec, MountSpec, PlaceSpec
from bidexdata.errors import BadConfig, NotUsable
from bidexdata.hands.model import Hand, Side
from bidexdata.simulation.assembly import TABLE_GEOM, hand_prefix

if TYPE_CHECKING:
    import mujoco


Known = Callable[[str], tuple[ArmSpheres, ArmSpheres] | None]
"""Gives the spheres of both arms of the robot with a digest, where they are known."""


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """One arm of a robot, with its hand."""

    side: Side
    model: ArmMjcf
    """The arm alone."""
    place: PlaceSpec
    mount: MountSpec
    chain: Chain
    """From the world to the hand frame."""
    spheres: ArmSpheres
    fixtures: tuple[FixtureSpec, ...]
    """What stands still beside the arms."""
    carried: float
    """Mass of hand and adapter [kg]."""


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """Two arms with their hands, left first."""

    rig: Rig
    hands: tuple[Hand, Hand]
    arms: tuple[Arm, Arm]
    digest: str
    """sha256 over the rig and both hands."""

    @property
    def joints(self) -> int:
        """Length of the axis of arm joints: of the longer chain."""
        return max(arm.chain.joints for arm in self.arms)


_ROBOTS = KeyedCache[Robot](8)


def mount_robot(
    rig: Rig,
    hands: Sequence[Hand],
    known: Known | None = None,
) -> Robot:
    """Mount a left and a right hand on a rig; the same robot for the same rig and hands.

    Args:
        rig: The rig.
        hands: Left and right.
        known: Gives the arms' spheres for the robot's digest, where they were fitted before; most of
            the time that mounting takes is fitting them.

    Raises:
        NotUsable: There are not two hands, left and right.
        BadConfig: The rig has no mount for a hand, or the mount does not fit it.
    """
    if [hand.side for hand in hands] != ["left", "right"]:
        sides = ", ".join(hand.side for hand in hands) or "none"
        raise NotUsable(f"a rig carries a left and a right hand, in this order, not: {sides}")
    key = (rig.digest, *(hand.spec_hash for hand in hands))
    return _ROBOTS.get(key, lambda: _mounted(key, rig, (hands[0], hands[1]), known))


def robot_spec(robot: Robot, *, table: bool = True) -> mujoco.MjSpec:
    """Both arms with their hands, the fixtures and the table, without options of a protocol."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.modelname = robot.rig.spec.name
    for index, (arm, hand) in enumerate(zip(robot.arms, robot.hands, strict=True)):
        add_arm(spec, index, arm.model, arm.place, hand, arm.mount)
    add_fixtures(spec, robot.rig.spec)
    if table:
        spec.worldbody.add_geom(
            name=TABLE_GEOM, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0]
        )
    return spec


def _mounted(
    key: tuple[str, ...], rig: Rig, hands: tuple[Hand, Hand], known: Known | None
) -> Robot:
    digest = hashlib.sha256(" ".join(key).encode()).hexdigest()
    spheres = (known(digest) if known is not None else None) or (None, None)
    left, right = (_arm(rig, hands[i], i, spheres[i]) for i in range(2))
    return Robot(rig, hands, (left, right), digest)


def _arm(rig: Rig, hand: Hand, index: int, spheres: ArmSpheres | None) -> Arm:
    side = hand.side
    arm, place, mount = rig.arm(side), rig.spec.place(side), rig.spec.mount(hand.name)
    model = arm_spec(rig.spec, index, arm, hand, mount).compile()
    rest = np.array([*place.rest, *mount.wrist_rest])
    speeds = [joint.velocity for joint in arm.spec.joints.values()]
    chain = read_chain(
        model,
        hand_prefix(index) + hand.root_body,
        rest,
        np.array([*speeds, *[mount.wrist_velocity] * len(mount.wrist_joints)]),
        wrist=len(mount.wrist_joints),
    )
    _check_names(chain, arm, hand, mount)
    bodies = _arm_bodies(model, index, hand)
    carried = mount.mass + float(model.body_subtreemass[_top(model, index, hand, mount)])
    return Arm(
        side=side,
        model=arm,
        place=place,
        mount=mount,
        chain=chain,
        spheres=spheres or fit_arm_spheres(model, chain, bodies),
        fixtures=rig.spec.fixtures,
        carried=carried,
    )


def _top(model: mujoco.MjModel, index: int, hand: Hand, mount: MountSpec) -> int:
    return int(model.body(hand_prefix(index) + top_body(hand, mount)).id)


def _arm_bodies(model: mujoco.MjModel, index: int, hand: Hand) -> list[str]:
    """Bodies of the arm, and those of the hand's source above its root."""
    names = [model.body(b).name for b in range(1, model.nbody)]
    own = {hand_prefix(index) + name for name in hand.body_names}
    return [n for n in names if n not in own and not n.endswith("/adapter")]


def _check_names(chain: Chain, arm: ArmMjcf, hand: Hand, mount: MountSpec) -> None:
    wanted = [*arm.spec.joints, *(hand.prefix + name for name in mount.wrist_joints)]
    if list(chain.joint_names) != wanted:
        raise BadConfig(
            f"mounts: the joints between flange and hand are {', '.join(chain.joint_names)}, and "
            f"the rig names {', '.join(wanted)}"
        )
    for name, angle, low, high in zip(
        chain.joint_names, chain.rest, chain.lower, chain.upper, strict=True
    ):
        if not low <= angle <= high:
            raise BadConfig(
                f"mounts: wrist_rest of {name} = {angle:g} lies outside its limits "
                f"[{low:g}, {high:g}] rad"
            )
