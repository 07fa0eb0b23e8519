"""MJCF models of hands and arms as they stand: from MuJoCo Menagerie or from a file.

A model is read with everything that it names, so that its digest says what it was made from, and
what is only looked at can be taken out of it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bidexdata.errors import BadConfig, NotUsable, PathNotFound
from bidexdata.wording import one_line

if TYPE_CHECKING:
    import mujoco

_LICENCE_FILES = ("LICENSE", "LICENSE.txt", "LICENSE.md", "LICENCE", "COPYING")


class MjcfFile(NamedTuple):
    """One model and the files that it names."""

    path: Path
    spec: mujoco.MjSpec
    assets: dict[str, bytes]
    """Files by the name that the model gives."""
    digest: str
    """sha256 over every file."""


def read_menagerie(name: str, *, what: str, instead: str) -> MjcfFile:
    """Read a model of MuJoCo Menagerie.

    Args:
        name: `ROBOT/ENTRY`.
        what: What the model is, for messages: `hand`, `arm`.
        instead: What else a person can do, for messages.

    Raises:
        NotUsable: The package or the model cannot be had.
    """
    try:
        import mujoco_menagerie
    except ImportError as err:
        raise NotUsable(
            f"{what}s of MuJoCo Menagerie need the package 'mujoco-menagerie'; "
            f"install it with: pip install 'bidexdata[synth]', or {instead}"
        ) from err
    robot_name, _, entry = name.partition("/")
    try:
        robot = mujoco_menagerie.get(robot_name)
        path, files = robot.xml(entry), robot.assets(entry)
        text = path.read_text(encoding="utf-8")
    except (mujoco_menagerie.MenagerieError, OSError) as err:
        raise NotUsable(
            f"the model {name!r} of MuJoCo Menagerie cannot be loaded ({one_line(err)}); "
            f"{_remedy(robot_name, one_line(err))}, or {instead}"
        ) from err
    import mujoco

    spec = mujoco.MjSpec.from_string(text, assets=dict(files))
    return MjcfFile(path, spec, dict(files), digest_of(files))


def _remedy(robot: str, said: str) -> str:
    """What to do about a model that cannot be loaded, by whether the robot is there."""
    if "no entry point" in said:
        return f"name one of those that {robot} has"
    if "MENAGERIE_ROOT=" in said:
        return "check the name, or what MENAGERIE_ROOT names"
    return (
        "connect to the network once so that it can be downloaded, or set MENAGERIE_ROOT to a local copy "
        "of Menagerie"
    )


def read_file(path: Path, key: str, *, what: str) -> MjcfFile:
    """Read an MJCF file and the meshes that it names.

    Args:
        path: The file.
        key: Key of the spec that names it, for messages.
        what: What the model is, for messages.

    Raises:
        PathNotFound: There is no such file.
        BadConfig: MuJoCo cannot read it, or a mesh that it names cannot be read.
    """
    if not path.is_file():
        raise PathNotFound(path, f"an MJCF file, as the {what} spec says")
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
    return MjcfFile(path, spec, files, digest_of({path.name: path.read_bytes(), **files}))


def licence_beside(path: Path) -> str:
    """The text of the licence file beside a model; empty where there is none."""
    found = (path.parent / name for name in _LICENCE_FILES)
    return next((p.read_text(encoding="utf-8") for p in found if p.is_file()), "")


def without_pictures(spec: mujoco.MjSpec) -> None:
    """Make textures from files plain white: pictures of robots show a material's colour alone.

    They stay, because materials and defaults name them.
    """
    import mujoco

    for texture in spec.textures:
        if texture.file or any(texture.cubefiles):
            texture.file, texture.cubefiles = "", [""] * len(texture.cubefiles)
            texture.builtin, texture.rgb1 = mujoco.mjtBuiltin.mjBUILTIN_FLAT, [1.0, 1.0, 1.0]
            texture.width, texture.height, texture.gridsize = 1, 1, [1, 1]


def used_assets(xml: str, assets: Mapping[str, bytes]) -> dict[str, bytes]:
    """Keep the files that a model's text still names, in its folder of meshes or below it."""
    named = tuple(f"/{file}" for file in re.findall(r'file="([^"]+)"', xml))
    return {name: data for name, data in assets.items() if f"/{name}".endswith(named)}


def digest_of(files: Mapping[str, bytes]) -> str:
    """sha256 over the names and contents of files, in the order of their names."""
    total = hashlib.sha256()
    for name in sorted(files):
        total.update(f"{name}\0{len(files[name])}\0".encode() + files[name])
    return total.hexdigest()
