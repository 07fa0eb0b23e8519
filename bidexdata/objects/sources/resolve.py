"""Turn the SOURCE arguments of `prepare` into a list of inputs."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from pathlib import Path

from bidexdata.errors import UnknownName
from bidexdata.objects.readers.inside import real_path

from .files import file_items, folder_items, glob_items
from .item import SourceItem
from .lists import list_items
from .objaverse import objaverse_items
from .shapes import shape_items
from .trees import bodex_items, dexgraspnet_items

_ADAPTERS = {
    "shapes": shape_items,
    "dexgraspnet": dexgraspnet_items,
    "bodex": bodex_items,
    "objaverse": objaverse_items,
}
_LISTS = (".txt", ".csv")


def resolve_sources(sources: Sequence[str]) -> list[SourceItem]:
    """List the inputs that the sources name, in order, without reading a mesh.

    A source is a mesh file, a folder (searched recursively), a glob, a list file (`.txt` with a
    path per line; `.csv` with a column `file` and, if present, `source`, `licence`, `author`,
    `category`), `shapes[:FAMILY,...]`, a tree of another project, `dexgraspnet:PATH` or
    `bodex:PATH`, or `objaverse:...`, whose files `fetched` brings. Files of one source come in byte order of their paths;
    a path that two sources name comes once, or
    twice where only one of them takes its convex pieces.

    Raises:
        PathNotFound: A path does not exist, or a glob or folder holds no mesh file.
        NotUsable: A tree holds no object of its project, or a list cannot be read.
        UnknownName: A prefix or a family of shapes does not exist.
    """
    items: list[SourceItem] = []
    seen: set[tuple[Path | None, str | None, str, bool]] = set()
    for source in sources:
        for item in _items_of(source):
            # A file of pieces and the same file as an ordinary mesh are two objects.
            path = real_path(item.path) if item.path else None
            key = (path, item.shape, item.uid, bool(item.pieces))
            if key not in seen:
                seen.add(key)
                items.append(item)
    return items


def _items_of(source: str) -> list[SourceItem]:
    prefix, colon, rest = source.partition(":")
    if prefix in _ADAPTERS and not os.path.exists(source):
        return _ADAPTERS[prefix](rest)
    path = Path(source)
    if os.path.isdir(path):
        return folder_items(path)
    if os.path.isfile(path):
        return list_items(path) if path.suffix.lower() in _LISTS else file_items(path)
    if glob.has_magic(source):
        return glob_items(source)
    # One letter before the colon is a drive, not an adapter.
    if colon and prefix.isalnum() and len(prefix) > 1:
        raise UnknownName("source", prefix, _ADAPTERS, "or write a path or a glob")
    return file_items(path)
