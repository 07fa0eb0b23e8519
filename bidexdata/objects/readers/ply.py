"""PLY, text or binary of either byte order: vertices, polygons of any sizes, triangle strips."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.config import LoadConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.polygons import triangulated
from bidexdata.record.status import Status

from .content import Content, Part, joined_parts, unreadable
from .text import numbers

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}
_INDICES = ("vertex_indices", "vertex_index")


class _Property(NamedTuple):
    name: str
    kind: str
    """Type of the value, or of the elements of a list."""
    length_kind: str = ""
    """Type of a list's length; empty for a single value."""


class _Element(NamedTuple):
    name: str
    number: int
    properties: list[_Property]

    @property
    def least(self) -> int:
        """Bytes that one of them takes at least in a binary file."""
        return sum(np.dtype(p.length_kind or p.kind).itemsize for p in self.properties)


class _Lists(NamedTuple):
    """Lists of different lengths, one after the other."""

    values: NDArray[np.float64]
    counts: NDArray[np.int64]


_Columns = dict[str, "NDArray[np.float64] | _Lists"]


def read_ply(path: Path, data: bytes, config: LoadConfig) -> Content:
    """Read a PLY file.

    Raises:
        PrepareFailure: Its header makes no sense or claims more than the file holds.
    """
    elements, order, body = _header(data)
    for element in elements:
        if element.number * max(element.least if order else 2, 1) > len(body) + 1:
            raise unreadable(
                f"the header claims {element.number} of `{element.name}`, "
                f"the file has {len(body)} bytes after it"
            )
        if element.number > 3 * config.max_faces:
            raise PrepareFailure(
                Status.TOO_COMPLEX,
                f"{element.number} of `{element.name}`; load.max_faces is {config.max_faces}",
            )
    columns = _binary(elements, order, body) if order else _text(elements, body)
    vertices = _vertices(columns.get("vertex", {}))
    parts = [Part(vertices, _faces(columns.get("face", {}), vertices))]
    if "tristrips" in columns:
        parts.append(Part(vertices, _strips(columns["tristrips"])))
    return Content(joined_parts(parts, config), np.eye(3), None)


def _header(data: bytes) -> tuple[list[_Element], str, bytes]:
    end = data.find(b"end_header")
    if not data[:4].strip().lower().startswith(b"ply") or end < 0:
        raise unreadable("it has no PLY header")
    newline = data.find(b"\n", end)
    carriage = data.find(b"\r", end)
    stop = newline if newline >= 0 else carriage
    if carriage == end + len(b"end_header") and newline != carriage + 1:
        stop = carriage  # lines that end with a carriage return alone
    if stop < 0:
        raise unreadable("its PLY header has no end")
    elements: list[_Element] = []
    order = None
    for line in data[:end].replace(b"\r", b"\n").split(b"\n"):
        words = line.split()
        try:
            if not words or words[0] in (b"comment", b"obj_info", b"ply"):
                continue
            if words[0] == b"format":
                order = _ORDERS[words[1]]
            elif words[0] == b"element":
                elements.append(_Element(words[1].decode(), _count(words[2]), []))
            elif words[0] == b"property":
                elements[-1].properties.append(_property([w.decode() for w in words[1:]]))
            else:
                raise KeyError
        except (KeyError, IndexError, ValueError) as err:
            text = line.decode(errors="replace").strip()[:60]
            raise unreadable(f"its PLY header has the line {text!r}") from err
    if order is None:
        raise unreadable("its PLY header names no format")
    return elements, order, data[stop + 1 :]


def _count(word: bytes) -> int:
    count = int(word)
    if count < 0:
        raise ValueError
    return count


def _property(words: list[str]) -> _Property:
    if words[0] == "list":
        return _Property(words[3], _TYPES[words[2]], _TYPES[words[1]])
    return _Property(words[1], _TYPES[words[0]])


def _vertices(columns: _Columns) -> NDArray[np.float64]:
    axes = [columns.get(axis) for axis in "xyz"]
    if any(not isinstance(a, np.ndarray) for a in axes):
        if not columns:
            return np.zeros((0, 3))
        raise unreadable("its vertices have no x, y and z")
    return np.stack(axes, axis=1)  # type: ignore[arg-type]


def _faces(columns: _Columns, vertices: NDArray[np.float64]) -> NDArray[np.int64]:
    lists = {k: v for k, v in columns.items() if isinstance(v, _Lists)}
    named = [k for k in _INDICES if k in lists] or list(lists)
    if not named:
        return np.zeros((0, 3), np.int64)
    corners, counts = _whole(lists[named[0]].values), lists[named[0]].counts
    if len(corners) and (corners.min() < 0 or corners.max() >= len(vertices)):
        bad = corners[(corners < 0) | (corners >= len(vertices))][0]
        raise unreadable(f"a face names vertex {bad} of {len(vertices)}, which does not exist")
    return triangulated(vertices, corners, counts)


def _strips(columns: _Columns) -> NDArray[np.int64]:
    """Triangles of strips; -1 begins a new one."""
    found = [np.zeros((0, 3), np.int64)]
    for lists in columns.values():
        if not isinstance(lists, _Lists):
            continue
        breaks = np.full(len(lists.counts), -1)
        row = np.insert(_whole(lists.values), np.cumsum(lists.counts), breaks)
        place = np.arange(len(row))
        since = place - np.maximum.accumulate(np.where(row < 0, place, -1)) - 1
        triple = np.stack([row[:-2], row[1:-1], row[2:]], axis=1)
        good = (triple >= 0).all(axis=1)
        odd = since[:-2] % 2 == 1
        found.append(np.where(odd[:, None], triple[:, [1, 0, 2]], triple)[good])
    return np.concatenate(found)


