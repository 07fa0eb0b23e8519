"""From the source that a spec names to the model of the hand alone.

The source (Menagerie entry, built-in list of links or MJCF file) is cut down with `MjSpec`: the
root body moves to the origin of the world, everything above it goes, and so do the actuators,
tendons and exclusions that referred to it, and what is only looked at: skins and the pictures of
textures. The result is kept as XML text with its assets, from which `make_spec` gives fresh copies.
The text keeps six digits, and a `Hand` is read from it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.errors import BadConfig
from bidexdata.hands.mjcf_files import (
    MjcfFile,
    licence_beside,
    read_file,
    read_menagerie,
    used_assets,
    without_pictures,
)
from bidexdata.hands.model import Side
from bidexdata.hands.spec import HandSpec
from bidexdata.wording import one_line

if TYPE_CHECKING:
    import mujoco

# Put before every name while the hand is cut out, and taken from the text afterwards: MuJoCo warns
# about attaching without a prefix.
_MARK = "cut-out-"
_SHAPES = ("sphere", "capsule", "cylinder", "box", "mesh")
_INSTEAD = "use --hand capsule"


@dataclass(frozen=True, slots=True)
class HandMjcf:
    """The MJCF of one hand with its root under the world body, and what it was made from."""

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


def load_model(spec: HandSpec, side: Side, folder: Path, *, top: str | None = None) -> HandMjcf:
    """Load and cut down the model of one side.

    Args:
        spec: The hand.
        side: Which of its sides.
        folder: Folder of the YAML spec; relative paths start here.
        top: A body above the root, without the side's prefix, where the model is cut instead: the
            hand with its wrist, as an arm carries it.

    Raises:
        NotUsable: The source cannot be had or does not fit the spec.
        BadConfig: MuJoCo cannot read the source or a mesh that it names, or refuses the hand.
    """
    side_spec = spec.side(side)
    key = f"sides.{side}.source"
    kind, _, name = side_spec.source.partition(":")
    if kind == "menagerie":
        file = read_menagerie(name, what="hand", instead=_INSTEAD)
    elif kind == "builtin":
        file = _from_links(folder / name, side, side_spec.prefix)
    else:
        file = read_file(folder / side_spec.source, key, what="hand")
    try:
        xml = _hand_xml(file, spec, side_spec.prefix, top or spec.root)
    except ValueError as err:
        raise BadConfig(f"{key}: {file.path}: MuJoCo refuses the hand ({one_line(err)})") from err
    return HandMjcf(
        xml=xml,
        assets=used_assets(xml, file.assets),
        digest=file.digest,
        licence_text=licence_beside(file.path),
    )


def mounted_spec(spec: HandSpec, side: Side, folder: Path, top: str) -> mujoco.MjSpec:
    """Give a fresh `MjSpec` of the hand cut at the body `top` above its root.

    Raises:
        NotUsable: The source cannot be had or does not fit the spec.
        BadConfig: The model has no such body, or it does not carry the root.
    """
    return load_model(spec, side, folder, top=top).make_spec()


def _hand_xml(file: MjcfFile, spec: HandSpec, prefix: str, top: str) -> str:
    """Write the hand alone as XML text.

    Raises:
        BadConfig: The source does not fit the spec.
        ValueError: MuJoCo refuses the hand.
    """
    hand = _cut_at(file.spec, prefix + top)
    root = hand.body(_MARK + prefix + spec.root)
    if root is None:
        raise BadConfig(
            f"the body {top!r} of the model does not carry the hand's root {spec.root!r}"
        )
    if spec.joint_armature is not None:
        for joint in _joints_below(root):
            joint.armature = spec.joint_armature
    for a, b in spec.exclude_contacts:
        _exclude(hand, prefix + a, prefix + b)
    hand.assets = dict(file.assets)
    hand.compile()
    # Attaching nests the source's `main` defaults in ours; the two need two names.
    return hand.to_xml().replace(f'"{_MARK}main"', '"source"').replace(_MARK, "")


def _joints_below(body: mujoco.MjsBody) -> list[mujoco.MjsJoint]:
    below = [joint for child in body.bodies for joint in _joints_below(child)]
    return [*body.joints, *below]


def _from_links(path: Path, side: Side, prefix: str) -> MjcfFile:
    from bidexdata.config import fingerprint
    from bidexdata.hands.builtin import build_hand, read_links

    links = read_links(path)
    return MjcfFile(path, build_hand(links, side, prefix), {}, fingerprint(links, length=64))


def _cut_at(source: mujoco.MjSpec, root: str) -> mujoco.MjSpec:
    import mujoco

    body = source.body(root)
    if body is None:
        names = ", ".join(b.name for b in source.bodies if b.name != "world")
        raise BadConfig(f"the model has no body {root!r} for the hand's root; bodies: {names}")
    hand = mujoco.MjSpec()
    hand.modelname = source.modelname
    hand.copy_during_attach = True
    # Attached values lose against the parent's, so the parent takes them over first.
    hand.option = source.option
    hand.compiler.degree, hand.compiler.autolimits = False, source.compiler.autolimits
    hand.worldbody.add_frame().attach_body(body, _MARK, "")
    hand.meshdir = source.meshdir
    kept = hand.body(_MARK + root)
    gone = {joint.name for joint in kept.joints}
    for joint in list(kept.joints):
        hand.delete(joint)
    for actuator in list(hand.actuators):
        if actuator.target in gone:
            hand.delete(actuator)
    kept.pos, kept.quat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    geoms = [geom for b in hand.bodies for geom in b.geoms]
    _refuse_shapes(geoms)
    meshes = {geom.meshname for geom in geoms}
    unused = [mesh for mesh in hand.meshes if mesh.name not in meshes]
    for asset in (*unused, *hand.hfields, *hand.skins):
        hand.delete(asset)
    without_pictures(hand)
    return hand


def _refuse_shapes(geoms: Iterable[mujoco.MjsGeom]) -> None:
    """Refuse collision geometry that the sphere fit cannot measure, and height fields at all."""
    for geom in geoms:
        kind = geom.type.name.removeprefix("mjGEOM_").lower()
        collides = geom.contype or geom.conaffinity
        if kind not in _SHAPES and (collides or kind == "hfield"):
            raise BadConfig(
                f"body {geom.parent.name.removeprefix(_MARK)!r} of the model has a geom of type {kind}; "
                f"hands collide as {', '.join(_SHAPES)}"
            )


def _exclude(hand: mujoco.MjSpec, a: str, b: str) -> None:
    for name in (a, b):
        if hand.body(_MARK + name) is None:
            raise BadConfig(f"exclude_contacts names the body {name!r}, which the model lacks")
    if {_MARK + a, _MARK + b} not in [{e.bodyname1, e.bodyname2} for e in hand.excludes]:
        hand.add_exclude(bodyname1=_MARK + a, bodyname2=_MARK + b)
