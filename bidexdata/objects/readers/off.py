"""OFF: vertices and polygons; normals, colours and texture coordinates are not read."""

from __future__ import annotations

import re
from itertools import islice
from pathlib import Path

import numpy as np

from bidexdata.objects.config import LoadConfig
from bidexdata.objects.polygons import triangulated

from .content import Content, Part, check_faces, joined_parts, unreadable
from .text import bad_numbers, plain_text, whole_numbers


def read_off(path: Path, data: bytes, config: LoadConfig) -> Content:
    """Read an OFF file; the counts may follow the first word without a space, as in ModelNet.

    Raises:
        PrepareFailure: It is cut off or a line makes no sense.
    """
    text = plain_text(data)
    header = re.match(rb"\s*(?:#[^\n]*\n\s*)*(?:ST)?C?N?OFF(?=[\s\d#])", text)
    if header is None:
        raise unreadable("it does not begin with `OFF`, or is in a variant that is not read")
    first = text[: header.end()].count(b"\n") + 1
    rows = (
        (number, words)
        for number, line in enumerate(text[header.end() :].split(b"\n"), first)
        if (words := line.split(b"#", 1)[0].split())
    )
    _, counts = next(rows, (0, []))
    try:
        vertex_count, face_count = (int(c) for c in whole_numbers(counts[:2]))
    except ValueError as err:
        raise unreadable("its counts of vertices and faces are missing") from err
    held = len(text) // 2
    if not (0 <= vertex_count <= held and 0 <= face_count <= held):
        raise unreadable(f"it claims {vertex_count} vertices and {face_count} faces")
    check_faces(face_count, config)
    points = [(n, w[:3]) for n, w in islice(rows, vertex_count)]
    polygons = [(n, w) for n, w in islice(rows, face_count)]
    if len(points) < vertex_count or len(polygons) < face_count:
        raise unreadable(
            f"the file is cut off: {len(points)} of {vertex_count} vertices, "
            f"{len(polygons)} of {face_count} faces"
        )
    vertices = np.array([_numbers(n, w) for n, w in points]).reshape(-1, 3)
    indices = [_polygon(n, w, vertex_count) for n, w in polygons]
    sizes = np.array([len(i) for i in indices], np.int64)
    corners = np.concatenate([np.zeros(0, np.int64), *indices])
    return Content(
        joined_parts([Part(vertices, triangulated(vertices, corners, sizes))], config),
        np.eye(3),
        None,
    )


def _numbers(number: int, words: list[bytes]) -> list[float]:
    try:
        values = [float(w) for w in words]
    except ValueError:
        values = []
    if len(values) < 3:
        raise unreadable(bad_numbers(b" ".join(words), number, "a vertex of three numbers"))
    return values


def _polygon(number: int, words: list[bytes], vertex_count: int) -> np.ndarray:
    try:
        values = [int(w) for w in words[: 1 + int(words[0])]]
    except ValueError:
        values = [0]
    if values[0] < 1 or len(values) < 1 + values[0]:
        raise unreadable(bad_numbers(b" ".join(words), number, "a count and as many vertices"))
    if min(values[1:]) < 0 or max(values[1:]) >= vertex_count:
        raise unreadable(f"line {number}: a face names a vertex that does not exist")
    return np.array(values[1:], np.int64)
