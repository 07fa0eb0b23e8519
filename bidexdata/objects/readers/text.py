"""Text of mesh files: encodings, numbers, and the line at which it stops making sense."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .content import unreadable

_BOMS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)


def plain_text(data: bytes) -> bytes:
    """Return text as UTF-8 without a byte order mark; text that has none stays as it is.

    Raises:
        PrepareFailure: It is not in the encoding that its mark says.
    """
    for mark, encoding in _BOMS:
        if data.startswith(mark):
            try:
                return data[len(mark) :].decode(encoding).encode()
            except UnicodeError as err:
                raise unreadable(f"it is no text in {encoding}") from err
    return data


def numbers(words: Sequence[bytes]) -> NDArray[np.float64]:
    """Numbers of words; `nan` and `inf` are some.

    Raises:
        ValueError: A word is no number.
    """
    return np.array(words, dtype="S").astype(np.float64) if len(words) else np.zeros(0)


def whole_numbers(words: Sequence[bytes]) -> NDArray[np.int64]:
    """Whole numbers of words.

    Raises:
        ValueError: A word is none.
    """
    try:
        return np.array(words, dtype="S").astype(np.int64) if len(words) else np.zeros(0, np.int64)
    except OverflowError as err:
        raise ValueError("too large") from err


def shown(line: bytes) -> str:
    """A line for a message: short, printable, between quotes."""
    text = line.decode("utf-8", errors="replace").strip()
    return repr(text if len(text) <= 60 else text[:57] + "...")


def bad_numbers(line: bytes, number: int, what: str) -> str:
    """What is wrong with a line that should hold numbers."""
    hint = ": write a point, not a comma, before decimals" if re.search(rb"\d,\d", line) else ""
    return f"line {number}: {shown(line)} is not {what}{hint}"
