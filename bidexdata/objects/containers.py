"""What the containers of mesh files say that their readers ignore: axes, units, decoders, sizes."""

from __future__ import annotations

import json
import re
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.failure import PrepareFailure
from bidexdata.record.status import Status

_Y_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
_X_UP = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
_DEEPEST = 400
"""Levels of a glTF node tree above which it is refused: readers need minutes for thousands."""
_DECODED = frozenset({"KHR_materials_unlit", "KHR_texture_transform", "KHR_mesh_quantization"})
"""Required glTF extensions that leave the triangles readable."""


class Container(NamedTuple):
    """How coordinates of a file become coordinates with z up."""

    R_world_file: NDArray[np.float64]
    """Rotation from the file's axes to z up, (3, 3)."""
    metres_per_unit: float | None
    """None where the format does not say."""
    warnings: tuple[str, ...] = ()


def check_container(suffix: str, data: bytes) -> Container:
    """Inspect the bytes of a mesh file before a reader sees them.

    Raises:
        PrepareFailure: The file is cut off, contradicts itself or needs a decoder.
    """
    if not data:
        raise PrepareFailure(Status.UNREADABLE, "the file is empty")
    if suffix == ".stl":
        _check_stl(data)
    elif suffix == ".obj":
        _check_obj(data)
    elif suffix in (".glb", ".gltf"):
        _check_gltf(_gltf_json(suffix, data))
        return Container(_Y_UP, 1.0)
    elif suffix == ".dae":
        return _collada(data)
    return Container(np.eye(3), None)


def _check_stl(data: bytes) -> None:
    count = struct.unpack("<I", data[80:84])[0] if len(data) >= 84 else 0
    expected = 84 + 50 * count
    if len(data) == expected and count:
        return
    head = data[:1024].lstrip().lower()
    if head.startswith(b"solid") and b"facet" in data[:4096].lower():
        if b"endsolid" not in data[-4096:].lower():
            raise PrepareFailure(Status.UNREADABLE, "the ASCII STL is cut off: no `endsolid`")
        return
    held = max(len(data) - 84, 0) // 50
    raise PrepareFailure(
        Status.UNREADABLE, f"the STL header claims {count} triangles, the file holds {held}"
    )


def _check_obj(data: bytes) -> None:
    if re.search(rb"^[ \t]*f[ \t](?:[^\n]*[ \t])?0(?:[/ \t\r\n]|$)", data, re.MULTILINE):
        raise PrepareFailure(Status.UNREADABLE, "a face has the index 0; OBJ counts from 1")


def _gltf_json(suffix: str, data: bytes) -> dict[str, Any]:
    text = data
    if suffix == ".glb":
        if len(data) < 20 or data[:4] != b"glTF":
            raise PrepareFailure(Status.UNREADABLE, "not a binary glTF file")
        length = struct.unpack("<I", data[12:16])[0]
        if 20 + length > len(data):
            raise PrepareFailure(Status.UNREADABLE, "the file is shorter than its JSON part")
        text = data[20 : 20 + length]
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as err:
        raise PrepareFailure(Status.UNREADABLE, f"its JSON cannot be read ({err})") from err
    if not isinstance(document, dict):
        raise PrepareFailure(Status.UNREADABLE, "its JSON is not a glTF document")
    return document


def _check_gltf(document: dict[str, Any]) -> None:
    required = document.get("extensionsRequired") or []
    missing = sorted(set(map(str, required)) - _DECODED)
    if missing:
        raise PrepareFailure(Status.UNSUPPORTED, f"it requires {', '.join(missing)}")
    nodes = document.get("nodes") or []
    children = [n.get("children") or [] if isinstance(n, dict) else [] for n in nodes]
    depth = _tree_depth(children)
    if depth > _DEEPEST:
        raise PrepareFailure(
            Status.TOO_COMPLEX, f"its node tree is {depth} levels deep (at most {_DEEPEST})"
        )


def _tree_depth(children: list[list[Any]]) -> int:
    """Levels of a node tree; refuses cycles, several parents and nodes that do not exist."""
    parents = [0] * len(children)
    for child in (c for own in children for c in own):
        if not isinstance(child, int) or not 0 <= child < len(children):
            raise PrepareFailure(Status.UNREADABLE, f"a node names the child {child!r}")
        parents[child] += 1
    if any(p > 1 for p in parents):
        raise PrepareFailure(Status.UNREADABLE, "a node has two parents, which glTF forbids")
    level = [k for k, p in enumerate(parents) if p == 0]
    depth = seen = 0
    while level:
        depth, seen = depth + 1, seen + len(level)
        level = [c for k in level for c in children[k]]
    if seen < len(children):
        raise PrepareFailure(Status.UNREADABLE, "its node tree has a cycle")
    return depth


def _collada(data: bytes) -> Container:
    """Axes and unit from the asset block; COLLADA's default is y up and metres."""
    head = data[:65536]
    axis = re.search(rb"<up_axis>\s*([XYZ])_UP\s*</up_axis>", head)
    unit = re.search(rb"<unit\b[^>]*\bmeter\s*=\s*[\"']([0-9.eE+-]+)[\"']", head)
    R = {b"X": _X_UP, b"Y": _Y_UP, b"Z": np.eye(3)}[axis.group(1) if axis else b"Y"]
    try:
        metres = float(unit.group(1)) if unit else 1.0
    except ValueError:
        metres = 1.0
    return Container(R, metres if metres > 0 else 1.0)
