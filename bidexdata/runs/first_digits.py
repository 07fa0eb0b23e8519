"""Grasps named by the first digits of their ids, as far as these are one grasp's alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from bidexdata.errors import BadValue, NotUsable
from bidexdata.wording import listed

DIGITS = 16
"""Of a whole grasp_id."""


def id_digits(option: str, wanted: str) -> str:
    """The digits that a person wrote, as ids have them.

    Args:
        option: What they were given to, for the message.
        wanted: A grasp_id, or its first digits.

    Raises:
        BadValue: It is no hexadecimal number of at most 16 digits.
    """
    digits = wanted.strip().lower()
    if not re.fullmatch(f"[0-9a-f]{{1,{DIGITS}}}", digits):
        raise BadValue(
            f"{option} {wanted!r}: a grasp_id is {DIGITS} hexadecimal digits, or the first few"
        )
    return digits


def require_one(path: Path, wanted: str, ids: Sequence[str], what: str) -> None:
    """Refuse digits that no grasp's id begins with, or several do.

    Args:
        path: The run, for messages.
        wanted: The digits.
        ids: Every id of the run that begins with them.
        what: What the ids are of, in the plural.

    Raises:
        NotUsable: There is not exactly one.
    """
    if not ids:
        raise NotUsable(
            f"{path} has no grasp {wanted}; `bidexdata table {path} --out grasps.csv` "
            "lists its grasps"
        )
    if len(ids) > 1:
        raise NotUsable(
            f"{len(ids)} {what} of {path} begin with {wanted}: {listed(ids)}; give more"
        )
