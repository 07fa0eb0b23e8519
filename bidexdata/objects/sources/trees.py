"""Trees of other projects whose objects are convex pieces: DexGraspNet, BODex (MeshProcess).

Neither tree states licences or authors; an `INDEX.csv` in or beside the tree may (its column
`file` names the objects' folders). A name such as `core-mug-<hash>` tells collection and category.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from bidexdata.errors import BadValue, NotUsable, PathNotFound

from .files import byte_order, described, leaving
from .item import UNKNOWN, SourceItem

UNIT_SPHERE = "unit sphere"
"""Box centred at the origin, farthest vertex of the surface at 1 / 1.03, of its pieces at about 0.98.
Source: DexGraspNet, asset_process/normalize.py."""
BOX_DIAGONAL = "box diagonal 2"
"""Box centred at the origin, its diagonal 2 (that of the pieces about 1 % more)."""
_DECOMPOSED = ("coacd", "decomposed.obj")
_PIECES = ("urdf", "meshes")
_SHOWN = ("mesh", "simplified.obj")
_COLLECTIONS = {
    "core": "ShapeNetCore",
    "sem": "ShapeNetSem",
    "mujoco": "Google Scanned Objects",
    "ddg": "Deep Differentiable Grasp",
}
"""What the first word of a DexGraspNet name stands for. Source: DexGraspNet, asset_process/README.md."""


def dexgraspnet_items(place: str) -> list[SourceItem]:
    """Objects `<object>/coacd/decomposed.obj` below a folder, in byte order of their names.

    Raises:
        BadValue: No folder is named.
        PathNotFound: The folder does not exist.
        NotUsable: No object is in it.
    """
    layout = "/".join(("<object>", *_DECOMPOSED))
    return _tree("dexgraspnet", place, layout, _dexgraspnet_item)


def bodex_items(place: str) -> list[SourceItem]:
    """Objects `<object>/urdf/meshes/*.obj` below a folder, in byte order of their names.

    Raises:
        BadValue: No folder is named.
        PathNotFound: The folder does not exist.
        NotUsable: No object is in it.
    """
    layout = "/".join(("<object>", *_PIECES, "*.obj"))
    return _tree("bodex", place, layout, _bodex_item)


def _dexgraspnet_item(folder: Path, name: str) -> SourceItem | None:
    """An object without its file is an input too: it becomes a report row."""
    if not os.path.isdir(folder / _DECOMPOSED[0]):
        return None
    path = folder.joinpath(*_DECOMPOSED)
    return SourceItem(
        source_name=name,
        path=path,
        pieces=(path,),
        normalisation=UNIT_SPHERE,
        **_told_by(name),
    )


def _bodex_item(folder: Path, name: str) -> SourceItem | None:
    shown = folder.joinpath(*_SHOWN)
    if not os.path.isdir(folder / _PIECES[0]) and not os.path.isfile(shown):
        return None
    pieces = [p for p in folder.joinpath(*_PIECES).glob("*.obj") if os.path.isfile(p)]
    return SourceItem(
        source_name=name,
        path=folder,
        pieces=tuple(sorted(pieces, key=os.fsencode)),
        shown=shown if os.path.isfile(shown) else None,
        normalisation=BOX_DIAGONAL,
        problem="" if pieces else f"no convex piece {'/'.join(_PIECES)}/*.obj",
        **_told_by(name),
    )


def _tree(
    prefix: str, place: str, layout: str, item_of: Callable[[Path, str], SourceItem | None]
) -> list[SourceItem]:
    """All folders below a place that are objects; what is inside an object is not searched."""
    if not place:
        raise BadValue(f"{prefix}: names no folder; write {prefix}:PATH")
    top, items = Path(place), []
    if not os.path.isdir(top):
        raise PathNotFound(top, f"a folder that holds {layout}")
    for root, folders, _ in os.walk(top):
        inside = Path(root).relative_to(top)
        item = item_of(Path(root), inside.as_posix() if inside.parts else top.resolve().name)
        if item is not None:
            read = (*item.pieces, *(() if item.shown is None else (item.shown,)))
            items.append(replace(item, problem=item.problem or leaving(read, top)))
            folders.clear()
        folders[:] = [name for name in folders if not name.startswith(".")]
    if not items:
        raise NotUsable(f"{top}: no object is in it; {prefix}:PATH takes a folder with {layout}")
    return sorted(described(items, top), key=byte_order)


def _told_by(name: str) -> dict[str, Any]:
    """Collection and category that a name of DexGraspNet tells."""
    collection, *words = re.split(r"[-_]", name.rpartition("/")[2])
    if collection not in _COLLECTIONS or not words:
        return {}
    hashed = collection in ("core", "sem") and re.fullmatch(r"[0-9a-f]{16,}", words[-1])
    category = "_".join(words[:-1]).lower() if hashed else ""
    return {"source": _COLLECTIONS[collection], "category": category or UNKNOWN}
