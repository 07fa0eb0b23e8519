"""Wavefront OBJ: vertices, polygons and their groups; no materials, normals or textures."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.config import LoadConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.polygons import triangulated
from bidexdata.record.status import Status
from bidexdata.wording import counted

from .content import Content, Part, check_faces, joined_parts, unreadable
from .inside import leads_out
from .text import bad_numbers, numbers, plain_text, shown, whole_numbers


def read_obj(path: Path, data: bytes, config: LoadConfig) -> Content:
    """Read an OBJ file.

    Raises:
        PrepareFailure: A line is no vertex or face, a face names a vertex that does not exist, or
            there is none.
    """
    plain = plain_text(data)
    lines = plain.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").split(b"\n")
    points: list[bytes] = []
    polygons: list[bytes] = []
    point_lines, polygon_lines, before, owner = [], [], [], []
    group, libraries = 0, []
    for number, raw in enumerate(lines, 1):
        line = raw.lstrip()
        head = line[:2]
        if head in (b"v ", b"v\t"):
            points.append(line[2:])
            point_lines.append(number)
        elif head in (b"f ", b"f\t"):
            polygons.append(line[2:])
            polygon_lines.append(number)
            before.append(len(points))
            owner.append(group)
        elif head.rstrip() in (b"o", b"g"):
            group += 1
        elif line.startswith(b"mtllib"):
            libraries.append(line[len(b"mtllib") :])
    if not polygons:
        raise PrepareFailure(Status.NO_FACES, f"{len(points)} vertices and no face")
    check_faces(len(polygons), config)
    vertices = _vertices(points, point_lines)
    corners, counts = _corners(polygons, polygon_lines, len(vertices), np.array(before))
    mesh = joined_parts([Part(vertices, triangulated(vertices, corners, counts))], config)
    group = np.repeat(owner, np.maximum(counts - 2, 0))
    return Content(mesh, np.eye(3), None, _doubts(plain, libraries), group)


def _doubts(plain: bytes, libraries: list[bytes]) -> tuple[str, ...]:
    """What an honest exporter does not write; the triangles are read all the same."""
    nuls = plain.count(b"\0")
    found = [f"{counted(nuls, 'NUL byte')} in the text: is the file damaged?"] if nuls else []
    found += [f"it names {shown(name)}, which is not read" for name in libraries if leads_out(name)]
    return tuple(found)


def _vertices(points: list[bytes], lines: list[int]) -> NDArray[np.float64]:
    rows = [p.split(None, 3)[:3] for p in points]
    for k, row in enumerate(rows):
        if len(row) < 3:
            raise unreadable(bad_numbers(b"v " + points[k], lines[k], "a vertex of three numbers"))
    try:
        return numbers([word for row in rows for word in row]).reshape(-1, 3)
    except ValueError:
        for k, row in enumerate(rows):
            try:
                numbers(row)
            except ValueError as err:
                text = bad_numbers(b"v " + points[k], lines[k], "a vertex of three numbers")
                raise unreadable(text) from err
        raise


def _corners(
    polygons: list[bytes], lines: list[int], count: int, before: NDArray[np.intp]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Vertex numbers from 0 of all polygons, and how many each has."""
    text = re.sub(rb"/[^ \t\n]*", b"", b"\n".join(p.split(b"#", 1)[0] for p in polygons))
    rows = [row.split() for row in text.split(b"\n")]
    counts = np.array([len(row) for row in rows], np.int64)
    try:
        corners = whole_numbers([word for row in rows for word in row])
    except ValueError as err:
        k = next(k for k, row in enumerate(rows) if not _are_whole(row))
        text = bad_numbers(b"f " + polygons[k], lines[k], "a face of whole numbers")
        raise unreadable(text) from err
    owner = np.repeat(np.arange(len(rows)), counts)
    # Negative numbers count back from the vertices above the line.
    index = np.where(corners > 0, corners - 1, corners + before[owner])
    index[corners == 0] = -1
    bad = np.flatnonzero((index < 0) | (index >= count))
    if len(bad):
        k, value = owner[bad[0]], corners[bad[0]]
        why = (
            "has the index 0; OBJ counts from 1"
            if value == 0
            else f"names vertex {value} of {count}"
        )
        raise unreadable(f"line {lines[k]}: a face ({shown(b'f ' + polygons[k])}) {why}")
    return index, counts


def _are_whole(words: list[bytes]) -> bool:
    try:
        whole_numbers(words)
    except ValueError:
        return False
    return True
