"""glTF 2.0, binary or text: triangles of the default scene with the transforms of their nodes.

glTF has y up and metres. Counts, offsets and references are checked against the bytes before an
array is made; nodes are visited without recursion, so neither depth nor cycles can hang it.
Skins and morph targets are left in the pose that is stored.
"""

from __future__ import annotations

import base64
import json
import re
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

import numpy as np
from numpy.typing import NDArray

from bidexdata.frames import transform, wxyz_from_xyzw
from bidexdata.objects.config import LoadConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.record.status import Status

from .content import (
    R_WORLD_Y_UP,
    Content,
    Part,
    check_faces,
    check_instances,
    joined_parts,
    unreadable,
)
from .draco import DRACO, draco_triangles
from .inside import file_inside

_READABLE = frozenset(
    {
        DRACO,
        "KHR_materials_unlit",
        "KHR_mesh_quantization",
        "KHR_texture_basisu",
        "KHR_texture_transform",
        "EXT_texture_webp",
    }
)
"""Required extensions that are read, or that leave the triangles readable."""
_COMPONENT = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_URI = re.compile(rb'"uri"\s{0,99}:\s{0,99}("[^"]{1,1000}")')
_PICTURES = (".basis", ".bmp", ".dds", ".gif", ".jpeg", ".jpg", ".ktx2", ".png", ".tga", ".webp")


def read_gltf(path: Path, data: bytes, config: LoadConfig) -> Content:
    """Read a `.glb` or `.gltf` file.

    Raises:
        PrepareFailure: It contradicts itself, needs an extension that is not supported, or is
            larger than the bounds.
    """
    packed = path.suffix.lower() == ".glb"
    document, binary = _document(data, binary=packed)
    missing = sorted(set(map(str, _list(document, "extensionsRequired"))) - _READABLE)
    if missing:
        raise PrepareFailure(
            Status.UNSUPPORTED, f"it requires {', '.join(missing)}: export it without"
        )
    places = _placed_meshes(document)
    check_instances(len(places), config)
    file = _File(document, path, binary, config, {})
    meshes = {m: _mesh(file, m) for m in sorted({m for m, _ in places})}
    check_faces(sum(len(p.faces) for m, _ in places for p in meshes[m]), config)
    parts = [p._replace(T_world_part=T) for m, T in places for p in meshes[m]]
    skeleton = ("it has a skeleton: prepared in the pose that is stored",) * ("skins" in document)
    warnings = skeleton + (_of_length(data) if packed else ())
    return Content(joined_parts(parts, config), R_WORLD_Y_UP, 1.0, warnings)


def named_buffers(blocks: Iterable[bytes]) -> list[str]:
    """Relative paths of the files that a glTF file names, but for pictures.

    Its JSON is searched and not parsed: what it becomes in memory has no bound but a worker's.

    Args:
        blocks: The bytes of the file, in order.
    """
    found: dict[str, None] = {}
    before = b""
    for block in blocks:
        text = before + block
        if b'"uri"' in text:
            found |= dict.fromkeys(_unquoted(name) for name in _URI.findall(text))
        before = text[-2048:]  # more than the longest match
    return [name for name in found if name and not name.lower().endswith(_PICTURES)]


def _unquoted(text: bytes) -> str:
    """The path that a string of JSON means as a URI; empty where it is none."""
    try:
        return unquote(json.loads(text))
    except ValueError:
        return ""


def _of_length(data: bytes) -> tuple[str, ...]:
    claimed = struct.unpack("<I", data[8:12])[0]
    text = f"its header claims {claimed} bytes, the file has {len(data)}"
    return () if claimed == len(data) else (text,)


class _File(NamedTuple):
    """A document and its buffers, which are read when asked for."""

    document: dict[str, Any]
    path: Path
    binary: bytes | None
    config: LoadConfig
    buffers: dict[int, bytes]


def _document(data: bytes, *, binary: bool) -> tuple[dict[str, Any], bytes | None]:
    text, body = data, None
    if binary:
        if len(data) < 20 or data[:4] != b"glTF":
            raise unreadable("not a binary glTF file")
        version = struct.unpack("<I", data[4:8])[0]
        if version != 2:
            raise PrepareFailure(Status.UNSUPPORTED, f"binary glTF version {version}, not 2")
        length, kind = struct.unpack("<I4s", data[12:20])
        end = 20 + length
        if end > len(data) or kind != b"JSON":
            raise unreadable("the file is cut off: it is shorter than its JSON part")
        text = data[20:end]
        if len(data) >= end + 8:
            length, kind = struct.unpack("<I4s", data[end : end + 8])
            if kind == b"BIN\0":
                body = data[end + 8 : end + 8 + length]
                if len(body) < length:
                    raise unreadable(
                        f"the file is cut off: {len(body)} of {length} bytes of its binary part"
                    )
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as err:
        raise unreadable(f"its JSON cannot be read ({err})") from err
    if not isinstance(document, dict):
        raise unreadable("its JSON is not a glTF document")
    return document, body


