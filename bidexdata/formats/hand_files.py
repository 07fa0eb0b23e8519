"""The hands of a release: `<side>/{hand.xml, tree.json}`, `LICENSE`, `golden.json` in `hands/<name>`.

`hand.xml` is the MJCF as it was simulated, with the names of its mesh files but not the files;
`tree.json` holds the kinematic tree, contact points, limits, licence and the hashes of all assets,
so that a reader in any language can pose the hand without MuJoCo, and `golden.json` what it must
then get (`formats.golden`). `LICENSE` is the text that came with the hand's source, for `hand.xml`
is derived from it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.config import canonical_json
from bidexdata.formats.golden import write_golden
from bidexdata.frames import matrix_from_quat
from bidexdata.record import HandHeader

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand

_NOT_DATA = ("make_spec", "make_mounted", "licence_text")


def hand_folder(name: str, side: str) -> str:
    """Folder of a hand within a release."""
    return f"hands/{name}/{side}"


def write_hand(root: Path, hand: Hand) -> None:
    """Write the files of one hand under the release folder `root`."""
    folder = root / hand_folder(hand.name, hand.side)
    folder.mkdir(parents=True, exist_ok=True)
    spec = hand.make_spec()
    model = spec.compile()
    tree = {k: _plain(v) for k, v in tree_of(hand).items()}
    tree["assets"] = _asset_hashes(spec, model)
    (folder / "hand.xml").write_text(_portable_xml(spec.to_xml()), encoding="utf-8")
    (folder / "tree.json").write_text(canonical_json(tree) + "\n", encoding="utf-8")
    _write_licence(folder.parent / "LICENSE", hand.licence_text)
    write_golden(folder.parent, tree_of(hand), model)


def contact_centres(tree: Mapping[str, Any], joints: NDArray[np.floating]) -> NDArray[np.float64]:
    """Contact sphere centres in the hand frame [m], (N, C, 3), from `tree.json` alone.

    Written here, apart from `hands.kinematics`, so that checking a release does not lean on the
    code that made it.

    Args:
        tree: Content of `tree.json`.
        joints: Joint positions [rad], (N, J).
    """
    pos, rot = body_poses(tree, joints)
    body = np.asarray(tree["contact_body"], int)
    local = np.asarray(tree["contact_pos"], np.float64).reshape(-1, 3)
    return pos[:, body] + np.einsum("ncij,cj->nci", rot[:, body], local)


def body_poses(
    tree: Mapping[str, Any], joints: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Origins [m], (N, B, 3), and axes, (N, B, 3, 3), of the bodies in the hand frame.

    Args:
        tree: Content of `tree.json`.
        joints: Joint positions [rad], (N, J).
    """
    q = np.asarray(joints, np.float64)
    n, bodies = len(q), len(tree["body_names"])
    pos, rot = np.zeros((n, bodies, 3)), np.zeros((n, bodies, 3, 3))
    rot[:, 0] = np.eye(3)
    axes = np.asarray(tree["joint_axis"], np.float64)
    for b in range(1, bodies):
        parent, joint = tree["body_parent"][b], tree["body_joint"][b]
        offset = np.asarray(tree["body_pos"][b], np.float64)
        pos[:, b] = pos[:, parent] + rot[:, parent] @ offset
        rot[:, b] = rot[:, parent] @ matrix_from_quat(tree["body_quat_wxyz"][b])
        if joint >= 0:
            rot[:, b] = rot[:, b] @ _about(axes[joint], q[:, joint])
    return pos, rot


def header_of(tree: Mapping[str, Any]) -> HandHeader:
    """The record's hand header as `tree.json` states it."""
    return HandHeader(
        name=tree["name"],
        side=tree["side"],
        spec_hash=tree["spec_hash"],
        joint_names=tuple(tree["joint_names"]),
        contact_names=tuple(tree["contact_names"]),
        root_body=tree["body_names"][0],
    )


def _write_licence(path: Path, text: str) -> None:
    # Both sides share the file; where their sources differ it holds both texts.
    known = path.read_text(encoding="utf-8") if path.exists() else ""
    if text not in known:
        path.write_text(f"{known}\n{text}" if known else text, encoding="utf-8")


def _about(axis: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
    # Rodrigues' formula, (N, 3, 3).
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + s * k + (1 - c) * (k @ k)


def tree_of(hand: Hand) -> dict[str, Any]:
    """What `tree.json` states of a hand, its assets left out; arrays are still arrays."""
    return {
        f.name: getattr(hand, f.name) for f in dataclasses.fields(hand) if f.name not in _NOT_DATA
    }


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple):
        return list(value)
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    return value


def compiled_hashes(model: Any) -> dict[str, str]:
    """Hash the vertices and faces of every mesh of a compiled model, by name."""
    found = {}
    for i in range(model.nmesh):
        v, nv = model.mesh_vertadr[i], model.mesh_vertnum[i]
        f, nf = model.mesh_faceadr[i], model.mesh_facenum[i]
        geometry = hashlib.sha256(np.ascontiguousarray(model.mesh_vert[v : v + nv]).tobytes())
        geometry.update(np.ascontiguousarray(model.mesh_face[f : f + nf]).tobytes())
        found[model.mesh(i).name] = geometry.hexdigest()
    return found


def _asset_hashes(spec: Any, model: Any) -> list[dict[str, Any]]:
    """Hash every mesh: its file where there is one, and its compiled vertices and faces."""
    found = []
    files = {m.name or Path(m.file).stem: m.file for m in spec.meshes}
    for name, digest in compiled_hashes(model).items():
        file = files.get(name, "")
        path = Path(spec.modelfiledir) / spec.meshdir / file if file else None
        row = {"mesh": name, "file": Path(file).name, "compiled_sha256": digest}
        if path is not None and path.is_file():
            row["file_sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
        found.append(row)
    return found


def _portable_xml(text: str) -> str:
    # Folders of the machine that packed the release are nobody's business and change its bytes.
    root = ET.fromstring(text)
    for compiler in root.iter("compiler"):
        for key in ("meshdir", "texturedir", "assetdir"):
            compiler.attrib.pop(key, None)
    for element in root.iter():
        if "file" in element.attrib:
            element.set("file", Path(element.attrib["file"]).name)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
