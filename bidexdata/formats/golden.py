"""Golden poses of a hand: joint vectors and where they put its contact points and fingertips.

`hands/<name>/golden.json` is written by MuJoCo from the hand that made the grasps, so that whoever
reads a release, in any language, can tell whether his kinematics are those of the data. `verify`
does so with numpy and `tree.json` alone, and `verify --full` a second time with MuJoCo and the
release's own `hand.xml`. Positions are in the hand frame [m], joints in the order of
`joint_names` [rad].
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bidexdata.config import canonical_json
from bidexdata.errors import Contradiction, MissingExtra

if TYPE_CHECKING:
    import mujoco

    from bidexdata.formats.release import Release

GOLDEN = "golden.json"
SEED = 12
RANDOM_POSES = 14
"""Beside the lower limits, the upper limits and, where it lies within them, zero."""
DIGITS = 9
"""Decimals of what is written [m, rad]: another processor gives the same text."""
SINCE = (1, 3)
"""Schema version that brought the file."""
NUMPY_TOLERANCE = 2e-6
"""Positions of `tree.json` may miss by this [m]: a hand's MJCF text has six digits."""
XML_TOLERANCE = 2e-5
"""Those of `hand.xml` by this [m]: its six digits are of angles in degrees too."""
_KINEMATIC = {"mujoco", "compiler", "default", "worldbody", "body", "frame", "joint", "inertial"}


class Positions(NamedTuple):
    """Where the points of a hand lie in some poses, hand frame [m]."""

    contacts: NDArray[np.float64]
    """Centres of the contact spheres, (K, C, 3)."""
    fingertips: NDArray[np.float64]
    """Origins of the last body of each finger, fingers by name, (K, F, 3)."""


def write_golden(folder: Path, tree: Mapping[str, Any], model: mujoco.MjModel) -> None:
    """Write or extend `golden.json` of a hand by one side.

    Args:
        folder: `hands/<name>` of the release.
        tree: The side, as `tree.json` states it.
        model: Its compiled spec, or its kinematics alone.
    """
    path = folder / GOLDEN
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    joints = golden_joints(tree["joint_lower"], tree["joint_upper"])
    found = positions_by_mujoco(model, tree, joints)
    known[tree["side"]] = {
        "seed": SEED,
        "joint_names": list(tree["joint_names"]),
        "joints": joints.tolist(),
        "contact_names": list(tree["contact_names"]),
        "contacts": _rounded(found.contacts),
        "fingertip_bodies": _tip_bodies(tree["fingers"]),
        "fingertips": _rounded(found.fingertips),
    }
    path.write_text(canonical_json(known) + "\n", encoding="utf-8")


def complete_golden(folder: Path, sides: Sequence[str]) -> None:
    """Write `golden.json` of a hand as an older schema stored it, from its own `hand.xml`.

    Args:
        folder: `hands/<name>` of a release; nothing is done where it has the file.
        sides: Of the hand.

    Raises:
        MissingExtra: MuJoCo is not installed.
        Contradiction: MuJoCo cannot pose what is stored.
    """
    if (folder / GOLDEN).exists():
        return
    for side in sides:
        tree = json.loads((folder / side / "tree.json").read_text(encoding="utf-8"))
        write_golden(folder, tree, _model_of(folder / side))


def golden_joints(lower: ArrayLike, upper: ArrayLike) -> NDArray[np.float64]:
    """Joint vectors within the limits [rad], (K, J): both limits, zero, seeded ones."""
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    draws = np.random.default_rng(SEED).random((RANDOM_POSES, len(lower)))
    fixed = [lower, upper, np.clip(np.zeros(len(lower)), lower, upper)]
    joints = np.concatenate([fixed, lower + draws * (upper - lower)])
    return np.round(joints, DIGITS) + 0.0


def positions_by_mujoco(
    model: mujoco.MjModel, tree: Mapping[str, Any], joints: NDArray[np.float64]
) -> Positions:
    """Pose a compiled hand and read its points.

    Args:
        model: The hand, alone.
        tree: Names, contact points and fingers, as in `tree.json`.
        joints: Joint positions [rad], (K, J).

    Raises:
        KeyError: The model lacks a joint or body of the tree.
    """
    import mujoco

    data = mujoco.MjData(model)
    address = [int(model.joint(name).qposadr[0]) for name in tree["joint_names"]]
    bodies = [int(model.body(name).id) for name in tree["body_names"]]
    tips = [int(model.body(name).id) for name in _tip_bodies(tree["fingers"])]
    carriers = [bodies[b] for b in np.asarray(tree["contact_body"], int)]
    local = np.asarray(tree["contact_pos"], np.float64).reshape(-1, 3)
    contacts, fingertips = [], []
    for q in joints:
        data.qpos[address] = q
        mujoco.mj_kinematics(model, data)
        R, origin = data.xmat[bodies[0]].reshape(3, 3), data.xpos[bodies[0]]
        turned = np.einsum("cij,cj->ci", data.xmat[carriers].reshape(-1, 3, 3), local)
        contacts.append((data.xpos[carriers] + turned - origin) @ R)
        fingertips.append((data.xpos[tips] - origin) @ R)
    return Positions(np.array(contacts), np.array(fingertips))