def _placed_meshes(document: dict[str, Any]) -> list[tuple[int, NDArray[np.float64]]]:
    """Meshes that the default scene shows, with the pose of each, in order of their nodes."""
    nodes = _list(document, "nodes")
    children = [_indices(n, "children", len(nodes), "a node names the child") for n in nodes]
    parents = np.bincount([c for own in children for c in own], minlength=len(nodes))
    if (parents > 1).any():
        raise unreadable("a node has two parents, which glTF forbids")
    roots = _roots(document, parents)
    places: dict[int, NDArray[np.float64]] = {}
    waiting = [(k, np.eye(4)) for k in roots]
    while waiting:
        k, T_world_parent = waiting.pop()
        if k in places:
            raise unreadable("its node tree has a cycle, or a node has two parents")
        places[k] = T_world_parent @ _transform(nodes[k])
        waiting += [(c, places[k]) for c in children[k]]
    if not places and len(nodes):
        raise unreadable("its node tree has a cycle" if (parents > 0).all() else "no node is shown")
    count = len(_list(document, "meshes"))
    return [
        (_index(nodes[k]["mesh"], count, "a node names the mesh"), places[k])
        for k in sorted(places)
        if "mesh" in nodes[k]
    ]


def _roots(document: dict[str, Any], parents: NDArray[np.intp]) -> list[int]:
    scenes = _list(document, "scenes")
    if not scenes:
        return [k for k, p in enumerate(parents) if p == 0]
    scene = scenes[_index(document.get("scene", 0), len(scenes), "the file names the scene")]
    return _indices(scene, "nodes", len(parents), "the scene names the node")


def _transform(node: dict[str, Any]) -> NDArray[np.float64]:
    if "matrix" in node:
        return _numbers(node, "matrix", 16).reshape(4, 4).T
    q = _numbers(node, "rotation", 4, (0.0, 0.0, 0.0, 1.0))
    quat = wxyz_from_xyzw(q / np.linalg.norm(q))
    T = transform(_numbers(node, "translation", 3, (0.0, 0.0, 0.0)), quat)
    T[:3, :3] *= _numbers(node, "scale", 3, (1.0, 1.0, 1.0))
    return T


def _mesh(file: _File, number: int) -> list[Part]:
    """The primitives of a mesh that are triangles."""
    parts = []
    for primitive in _list(_list(file.document, "meshes")[number], "primitives"):
        mode = primitive.get("mode", _TRIANGLES)
        if type(mode) is not int or mode not in (_TRIANGLES, _STRIP, _FAN):
            continue
        extensions = _object(primitive, "extensions")
        if DRACO in extensions:
            compressed = _object(extensions, DRACO)
            view = _view(file, compressed.get("bufferView"))
            parts.append(Part(*draco_triangles(view, compressed)))
            continue
        position = _object(primitive, "attributes").get("POSITION")
        if position is None:
            raise unreadable("a primitive has no positions")
        vertices = _accessor(file, position, 3)
        if "indices" in primitive:
            corners = _accessor(file, primitive["indices"], 1).astype(np.int64).reshape(-1)
        else:
            corners = np.arange(len(vertices))
        parts.append(Part(vertices, _triangles(corners, mode)))
    return parts


def _triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    count = max(len(corners) - 2, 0)
    k = np.arange(count)
    if mode == _FAN:
        return np.stack([np.full(count, corners[0] if count else 0), corners[1:-1], corners[2:]], 1)
    # Every second triangle of a strip is wound the other way.
    odd = k % 2
    return np.stack([corners[k], corners[k + 1 + odd], corners[k + 2 - odd]], 1)


def _accessor(file: _File, number: Any, width: int) -> NDArray[np.float64]:
    """Read an accessor as float64 (n, width); normalised integers become fractions."""
    accessors = _list(file.document, "accessors")
    accessor = accessors[_index(number, len(accessors), "the file names the accessor")]
    count = _whole(accessor, "count")
    kind = _component(accessor)
    if kind is None or _WIDTH.get(str(accessor.get("type"))) != width:
        raise unreadable(f"accessor {number} has not the type that its use needs")
    if count > 3 * file.config.max_faces:
        # Held or not, nothing that large may be made of it.
        raise PrepareFailure(
            Status.TOO_COMPLEX,
            f"accessor {number} claims {count} elements; load.max_faces is {file.config.max_faces}",
        )
    dtype = np.dtype(kind)
    if "bufferView" in accessor:
        values = _elements(file, accessor, dtype, count, width)
    else:
        values = np.zeros((count, width), dtype)
    if "sparse" in accessor:
        values = _with_sparse(file, _object(accessor, "sparse"), values)
    plain = values.astype(np.float64)
    if accessor.get("normalized") and dtype.kind in "iu":
        plain = np.maximum(plain / np.iinfo(dtype).max, -1.0)
    return plain


