"""From the source that a spec names to the model of the hand alone.

The source (Menagerie entry, built-in list of links or MJCF file) is cut down with `MjSpec`: the
root body moves to the origin of the world, everything above it goes, and so do the actuators,
tendons and exclusions that referred to it, and what is only looked at: skins and the pictures of
textures. The result is kept as XML text with its assets, from which `make_spec` gives fresh copies.
The text keeps six digits, and a `Hand` is read from it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.errors import BadConfig, NotUsable, PathNotFound
from bidexdata.hands.model import Side
from bidexdata.hands.spec import HandSpec
from bidexdata.wording import one_line

if TYPE_CHECKING:
    import mujoco

# Put before every name while the hand is cut out, and taken from the text afterwards: MuJoCo warns
# about attaching without a prefix.
_MARK = "cut-out-"
_SHAPES = ("sphere", "capsule", "cylinder", "box", "mesh")
_LICENCE_FILES = ("LICENSE", "LICENSE.txt", "LICENSE.md", "LICENCE", "COPYING")


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


def load_model(spec: HandSpec, side: Side, folder: Path) -> HandMjcf:
    """Load and cut down the model of one side.

    Args:
        spec: The hand.
        side: Which of its sides.
        folder: Folder of the YAML spec; relative paths start here.

    Raises:
        NotUsable: The source cannot be had or does not fit the spec.
        BadConfig: MuJoCo cannot read the source or a mesh that it names, or refuses the hand.
    """
    side_spec = spec.side(side)
    key = f"sides.{side}.source"
    kind, _, name = side_spec.source.partition(":")
    if kind == "menagerie":
        path, source, assets, digest = _from_menagerie(name)
    elif kind == "builtin":
        path = folder / name
        source, assets, digest = _from_links(path, side, side_spec.prefix)
    else:
        path = folder / side_spec.source
        source, assets, digest = _from_file(path, key)
    try:
        xml = _hand_xml(source, assets, spec, side_spec.prefix)
    except ValueError as err:
        raise BadConfig(f"{key}: {path}: MuJoCo refuses the hand ({one_line(err)})") from err
    return HandMjcf(
        xml=xml,
        assets=_used_assets(xml, assets),
        digest=digest,
        licence_text=_licence_beside(path),
    )


def _hand_xml(
    source: mujoco.MjSpec, assets: Mapping[str, bytes], spec: HandSpec, prefix: str
) -> str:
    """Write the hand alone as XML text.

    Raises:
        BadConfig: The source does not fit the spec.
        ValueError: MuJoCo refuses the hand.
    """
    hand = _cut_at_root(source, prefix + spec.root)
    if spec.joint_armature is not None:
        for joint in hand.joints:
            joint.armature = spec.joint_armature
    for a, b in spec.exclude_contacts:
        _exclude(hand, prefix + a, prefix + b)
    hand.assets = dict(assets)
    hand.compile()
    # Attaching nests the source's `main` defaults in ours; the two need two names.
    return hand.to_xml().replace(f'"{_MARK}main"', '"source"').replace(_MARK, "")


def _licence_beside(path: Path) -> str:
    found = (path.parent / name for name in _LICENCE_FILES)
    return next((p.read_text(encoding="utf-8") for p in found if p.is_file()), "")


def _from_menagerie(name: str) -> tuple[Path, mujoco.MjSpec, dict[str, bytes], str]:
    try:
        import mujoco_menagerie
    except ImportError as err:
        raise NotUsable(
            "hands of MuJoCo Menagerie need the package 'mujoco-menagerie'; "
            "install it with: pip install 'bidexdata[synth]', or use --hand capsule"
        ) from err
    robot_name, _, entry = name.partition("/")
    try:
        robot = mujoco_menagerie.get(robot_name)
        path, files = robot.xml(entry), robot.assets(entry)
    except (mujoco_menagerie.MenagerieError, OSError) as err:
        raise NotUsable(
            f"the model {name!r} of MuJoCo Menagerie cannot be loaded ({one_line(err)}); connect to "
            "the network once so that it can be downloaded, or set MENAGERIE_ROOT to a local copy of "
            "Menagerie, or use --hand capsule"
        ) from err
    import mujoco

    spec = mujoco.MjSpec.from_string(path.read_text(encoding="utf-8"), assets=dict(files))
    return path, spec, dict(files), _digest(files)


def _from_links(path: Path, side: Side, prefix: str) -> tuple[mujoco.MjSpec, dict[str, bytes], str]:
    from bidexdata.config import fingerprint
    from bidexdata.hands.builtin import build_hand, read_links

    links = read_links(path)
    return build_hand(links, side, prefix), {}, fingerprint(links, length=64)


def _from_file(path: Path, key: str) -> tuple[mujoco.MjSpec, dict[str, bytes], str]:
    if not path.is_file():
        raise PathNotFound(path, "an MJCF file, as the hand spec says")
    import mujoco

    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as err:
        raise BadConfig(f"{key}: {path}: MuJoCo cannot read this model ({one_line(err)})") from err
    folder, files = Path(spec.modelfiledir) / spec.meshdir, {}
    for mesh in (m for m in spec.meshes if m.file):
        try:
            files[mesh.file] = (folder / mesh.file).read_bytes()
        except OSError as err:
            raise BadConfig(
                f"{key}: {path}: mesh {mesh.name!r} names the file {folder / mesh.file}, which cannot "
                f"be read ({err.strerror})"
            ) from err
    spec.meshdir = ""
    return spec, files, _digest({path.name: path.read_bytes(), **files})


def _cut_at_root(source: mujoco.MjSpec, root: str) -> mujoco.MjSpec:
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
    _without_pictures(hand)
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


def _without_pictures(hand: mujoco.MjSpec) -> None:
    """Make textures from files plain white: pictures of hands show a material's colour alone.

    They stay, because materials and defaults name them.
    """
    import mujoco

    for texture in hand.textures:
        if texture.file or any(texture.cubefiles):
            texture.file, texture.cubefiles = "", [""] * len(texture.cubefiles)
            texture.builtin, texture.rgb1 = mujoco.mjtBuiltin.mjBUILTIN_FLAT, [1.0, 1.0, 1.0]
            texture.width, texture.height, texture.gridsize = 1, 1, [1, 1]


def _exclude(hand: mujoco.MjSpec, a: str, b: str) -> None:
    for name in (a, b):
        if hand.body(_MARK + name) is None:
            raise BadConfig(f"exclude_contacts names the body {name!r}, which the model lacks")
    if {_MARK + a, _MARK + b} not in [{e.bodyname1, e.bodyname2} for e in hand.excludes]:
        hand.add_exclude(bodyname1=_MARK + a, bodyname2=_MARK + b)


def _used_assets(xml: str, assets: Mapping[str, bytes]) -> dict[str, bytes]:
    """Keep the files that the text still names, in its folder of meshes or below it."""
    named = tuple(f"/{file}" for file in re.findall(r'file="([^"]+)"', xml))
    return {name: data for name, data in assets.items() if f"/{name}".endswith(named)}


def _digest(files: Mapping[str, bytes]) -> str:
    total = hashlib.sha256()
    for name in sorted(files):
        total.update(f"{name}\0{len(files[name])}\0".encode() + files[name])
    return total.hexdigest()
