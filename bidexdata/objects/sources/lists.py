"""List files: which meshes, and where each comes from."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path
from typing import Any

from bidexdata.errors import NotUsable
from bidexdata.objects.readers.inside import file_inside

from .item import SourceItem

SIDE_LIST = "INDEX.csv"
"""Name of a list that describes the files of a folder in which or beside which it lies."""
_MOST = 1 << 26
"""Size above which such a list is not read [bytes]."""
_COLUMNS = ("source", "licence", "author", "category")
_SPELLINGS = {"license": "licence", "path": "file", "filename": "file"}


def list_items(path: Path) -> list[SourceItem]:
    """Inputs named by a `.txt` (a path per line, `#` comments) or `.csv` list.

    Paths are relative to the list's folder. A listed file that does not exist stays in the list
    and becomes a report row.

    Raises:
        NotUsable: The list is no text, names nothing, or a `.csv` has no column `file`.
    """
    if path.suffix.lower() == ".csv":
        rows = _rows(path, _text(path))
    else:
        rows = [{"file": line} for line in text_lines(path)]
    if not rows:
        raise NotUsable(f"{path}: the list names no file")
    names = _names([row["file"] for row in rows], path.parent)
    return [
        SourceItem(source_name=name, path=path.parent / row["file"], listed=True, **_origin(row))
        for name, row in zip(names, rows, strict=True)
    ]


def _names(files: list[str], folder: Path) -> list[str]:
    """What files are called: absolute paths lose the folders that say whose machine it is.

    They are named from the list's folder where they lie in it, else from the folder that all such
    paths share.
    """
    here = Path(os.path.abspath(folder))
    paths = [Path(os.path.normpath(file)) for file in files]
    outside = [p for p in paths if p.is_absolute() and not p.is_relative_to(here)]
    shared = os.path.commonpath([p.parent for p in outside]) if outside else ""
    return [
        p.relative_to(here if p.is_relative_to(here) else shared).as_posix()
        if p.is_absolute()
        else file
        for file, p in zip(files, paths, strict=True)
    ]


def text_lines(path: Path) -> list[str]:
    """Lines of a text file without `#` comments and empty ones.

    Raises:
        NotUsable: It is no text.
    """
    lines = (line.split(" #")[0].strip() for line in _text(path).splitlines())
    return [line for line in lines if line and not line.startswith("#")]


def side_list(folder: Path) -> dict[str, dict[str, Any]]:
    """Origin of each file that the list `INDEX.csv` in a folder names, by the name it uses.

    Raises:
        NotUsable: The list is no text, no table, or has no column `file`.
        PrepareFailure: It is a link out of the folder, cannot be read or is too large.
    """
    path = folder / SIDE_LIST
    text = _decoded(path, file_inside(folder, SIDE_LIST, _MOST))
    return {row["file"]: _origin(row) for row in _rows(path, text)}


def _rows(path: Path, text: str) -> list[dict[str, str]]:
    try:
        reader = csv.DictReader(io.StringIO(text, newline=""))
        names = [n.strip().lower() for n in reader.fieldnames or []]
        names = [_SPELLINGS.get(n, n) for n in names]
        if "file" not in names:
            raise NotUsable(f"{path}: a list needs a column `file`; it has: {', '.join(names)}")
        reader.fieldnames = names
        rows = ({k: (v or "").strip() for k, v in row.items() if k in names} for row in reader)
        return [row for row in rows if row["file"]]
    except csv.Error as err:
        raise NotUsable(f"{path}: not a table ({err})") from err


def _origin(row: dict[str, str]) -> dict[str, Any]:
    return {name: row[name] for name in _COLUMNS if row.get(name)}


def _text(path: Path) -> str:
    try:
        return _decoded(path, path.read_bytes())
    except OSError as err:
        raise NotUsable(f"{path}: cannot be read ({err.strerror})") from err


def _decoded(path: Path, data: bytes) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        raise NotUsable(f"{path}: not a text file in UTF-8 ({err.reason})") from err
