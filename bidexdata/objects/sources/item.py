"""SourceItem: one input of `prepare`, before anything of it has been read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bidexdata.wording import storable

UNKNOWN = "unknown"
"""Licence, author or source that nobody stated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceItem:
    """One mesh file, object folder or built-in shape, and what is known of its origin."""

    source_name: str
    """The original name: the path relative to the named folder, or `shapes:box/2`."""
    path: Path | None = None
    """The mesh file; None for a built-in shape."""
    shape: str | None = None
    """Name of a built-in shape, `family/number`; None for a file."""
    uid: str = ""
    """Identifier in Objaverse; `path` is None until its file has been fetched."""
    source: str = UNKNOWN
    """Collection or address that the object is from."""
    licence: str = UNKNOWN
    """SPDX identifier where one exists."""
    author: str = UNKNOWN
    category: str = UNKNOWN
    pieces: tuple[Path, ...] = ()
    """Files whose groups are the object's convex pieces, where the source gives them; `path` is
    then the object's folder or the one file."""
    shown: Path | None = None
    """Mesh file to show of an object with given pieces; None: their union."""
    normalisation: str = ""
    """How the source scaled and placed the object, a word of docs/sources.md; empty: not said."""
    listed: bool = False
    """Whether a list names the file, so that it may not exist."""
    problem: str = ""
    """Why the input cannot be read, where listing it told; it becomes a report row."""

    def __post_init__(self):
        for name in ("source_name", "source", "licence", "author", "category", "problem"):
            object.__setattr__(self, name, storable(getattr(self, name)))
