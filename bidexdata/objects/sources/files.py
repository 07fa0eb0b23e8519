"""Mesh files named by themselves, by a folder or by a glob."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from bidexdata.errors import PathNotFound
from bidexdata.objects.readers import SUFFIXES
from bidexdata.objects.readers.inside import lies_inside
from bidexdata.objects.sources.item import SourceItem
from bidexdata.objects.sources.lists import SIDE_LIST, side_list


def file_items(path: Path) -> list[SourceItem]:
    """One named file.

    Raises:
        PathNotFound: It does not exist.
    """
    if not path.is_file():
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

    Raises:
        PathNotFound: Nothing matches.
    """
    found = [Path(p) for p in glob.glob(pattern, recursive=True) if _is_mesh(p)]
    found = [p for p in found if p.is_file()]
    if not found:
        raise PathNotFound(pattern, f"matching mesh files ({', '.join(SUFFIXES)})")
    items = [SourceItem(source_name=p.as_posix(), path=p) for p in found]
    items.sort(key=byte_order)
    return [described([item], item.path.parent)[0] for item in items if item.path]


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


def described(items: list[SourceItem], folder: Path) -> list[SourceItem]:
    """Add what an `INDEX.csv` in the folder or beside it says of the files."""
    for place in (folder, folder.resolve().parent):
        if (place / SIDE_LIST).is_file():
            known = side_list(place / SIDE_LIST)
            return [_with_origin(item, known, place) for item in items]
    return items


def _with_origin(item: SourceItem, known: dict[str, dict[str, Any]], place: Path) -> SourceItem:
    assert item.path is not None
    inside = os.path.relpath(item.path.resolve(), place.resolve())
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