def _whole(values: NDArray[np.float64]) -> NDArray[np.int64]:
    if not np.isfinite(values).all() or (np.abs(values) > 2**40).any():
        raise unreadable("a face names a vertex that does not exist")
    return values.astype(np.int64)


def _binary(elements: list[_Element], order: str, body: bytes) -> dict[str, _Columns]:
    found: dict[str, _Columns] = {}
    start = 0
    for element in elements:
        if element.name not in found:
            found[element.name], start = _binary_rows(element, order, body, start)
    return found


def _binary_rows(element: _Element, order: str, body: bytes, start: int) -> tuple[_Columns, int]:
    """Read the rows of an element; fast where each list has the length it has in the first row."""
    lengths = _first_lengths(element, order, body, start)
    fields: list[tuple[str, str] | tuple[str, str, tuple[int, ...]]] = []
    for k, p in enumerate(element.properties):
        if p.length_kind:
            fields.append((f"n{k}", order + p.length_kind))
            fields.append((f"v{k}", order + p.kind, (lengths[k],)))
        else:
            fields.append((f"v{k}", order + p.kind))
    dtype = np.dtype(fields)
    if not dtype.itemsize or not element.number:
        return {}, start
    if len(body) - start >= element.number * dtype.itemsize:
        rows = np.frombuffer(body, dtype, element.number, start)
        even = all((rows[f"n{k}"] == n).all() for k, n in lengths.items())
        if even:
            columns: _Columns = {}
            for k, p in enumerate(element.properties):
                values = rows[f"v{k}"].astype(np.float64)
                if p.length_kind:
                    counts = np.full(element.number, lengths[k], np.int64)
                    columns[p.name] = _Lists(values.reshape(-1), counts)
                else:
                    columns[p.name] = values
            return columns, start + element.number * dtype.itemsize
    if not lengths:
        raise _cut(element)
    return _uneven_rows(element, order, body, start)


def _first_lengths(element: _Element, order: str, body: bytes, start: int) -> dict[int, int]:
    lengths: dict[int, int] = {}
    for k, p in enumerate(element.properties):
        if p.length_kind and element.number:
            lengths[k], start = _length(element, p, order, body, start)
            start += lengths[k] * np.dtype(p.kind).itemsize
        else:
            start += np.dtype(p.kind).itemsize
    return lengths


def _length(
    element: _Element, p: _Property, order: str, body: bytes, start: int
) -> tuple[int, int]:
    size = np.dtype(p.length_kind).itemsize
    if start + size > len(body):
        raise _cut(element)
    length = np.frombuffer(body, order + p.length_kind, 1, start)[0]
    size_of_one = np.dtype(p.kind).itemsize
    if not 0 <= length <= (len(body) - start - size) // size_of_one:
        raise unreadable(f"a list in `{element.name}` claims {length} elements")
    return int(length), start + size


def _uneven_rows(element: _Element, order: str, body: bytes, start: int) -> tuple[_Columns, int]:
    values: list[list[NDArray[np.float64]]] = [[] for _ in element.properties]
    for _ in range(element.number):
        for k, p in enumerate(element.properties):
            count = 1
            if p.length_kind:
                count, start = _length(element, p, order, body, start)
            size = count * np.dtype(p.kind).itemsize
            if start + size > len(body):
                raise _cut(element)
            values[k].append(np.frombuffer(body, order + p.kind, count, start))
            start += size
    columns: _Columns = {}
    for p, column in zip(element.properties, values, strict=True):
        whole = np.concatenate(column).astype(np.float64)
        counts = np.array([len(c) for c in column], np.int64)
        columns[p.name] = _Lists(whole, counts) if p.length_kind else whole
    return columns, start


def _text(elements: list[_Element], body: bytes) -> dict[str, _Columns]:
    try:
        values = numbers(body.split())
    except ValueError as err:
        raise unreadable("a word after its header is no number") from err
    found: dict[str, _Columns] = {}
    start = 0
    for element in elements:
        columns: dict[str, list[NDArray[np.float64]]] = {p.name: [] for p in element.properties}
        single = not any(p.length_kind for p in element.properties)
        if single:
            width = len(element.properties)
            rows = values[start : start + element.number * width]
            if len(rows) < element.number * width:
                raise _cut(element)
            start += len(rows)
            table = rows.reshape(element.number, width)
            found[element.name] = {p.name: table[:, k] for k, p in enumerate(element.properties)}
            continue
        for _ in range(element.number):
            for p in element.properties:
                count = 1
                if p.length_kind:
                    if start >= len(values) or not 0 <= values[start] <= len(values) - start - 1:
                        raise _cut(element)
                    count, start = int(values[start]), start + 1
                columns[p.name].append(values[start : start + count])
                start += count
        if start > len(values):
            raise _cut(element)
        found[element.name] = {
            p.name: _Lists(
                np.concatenate([np.zeros(0), *columns[p.name]]),
                np.array([len(c) for c in columns[p.name]], np.int64),
            )
            if p.length_kind
            else np.concatenate([np.zeros(0), *columns[p.name]])
            for p in element.properties
        }
    return found


def _cut(element: _Element) -> PrepareFailure:
    return unreadable(
        f"the file is cut off: it does not hold the {element.number} of `{element.name}` "
        "that its header claims"
    )