def golden_tree(release: Release) -> str:
    """Compare golden poses with forward kinematics of `tree.json` by numpy."""
    return _compare(release, "numpy and tree.json", NUMPY_TOLERANCE, _by_numpy)


def golden_xml(release: Release) -> str:
    """Compare golden poses with MuJoCo's kinematics of the release's `hand.xml`.

    Raises:
        MissingExtra: MuJoCo is not installed.
    """
    return _compare(release, "MuJoCo and hand.xml", XML_TOLERANCE, _by_xml)


def kinematic_xml(text: str) -> str:
    """Reduce a hand's MJCF to bodies and joints: nothing is left that names a file."""
    root = ET.fromstring(text)
    _keep(root, _KINEMATIC)
    compilers = list(root.iter("compiler")) or [ET.SubElement(root, "compiler")]
    for compiler in compilers:
        # Bodies without geometry have no mass, which kinematics do not need and MuJoCo does.
        compiler.attrib |= {"boundmass": "0.001", "boundinertia": "0.000001"}
    return ET.tostring(root, encoding="unicode")


def _compare(release: Release, engine: str, tolerance: float, positions: Any) -> str:
    from bidexdata.formats.hand_files import hand_folder
    from bidexdata.formats.table_checks import read_tree

    worst, poses = 0.0, 0
    for hand in release.hands:
        path = release.path / hand_folder(hand.name, hand.side)
        if not (path.parent / GOLDEN).exists() and _older(release):
            return (
                f"skipped, for schema {release.header.schema_version} has no golden poses "
                f"({'.'.join(map(str, SINCE))} brought them)"
            )
        tree = read_tree(release, hand.name, hand.side)
        joints, stated = _read(path.parent / GOLDEN, hand.side, tree)
        found = positions(path, tree, joints)
        for kind, mine, theirs in zip(Positions._fields, found, stated, strict=True):
            off = float(np.abs(mine - theirs).max(initial=0.0))
            if not off <= tolerance:
                raise Contradiction(
                    f"hands/{hand.name}/{hand.side}: {engine} put the {kind} of a golden pose "
                    f"{1000 * off:.3g} mm from where {GOLDEN} has them"
                )
            worst = max(worst, off)
        poses += len(joints)
    return f"{poses} golden poses posed by {engine}, at most {1e6 * worst:.2g} um off"


def _read(path: Path, side: str, tree: Mapping[str, Any]) -> tuple[NDArray[np.float64], Positions]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))[side]
        names = data["joint_names"], data["contact_names"]
        joints = np.array(data["joints"], np.float64).reshape(-1, len(names[0]))
        shape = (len(joints), -1, 3)
        contacts = np.array(data["contacts"], np.float64).reshape(len(joints), len(names[1]), 3)
        fingertips = np.array(data["fingertips"], np.float64).reshape(shape)
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise Contradiction(f"{path}: unreadable golden poses ({err!r})") from err
    if names != (tree["joint_names"], tree["contact_names"]) or not len(joints):
        raise Contradiction(f"{path}: golden poses of another hand than {side}/tree.json")
    if fingertips.shape[1] != len(tree["fingers"]):
        raise Contradiction(f"{path}: golden poses of other fingers than {side}/tree.json")
    return joints, Positions(contacts, fingertips)


def _by_numpy(path: Path, tree: Mapping[str, Any], joints: NDArray[np.float64]) -> Positions:
    from bidexdata.formats.hand_files import body_poses, contact_centres

    tips = [tree["body_names"].index(name) for name in _tip_bodies(tree["fingers"])]
    return Positions(contact_centres(tree, joints), body_poses(tree, joints)[0][:, tips])


def _by_xml(path: Path, tree: Mapping[str, Any], joints: NDArray[np.float64]) -> Positions:
    try:
        return positions_by_mujoco(_model_of(path), tree, joints)
    except KeyError as err:
        raise Contradiction(f"{path / 'hand.xml'}: MuJoCo cannot pose it ({err})") from err


def _model_of(path: Path) -> mujoco.MjModel:
    """Kinematics of `hand.xml` in the folder of one side."""
    try:
        import mujoco
    except ImportError as err:
        raise MissingExtra("mujoco", "synth") from err
    try:
        text = kinematic_xml((path / "hand.xml").read_text(encoding="utf-8"))
        return mujoco.MjSpec.from_string(text).compile()
    except (OSError, ValueError, ET.ParseError) as err:
        raise Contradiction(f"{path / 'hand.xml'}: MuJoCo cannot pose it ({err})") from err


def _keep(element: ET.Element, names: set[str]) -> None:
    for child in list(element):
        if child.tag in names:
            _keep(child, names)
        else:
            element.remove(child)


def _older(release: Release) -> bool:
    version = tuple(int(n) for n in release.header.schema_version.split(".")[:2])
    return version < SINCE


def _tip_bodies(fingers: Mapping[str, Any]) -> list[str]:
    # JSON sorts the keys of objects, so their order says nothing.
    return [fingers[name][-1] for name in sorted(fingers)]


def _rounded(values: NDArray[np.float64]) -> list:
    return (np.round(values, DIGITS) + 0.0).tolist()
