"""COLLADA: triangles and polygons of the scene with the transforms of its nodes.

COLLADA says which axis is up (y unless it says so) and how long its unit is (a metre). Nodes may
be placed many times; they are counted before any is copied. No entity, image or other file is
read. Skins are taken in the pose that is stored.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import quat_from_rotation_vector, transform
from bidexdata.objects.config import LoadConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.polygons import triangulated
from bidexdata.record.status import Status

from .content import (
    R_WORLD_X_UP,
    R_WORLD_Y_UP,
    Content,
    Part,
    check_faces,
    joined_parts,
    unreadable,
)
from .scene import Place, placed
from .text import numbers, plain_text, whole_numbers

_R_WORLD_FILE = {"X_UP": R_WORLD_X_UP, "Y_UP": R_WORLD_Y_UP, "Z_UP": np.eye(3)}
_PLACED = ("node", "instance_node", "instance_geometry", "instance_controller")
"""Children of a node that may hold triangles."""
_UNSUPPORTED = ("skew", "lookat")
"""Transforms of nodes that exporters hardly write, and that readers take differently."""
_PRIMITIVES = ("triangles", "polylist", "polygons", "trifans", "tristrips")


def read_dae(path: Path, data: bytes, config: LoadConfig) -> Content:
    """Read a COLLADA file.

    Raises:
        PrepareFailure: It is no COLLADA, contradicts itself, declares entities, has a transform
            that is not supported, or is larger than the bounds.
    """
    root = _root(data)
    ids = {e.get("id"): e for e in root.iter() if isinstance(e.tag, str) and e.get("id")}
    scenes = _all(root, "scene/instance_visual_scene") or _all(root, "visual_scene", deep=True)
    if not scenes:
        raise unreadable("it has no scene")
    scene = scenes[0]
    if _tag(scene) == "instance_visual_scene":
        scene = _target(scene, ids)

    def children(node: Any) -> Iterator[Place]:
        # Local references may name what stands elsewhere: `sid` paths are not used by instances.
        shown = [child for child in node if _tag(child) in _PLACED]
        # A camera's own transforms place no triangles, and may be what is not supported.
        T_parent_node = _transform(node) if shown and _tag(node) == "node" else np.eye(4)
        for child in shown:
            if _tag(child) == "node":
                yield Place(child, T_parent_node)
            elif _tag(child) == "instance_node" or _tag(child) == "instance_geometry":
                yield Place(_target(child, ids), T_parent_node)
            else:
                yield from _skinned(_target(child, ids), ids, T_parent_node)

    def is_geometry(node: Any) -> bool:
        return _tag(node) == "geometry"

    shown = placed([Place(scene, np.eye(4))], children, is_geometry, config)
    geometries: dict[Any, list[Part]] = {}
    for place in shown:
        if place.node not in geometries:
            geometries[place.node] = list(_geometry(place.node, ids))
    check_faces(sum(len(p.faces) for s in shown for p in geometries[s.node]), config)
    parts = [p._replace(T_world_part=s.T) for s in shown for p in geometries[s.node]]
    R, metres = _asset(root)
    skins = "it has a skeleton: prepared in the pose that is stored"
    warnings = (skins,) if any(_tag(e) == "skin" for e in root.iter()) else ()
    return Content(joined_parts(parts, config), R, metres, warnings)


def _root(data: bytes) -> Any:
    from lxml import etree  # type: ignore[attr-defined]  # made in C, without stubs

    text = plain_text(data)
    if b"<!entity" in text.replace(b"\0", b"").lower():
        raise unreadable("it declares XML entities, which are not read")
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=True, remove_pis=True
    )
    # The mark of the encoding is gone, so its declaration would be wrong.
    text = re.sub(rb"^\s*<\?xml[^>]*\?>", b"", text) if text is not data else text.lstrip()
    try:
        root = etree.fromstring(text, parser)
    except (etree.XMLSyntaxError, ValueError) as err:
        line = (str(err).splitlines() or ["no element"])[0]
        raise unreadable(f"its XML cannot be read: {line[:150]}") from err
    if _tag(root) != "COLLADA":
        raise unreadable(f"its XML is no COLLADA document but <{_tag(root)[:40]}>")
    return root


def _asset(root: Any) -> tuple[NDArray[np.float64], float]:
    """Turn to z up and metres per unit, of the asset of the whole document."""
    axis = "".join(a.text or "" for a in _all(root, "asset/up_axis")[:1]).strip().upper()
    units = _all(root, "asset/unit")
    try:
        metres = float(units[0].get("meter", "1")) if units else 1.0
    except ValueError:
        metres = 1.0
    good = np.isfinite(metres) and metres > 0
    return _R_WORLD_FILE.get(axis, R_WORLD_Y_UP), metres if good else 1.0


def _skinned(controller: Any, ids: dict[str, Any], T: NDArray[np.float64]) -> Iterator[Place]:
    for skin in _all(controller, "skin"):
        target = ids.get((skin.get("source") or "").lstrip("#"))
        bind = _all(skin, "bind_shape_matrix")
        T_bind = _words(bind[0], 16).reshape(4, 4) if bind else np.eye(4)
        if target is not None and _tag(target) == "geometry":
            yield Place(target, T @ T_bind)


def _transform(node: Any) -> NDArray[np.float64]:
    """Transforms of a node in the order in which they stand."""
    T = np.eye(4)
    for child in node:
        if _tag(child) in _UNSUPPORTED:
            raise PrepareFailure(
                Status.UNSUPPORTED, f"a node has a <{_tag(child)}>: export it with a <matrix>"
            )
        make = _TRANSFORMS.get(_tag(child))
        if make is not None:
            T = T @ make(child)
    return T


def _matrix(element: Any) -> NDArray[np.float64]:
    return _words(element, 16).reshape(4, 4)


def _translate(element: Any) -> NDArray[np.float64]:
    T = np.eye(4)
    T[:3, 3] = _words(element, 3)
    return T


def _scale(element: Any) -> NDArray[np.float64]:
    return np.diag([*_words(element, 3), 1.0])


def _rotate(element: Any) -> NDArray[np.float64]:
    words = _words(element, 4)
    axis, degrees = words[:3], words[3]
    if not np.isfinite(degrees):
        raise unreadable(f"a <rotate> turns by {degrees} degrees")
    length = float(np.linalg.norm(axis))
    if not np.isfinite(length) or length == 0:
        return np.eye(4)
    turn = axis / length * np.radians(degrees % 360)
    return transform(np.zeros(3), quat_from_rotation_vector(turn))


_TRANSFORMS: dict[str, Callable[[Any], NDArray[np.float64]]] = {
    "matrix": _matrix,
    "translate": _translate,
    "scale": _scale,
    "rotate": _rotate,
}


def _geometry(geometry: Any, ids: dict[str, Any]) -> Iterator[Part]:
    """The primitives of a geometry that have an area."""
    for mesh in _all(geometry, "mesh"):
        for primitive in mesh:
            if _tag(primitive) in _PRIMITIVES:
                part = _primitive(primitive, ids)
                if part is not None:
                    yield part


class _Input(NamedTuple):
    offset: int
    source: Any


def _primitive(primitive: Any, ids: dict[str, Any]) -> Part | None:
    position, width = None, 1
    for entry in _all(primitive, "input"):
        offset = _offset(entry)
        width = max(width, offset + 1)
        if entry.get("semantic") == "VERTEX":
            position = _Input(offset, _target(entry, ids, "source"))
    rows = [_integers(p) for p in _all(primitive, "p") + _all(primitive, "ph/p")]
    if position is None or not any(len(r) for r in rows):
        return None
    vertices = _positions(position.source, ids)
    corners = [r[: len(r) // width * width].reshape(-1, width)[:, position.offset] for r in rows]
    for own in corners:
        if len(own) and (own.min() < 0 or own.max() >= len(vertices)):
            raise unreadable("a face names a vertex that does not exist")
    kind = _tag(primitive)
    if kind == "polylist":
        vcount = _all(primitive, "vcount")
        counts = _integers(vcount[0]) if vcount else np.zeros(0, np.int64)
        if (counts < 0).any() or counts.sum() != len(corners[0]):
            raise unreadable(
                f"its polygons claim {counts.sum()} corners and have {len(corners[0])}"
            )
        return Part(vertices, triangulated(vertices, corners[0], counts))
    if kind == "polygons":
        counts = np.array([len(c) for c in corners], np.int64)
        return Part(vertices, triangulated(vertices, np.concatenate(corners), counts))
    if kind == "triangles":
        whole = np.concatenate(corners)
        return Part(vertices, whole[: len(whole) // 3 * 3].reshape(-1, 3))
    return Part(vertices, np.concatenate([_rows(c, fan=kind == "trifans") for c in corners]))


def _rows(corners: NDArray[np.int64], *, fan: bool) -> NDArray[np.int64]:
    """Triangles of a fan or strip."""
    k = np.arange(max(len(corners) - 2, 0))
    if fan:
        return np.stack([corners[np.zeros_like(k)], corners[k + 1], corners[k + 2]], axis=1)
    odd = k % 2
    return np.stack([corners[k], corners[k + 1 + odd], corners[k + 2 - odd]], axis=1)


def _positions(vertices: Any, ids: dict[str, Any]) -> NDArray[np.float64]:
    """Positions (V, 3) that a `vertices` element names."""
    source = vertices
    for entry in _all(vertices, "input"):
        if entry.get("semantic") == "POSITION":
            source = _target(entry, ids, "source")
    arrays = _all(source, "float_array")
    accessors = _all(source, "technique_common/accessor")
    if not arrays:
        raise unreadable("its vertices have no positions")
    values = _words(arrays[0])
    stride, offset, count = 3, 0, len(values) // 3
    if accessors:
        stride = max(_number(accessors[0], "stride", 1), 1)
        offset = _number(accessors[0], "offset", 0)
        count = _number(accessors[0], "count", 0)
    if stride < 3 or offset + count * stride > len(values) + (stride - 3):
        raise unreadable(
            f"its vertices claim {count} positions of {stride} numbers, the file holds {len(values)}"
        )
    if not count:
        return np.zeros((0, 3))
    index = offset + stride * np.arange(count)[:, None] + np.arange(3)
    return values[index]


def _offset(entry: Any) -> int:
    offset = _number(entry, "offset", 0)
    if offset > 64:
        raise unreadable(f"an input has the offset {offset}")
    return offset


def _number(element: Any, name: str, default: int) -> int:
    try:
        value = int(element.get(name, default))
    except ValueError:
        value = -1
    if value < 0:
        raise unreadable(f"`{name}` of <{_tag(element)}> is {element.get(name)!r}")
    return value


def _words(element: Any, count: int | None = None) -> NDArray[np.float64]:
    try:
        values = numbers((element.text or "").encode().split())
    except ValueError as err:
        raise unreadable(f"<{_tag(element)}> holds a word that is no number") from err
    if count is not None and len(values) != count:
        raise unreadable(f"<{_tag(element)}> holds {len(values)} numbers, not {count}")
    return values


def _integers(element: Any) -> NDArray[np.int64]:
    try:
        return whole_numbers((element.text or "").encode().split())
    except ValueError as err:
        raise unreadable(f"<{_tag(element)}> holds a word that is no whole number") from err


def _target(element: Any, ids: dict[str, Any], attribute: str = "url") -> Any:
    name = element.get(attribute) or ""
    if not name.startswith("#"):
        raise unreadable(f"<{_tag(element)}> names {name[:60]!r}: only its own parts are read")
    if name[1:] not in ids:
        raise unreadable(f"<{_tag(element)}> names {name[:60]!r}, which does not exist")
    return ids[name[1:]]


def _tag(element: Any) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _all(element: Any, path: str, *, deep: bool = False) -> list[Any]:
    """Elements by the names on the way to them, whatever their namespace."""
    if deep:
        return [e for e in element.iter() if _tag(e) == path]
    found = [element]
    for name in path.split("/"):
        found = [child for parent in found for child in parent if _tag(child) == name]
    return found
