"""From the source that a spec names to the model of the hand alone.

The source (Menagerie entry, built-in list of links or MJCF file) is cut down with `MjSpec`: the
root body moves to the origin of the world, everything above it goes, and so do the actuators,
tendons and exclusions that referred to it. The result is kept as XML text with its assets, from
which `make_spec` gives fresh copies. The text keeps six digits, and a `Hand` is read from it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.errors import BadConfig, NotUsable, PathNotFound
from bidexdata.hands.model import Side
from bidexdata.hands.spec import HandSpec

if TYPE_CHECKING:
    import mujoco

# Put before every name while the hand is cut out, and taken from the text afterwards: MuJoCo warns
# about attaching without a prefix.
_MARK = "cut-out-"
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
    """
    side_spec = spec.side(side)
    kind, _, name = side_spec.source.partition(":")
    if kind == "menagerie":
        path, source, assets, digest = _from_menagerie(name)
    elif kind == "builtin":
        path = folder / name
        source, assets, digest = _from_links(path, side, side_spec.prefix)
    else:
        path = folder / side_spec.source
        source, assets, digest = _from_file(path)
    hand = _cut_at_root(source, side_spec.prefix + spec.root)
    if spec.joint_armature is not None:
        for joint in hand.joints:
            joint.armature = spec.joint_armature
    for a, b in spec.exclude_contacts:
        _exclude(hand, side_spec.prefix + a, side_spec.prefix + b)
    hand.assets = assets
    hand.compile()
    # Attaching nests the source's `main` defaults in ours; the two need two names.
    xml = hand.to_xml().replace(f'"{_MARK}main"', '"source"').replace(_MARK, "")
    return HandMjcf(
        xml=xml,
        assets=_used_assets(xml, assets),
        digest=digest,
        licence_text=_licence_beside(path),
    )


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
        reason = " ".join(str(err).split())
        raise NotUsable(
            f"the model {name!r} of MuJoCo Menagerie cannot be loaded ({reason}); connect to the "
            "network once so that it can be downloaded, or set MENAGERIE_ROOT to a local copy of "
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


def _from_file(path: Path) -> tuple[mujoco.MjSpec, dict[str, bytes], str]:
    if not path.is_file():
        raise PathNotFound(path, "an MJCF file, as the hand spec says")
    import mujoco

    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as err:
        raise BadConfig(f"{path}: MuJoCo cannot read this model ({err})") from err
    folder = Path(spec.modelfiledir) / spec.meshdir
    files = {m.file: (folder / m.file).read_bytes() for m in spec.meshes if m.file}
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
    meshes = {geom.meshname for b in hand.bodies for geom in b.geoms}
    for mesh in list(hand.meshes):
        if mesh.name not in meshes:
            hand.delete(mesh)
    return hand


def _exclude(hand: mujoco.MjSpec, a: str, b: str) -> None:
    for name in (a, b):
        if hand.body(_MARK + name) is None:
            raise BadConfig(f"exclude_contacts names the body {name!r}, which the model lacks")
    if {_MARK + a, _MARK + b} not in [{e.bodyname1, e.bodyname2} for e in hand.excludes]:
        hand.add_exclude(bodyname1=_MARK + a, bodyname2=_MARK + b)


def _used_assets(xml: str, assets: Mapping[str, bytes]) -> dict[str, bytes]:
    """Keep the files that the text still names."""
    return {name: data for name, data in assets.items() if f'"{Path(name).name}"' in xml}


def _digest(files: Mapping[str, bytes]) -> str:
    total = hashlib.sha256()
    for name in sorted(files):
        total.update(f"{name}\0{len(files[name])}\0".encode() + files[name])
    return total.hexdigest()
