"""Mesh files named by themselves, by a folder or by a glob."""

from __future__ import annotations

import functools
import glob
import logging
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from bidexdata.errors import NotUsable, PathNotFound
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.readers import SUFFIXES
from bidexdata.objects.readers.inside import lies_inside, real_path

from .item import SourceItem
from .lists import SIDE_LIST, side_list

_Known = Mapping[str, Mapping[str, Any]]
"""Origin of each file that a list names."""
_log = logging.getLogger(__name__)


def file_items(path: Path) -> list[SourceItem]:
    """One named file.

    Raises:
        PathNotFound: It does not exist.
    """
    if not os.path.isfile(path):
        raise PathNotFound(path, f"a mesh file ({', '.join(SUFFIXES)}), a folder, a glob or a list")
    return described([SourceItem(source_name=path.name, path=path)], path.parent)


def folder_items(folder: Path) -> list[SourceItem]:
    """All mesh files below a folder, in byte order of their relative paths.

    Licences and categories come from `INDEX.csv` in the folder or beside it, if there is one.

    Raises:
        PathNotFound: No mesh file is below it.
    """
    found = []
    for root, folders, names in os.walk(folder):
        folders.sort()
        found += [Path(root, name) for name in names if _is_mesh(name)]
    if not found:
        raise PathNotFound(folder, f"mesh files in it ({', '.join(SUFFIXES)})")
    items = [
        SourceItem(
            source_name=p.relative_to(folder).as_posix(), path=p, problem=leaving([p], folder)
        )
        for p in found
    ]
    return described(sorted(items, key=byte_order), folder)


def glob_items(pattern: str) -> list[SourceItem]:
    """All mesh files that match a glob (`**` for any depth), in byte order of their paths.

    Their names are relative to the folder that the glob begins with, as those of a folder are.

    Raises:
        PathNotFound: Nothing matches.
    """
    found = [Path(p) for p in glob.glob(pattern, recursive=True) if _is_mesh(p)]
    found = [p for p in found if not os.path.isdir(p)]
    if not found:
        raise PathNotFound(pattern, f"matching mesh files ({', '.join(SUFFIXES)})")
    top = _fixed_folder(pattern)
    items = [SourceItem(source_name=p.relative_to(top).as_posix(), path=p) for p in found]
    items.sort(key=byte_order)
    known_in = functools.cache(usable_list)  # a list beside many folders is read once
    return [described([item], item.path.parent, known_in)[0] for item in items if item.path]


def _fixed_folder(pattern: str) -> Path:
    """The folders that a glob begins with, up to its first `*`, `?` or `[`."""
    parts = Path(pattern).parts
    magic = next(n for n, part in enumerate(parts) if glob.has_magic(part))
    return Path(*parts[:magic])


def leaving(paths: Iterable[Path], folder: Path) -> str:
    """Say which of the paths is a link out of a folder; empty when none is.

    A folder may come from anywhere, and its links must not make files of this machine readable;
    who names a file by itself, by a glob or in a list has seen it.
    """
    for path in paths:
        if not lies_inside(path, folder):
            return (
                f"{path.name} is a link to outside of the folder and was not read; "
                "name it by a glob or in a list to allow that"
            )
    return ""


def described(
    items: list[SourceItem],
    folder: Path,
    known_in: Callable[[Path], _Known | None] | None = None,
) -> list[SourceItem]:
    """Add what an `INDEX.csv` in the folder or beside it says of the files.

    Args:
        items: Inputs that have files.
        folder: Where they lie.
        known_in: What a folder's list says, where the caller keeps what was read.
    """
    for place in (folder, real_path(folder).parent):
        known = (known_in or usable_list)(place)
        if known is not None:
            return [_with_origin(item, known, place) for item in items]
    return items


def usable_list(place: Path) -> _Known | None:
    """What the list in a folder says; None where there is none, or none that can be used."""
    if not os.path.lexists(place / SIDE_LIST):
        return None
    try:
        return side_list(place)
    except (NotUsable, PrepareFailure) as err:  # it came with the files: they are what is wanted
        _log.warning("%s: not used for licences and categories: %s", place / SIDE_LIST, err)
        return None


def _with_origin(item: SourceItem, known: _Known, place: Path) -> SourceItem:
    assert item.path is not None
    inside = os.path.relpath(real_path(item.path), real_path(place))
    own = PurePosixPath(item.source_name).name
    names = (Path(inside).as_posix(), item.source_name, item.path.name, own)
    row = next((known[name] for name in names if name in known), None)
    return replace(item, **row) if row else item


def _is_mesh(name: str) -> bool:
    base = os.path.basename(name)
    return base.lower().endswith(SUFFIXES) and not base.startswith(".")


def byte_order(item: SourceItem) -> bytes:
    """The key that sorts inputs by the bytes of their names."""
    return os.fsencode(item.source_name)