def _elements(
    file: _File, accessor: dict[str, Any], dtype: np.dtype[Any], count: int, width: int
) -> NDArray[Any]:
    view = _view(file, accessor["bufferView"])
    description = _list(file.document, "bufferViews")[accessor["bufferView"]]
    row, start = dtype.itemsize * width, _whole(accessor, "byteOffset", 0)
    stride = _whole(description, "byteStride", 0) or row
    needed = start + (count - 1) * stride + row if count else 0
    if needed > len(view) or stride < row:
        raise unreadable(f"an accessor of {needed} bytes lies in a buffer view of {len(view)}")
    if not count:
        return np.zeros((0, width), dtype)
    raw = np.frombuffer(view, np.uint8)
    rows = np.lib.stride_tricks.as_strided(raw[start:], (count, row), (stride, 1))
    return np.ascontiguousarray(rows).view(dtype).reshape(count, width)


def _with_sparse(file: _File, sparse: dict[str, Any], values: NDArray[Any]) -> NDArray[Any]:
    count = _whole(sparse, "count")
    if count > len(values):
        raise unreadable(f"a sparse accessor replaces {count} of {len(values)} elements")
    where, what = _object(sparse, "indices"), _object(sparse, "values")
    kind = _component(where)
    if kind is None or "bufferView" not in where or "bufferView" not in what:
        raise unreadable("a sparse accessor names no values")
    index = _elements(file, where, np.dtype(kind), count, 1).astype(np.int64).reshape(-1)
    if count and (index.min() < 0 or index.max() >= len(values)):
        raise unreadable("a sparse accessor replaces an element that does not exist")
    values = values.copy()
    values[index] = _elements(file, what, values.dtype, count, values.shape[1])
    return values


def _view(file: _File, number: Any) -> bytes:
    views = _list(file.document, "bufferViews")
    view = views[_index(number, len(views), "the file names the buffer view")]
    buffer = _buffer(file, view.get("buffer"))
    start, length = _whole(view, "byteOffset", 0), _whole(view, "byteLength")
    if start + length > len(buffer):
        raise unreadable(
            f"a buffer view ends at byte {start + length} of a buffer of {len(buffer)}"
        )
    return buffer[start : start + length]


def _buffer(file: _File, number: Any) -> bytes:
    buffers = _list(file.document, "buffers")
    number = _index(number, len(buffers), "the file names the buffer")
    if number not in file.buffers:
        uri = buffers[number].get("uri")
        if uri is None:
            if number or file.binary is None:
                raise unreadable(f"buffer {number} has no data")
            file.buffers[number] = file.binary
        else:
            file.buffers[number] = _named_bytes(file, str(uri))
    return file.buffers[number]


def _named_bytes(file: _File, uri: str) -> bytes:
    """Bytes of a data URI, or of a file in the folder of this one."""
    if uri[:5].lower() == "data:":
        head, comma, text = uri.partition(",")
        if not comma or not head.lower().endswith(";base64"):
            raise unreadable("a data URI is not in base64")
        try:
            return base64.b64decode(text, validate=True)
        except ValueError as err:
            raise unreadable(f"a data URI is not in base64 ({err})") from err
    parts = urlsplit(uri)
    if parts.scheme or parts.netloc:
        raise unreadable(f"its buffer is {uri[:80]!r}: only files beside it are read")
    return file_inside(file.path.parent, unquote(uri), file.config.max_bytes)


def _list(document: Any, name: str) -> list[Any]:
    found = document.get(name) if isinstance(document, dict) else None
    if found is None:
        return []
    if not isinstance(found, list):
        raise unreadable(f"`{name}` is no list")
    if name != "extensionsRequired" and not all(isinstance(x, dict) for x in found):
        raise unreadable(f"`{name}` is no list of objects")
    return found


def _object(owner: dict[str, Any], name: str) -> dict[str, Any]:
    found = owner.get(name)
    if found is not None and not isinstance(found, dict):
        raise unreadable(f"`{name}` is no object")
    return found or {}


def _component(accessor: dict[str, Any]) -> str | None:
    number = accessor.get("componentType")
    return _COMPONENT.get(number) if isinstance(number, int) else None


def _indices(owner: Any, name: str, count: int, what: str) -> list[int]:
    found = owner.get(name) if isinstance(owner, dict) else None
    if found is not None and not isinstance(found, list):
        raise unreadable(f"`{name}` is no list")
    return [_index(k, count, what) for k in found or []]


def _index(value: Any, count: int, what: str) -> int:
    if type(value) is not int or not 0 <= value < count:
        raise unreadable(f"{what} {value!r}; it has {count}")
    return value


def _whole(owner: Any, name: str, default: int | None = None) -> int:
    value = owner.get(name, default)
    if type(value) is not int or value < 0:
        raise unreadable(f"`{name}` is {value!r}")
    return value


def _numbers(
    node: dict[str, Any], name: str, count: int, default: tuple[float, ...] = ()
) -> NDArray[np.float64]:
    value = node.get(name, default)
    try:
        numbers = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError) as err:
        raise unreadable(f"the `{name}` of a node is no list of numbers") from err
    if numbers.shape != (count,):
        raise unreadable(f"the `{name}` of a node has not {count} numbers")
    return numbers
