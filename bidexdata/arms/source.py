"""From the source that a rig names to the model of one arm, with the rig's limits.

Keyframes, lights, cameras and pictures of textures go: attaching an arm to a scene would bring them
along. Joint ranges and torque limits are those of the rig. The result is kept as XML text with its
assets, from which `make_spec` gives fresh copies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bidexdata.arms.spec import ArmSpec, JointSpec, RigSpec
from bidexdata.errors import BadConfig
from bidexdata.hands.mjcf_files import (
    licence_beside,
    read_file,
    read_menagerie,
    used_assets,
    without_pictures,
)
from bidexdata.wording import one_line

if TYPE_CHECKING:
    import mujoco


_ROUNDED = 1e-3
"""By how much limits of rig and model may differ as they are rounded [rad, -]."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmMjcf:
    """The MJCF of one arm as it stands at the origin, and what it was made from."""

    spec: ArmSpec
    xml: str
    assets: Mapping[str, bytes]
    """Mesh files by the name that the XML gives."""
    digest: str
    """sha256 over every source file."""
    licence_text: str
    """The licence file beside the source; empty where there is none."""

    def make_spec(self) -> mujoco.MjSpec:
        """Give a fresh `MjSpec`."""
        import mujoco

        return mujoco.MjSpec.from_string(self.xml, assets=dict(self.assets))


def load_arm(arm: ArmSpec, rig: RigSpec, folder: Path, key: str) -> ArmMjcf:
    """Load the model of an arm.

    Args:
        arm: What the rig says of it.
        rig: The rig, for the contacts that it excludes.
        folder: Folder of the rig's YAML file; relative paths start here.
        key: Key of the rig's spec, for messages.

    Raises:
        PathNotFound: There is no such file.
        BadConfig: MuJoCo cannot read the model or a mesh that it names, or it does not fit the rig.
        NotUsable: The model cannot be had.
    """
    kind, _, name = arm.source.partition(":")
    if kind == "menagerie":
        file = read_menagerie(name, what="arm", instead="use a rig whose models are files")
    else:
        file = read_file(folder / arm.source, f"{key}.source", what="rig")
    try:
        xml = _arm_xml(file.spec, file.assets, arm, rig, key)
    except ValueError as err:
        raise BadConfig(f"{key}: {file.path}: MuJoCo refuses the arm ({one_line(err)})") from err
    assets = used_assets(xml, file.assets)
    return ArmMjcf(arm, xml, assets, file.digest, licence_beside(file.path))


def _arm_xml(
    spec: mujoco.MjSpec, assets: Mapping[str, bytes], arm: ArmSpec, rig: RigSpec, key: str
) -> str:
    """Write the arm as XML text.

    Raises:
        BadConfig: The source does not fit the rig.
        ValueError: MuJoCo refuses the arm.
    """
    gone = [*spec.keys, *spec.lights, *spec.cameras, *spec.skins, *spec.hfields]
    for element in gone:
        spec.delete(element)
    without_pictures(spec)
    _check_joints(spec, arm, key)
    servos = {actuator.target: actuator for actuator in spec.actuators}
    limits = _model_limits(spec, assets)
    for joint in spec.joints:
        said = arm.joints[joint.name]
        _check_limits(joint, said, limits.get(joint.name), key)
        joint.range, joint.limited = [said.lower, said.upper], True
        servo = servos.get(joint.name)
        if servo is None:
            raise BadConfig(f"{key}: joint {joint.name!r} of the model has no actuator")
        servo.forcerange, servo.forcelimited = [-said.torque, said.torque], True
    bodies = {body.name for body in spec.bodies}
    excluded = [{e.bodyname1, e.bodyname2} for e in spec.excludes]
    for pair in rig.exclude_contacts:
        if not set(pair) <= bodies and rig.right_arm is None:
            name = next(n for n in pair if n not in bodies)
            raise BadConfig(
                f"exclude_contacts names the body {name!r}, which the arm lacks; it has "
                f"{', '.join(sorted(bodies - {'world'}))}"
            )
        if set(pair) <= bodies and set(pair) not in excluded:
            spec.add_exclude(bodyname1=pair[0], bodyname2=pair[1])
    first = next(body for body in spec.bodies if body.joints)
    if first.parent.name != "world":
        # MuJoCo filters parent and child, but not where the parent stands still.
        spec.add_exclude(bodyname1=first.parent.name, bodyname2=first.name)
    spec.assets = dict(assets)
    spec.compile()
    return spec.to_xml()


class _Limits(NamedTuple):
    """What the model says of a joint; infinite where it says nothing."""

    lower: float
    upper: float
    torque: float


def _model_limits(spec: mujoco.MjSpec, assets: Mapping[str, bytes]) -> dict[str, _Limits]:
    """Ranges and torque limits of the source, by the name of the joint."""
    spec.assets = dict(assets)
    model = spec.compile()
    torque = {}
    for u in range(model.nu):
        if model.actuator_forcelimited[u]:
            torque[int(model.actuator_trnid[u, 0])] = float(model.actuator_forcerange[u].max())
    found = {}
    for j in range(model.njnt):
        low, high = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
        found[model.joint(j).name] = _Limits(float(low), float(high), torque.get(j, np.inf))
    return found


def _check_limits(joint: mujoco.MjsJoint, said: JointSpec, model: _Limits | None, key: str) -> None:
    assert model is not None
    if said.lower < model.lower - _ROUNDED or said.upper > model.upper + _ROUNDED:
        raise BadConfig(
            f"{key}.joints.{joint.name}: the range [{said.lower:g}, {said.upper:g}] rad leaves the "
            f"model's, [{model.lower:g}, {model.upper:g}]"
        )
    if said.torque > model.torque * (1 + _ROUNDED):
        raise BadConfig(
            f"{key}.joints.{joint.name}: a torque of {said.torque:g} N m is more than the model's "
            f"limit of {model.torque:g}"
        )


def _check_joints(spec: mujoco.MjSpec, arm: ArmSpec, key: str) -> None:
    import mujoco

    found = [joint.name for joint in spec.joints]
    if found != list(arm.joints):
        raise BadConfig(
            f"{key}.joints must be those of the model in its order, {', '.join(found) or 'none'}; "
            f"they are {', '.join(arm.joints)}"
        )
    for joint in spec.joints:
        if joint.type != mujoco.mjtJoint.mjJNT_HINGE:
            raise BadConfig(
                f"{key}: joint {joint.name!r} of the model is no hinge; arms need those"
            )
    if not any(arm.flange in (s.name for s in items) for items in (spec.sites, spec.bodies)):
        sites = ", ".join(s.name for s in spec.sites) or "none"
        raise BadConfig(
            f"{key}.flange: the model has no site or body {arm.flange!r}; its sites: {sites}"
        )
