"""Texts for a person: numbers with the word for what they count, names that can be stored."""

from __future__ import annotations

import re
from collections.abc import Sequence


def counted(n: int, one: str, many: str = "") -> str:
    """A number and its noun, singular or plural.

    Args:
        n: How many.
        one: The words for one, such as `task` or `task is`.
        many: Those for any other number; `one` with an s when empty.

    >>> counted(1, "row"), counted(0, "row"), counted(2, "task is", "tasks are")
    ('1 row', '0 rows', '2 tasks are')
    """
    return f"{n} {one if n == 1 else many or one + 's'}"


def one_line(text: object) -> str:
    r"""A text, such as an engine's error, with blanks in place of its line breaks.

    >>> one_line(ValueError("mesh volume is too small\n  in hand"))
    'mesh volume is too small in hand'
    """
    return " ".join(str(text).split())


def listed(words: Sequence[str], first: int = 3) -> str:
    """The first of some words, and how many more there are.

    >>> listed(["a", "b"]), listed(["a", "b", "c", "d", "e"])
    ('a, b', 'a, b, c and 2 more')
    """
    more = f" and {len(words) - first} more" if len(words) > first else ""
    return ", ".join(words[:first]) + more


def storable(text: str) -> str:
    r"""A text with `\xNN` or `\uNNNN` for what UTF-8 has no bytes for, as in some file names.

    >>> storable("caf\udce9.obj"), storable("café")
    ('caf\\xe9.obj', 'café')
    """
    text = re.sub("[\udc80-\udcff]", lambda m: f"\\x{ord(m[0]) - 0xDC00:02x}", text)
    return text.encode("utf-8", "backslashreplace").decode()


def share(value: float | None, missing: str = "-") -> str:
    """A share in percent, or the word for one that there is not.

    >>> share(0.875), share(None)
    ('87.5 %', '-')
    """
    return missing if value is None else f"{100 * value:.1f} %"


def duration(seconds: float) -> str:
    """A time to the second, or to the minute from an hour on.

    >>> duration(59.7), duration(7199.0)
    ('1 min 0 s', '1 h 59 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
