"""STL, binary or text: triangles without shared vertices."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bidexdata.objects.config import LoadConfig

from .content import Content, Part, check_faces, joined_parts, unreadable
from .text import bad_numbers, numbers, plain_text

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path, data: bytes, config: LoadConfig) -> Content:
    """Read an STL file; what its first word says does not decide whether it is text.

    Raises:
        PrepareFailure: It is cut off, or its header claims another number of triangles.
    """
    count = struct.unpack("<I", data[80:84])[0] if len(data) >= 84 else 0
    if count and len(data) == 84 + 50 * count:
        check_faces(count, config)
        vertices = np.frombuffer(data, _RECORD, offset=84)["corners"].reshape(-1, 3)
    else:
        text = plain_text(data)
        head = text[:1024].lstrip().lower()
        if not (head.startswith(b"solid") and b"facet" in text[:4096].lower()):
            held = max(len(data) - 84, 0) // 50
            raise unreadable(f"the STL header claims {count} triangles, the file holds {held}")
        if b"endsolid" not in text[-4096:].lower():
            raise unreadable("the ASCII STL is cut off: no `endsolid`")
        vertices = _text_corners(text)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    return Content(
        joined_parts([Part(vertices.astype(np.float64), faces)], config), np.eye(3), None
    )


def _text_corners(text: bytes) -> NDArray[np.float64]:
    found = re.findall(rb"^[ \t]*vertex[ \t]+([^\r\n]*)", text, re.MULTILINE | re.IGNORECASE)
    rows = [line.split()[:3] for line in found]
    try:
        if len(rows) % 3 or any(len(row) < 3 for row in rows):
            raise ValueError
        return numbers([word for row in rows for word in row]).reshape(-1, 3)
    except ValueError as err:
        for number, line in enumerate(text.split(b"\n"), 1):
            words = line.split()
            if words and words[0].lower() == b"vertex" and not _three_numbers(words[1:]):
                text_ = bad_numbers(line, number, "a vertex of three numbers")
                raise unreadable(text_) from err
        raise unreadable(f"{len(rows)} vertices are not three per facet") from err


def _three_numbers(words: list[bytes]) -> bool:
    try:
        return len(numbers(words[:3])) == 3
    except ValueError:
        return False
