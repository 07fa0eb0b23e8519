"""Folders of objects in a library that is being made: which are whole, and what the index says.

An object's folder is written under a temporary name and renamed, so it is whole or not there;
what a killed worker leaves is told from what another machine is writing just now.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bidexdata.errors import Contradiction
from bidexdata.kinds import OBJECTS, PARTS
from bidexdata.objects.library import content_sha256
from bidexdata.objects.storage import read_document
from bidexdata.runs.library_report import TIMES
from bidexdata.runs.prepare_parts import Row
from bidexdata.runs.shards import orphans, sweep

MADE = (
    *("source_faces", "source_diagonal", "repair", "repair_steps", "hausdorff"),
    *("piece_method", "pieces", "volume_ratio", "solid_hausdorff"),
    *("aspect", "thickness", "components", "genus", "mesh_hash", "warnings"),
)
"""Columns of the index that only making an object gives; an import leaves some out."""


def made_columns(folder: Path, sha256: str, *, config: Any = None, content: str = "") -> Row | None:
    """Columns of the index of an object's folder that is whole and was made of these bytes.

    Args:
        folder: Of the object.
        sha256: Of its source.
        config: The configuration that must have made it; any when omitted.
        content: What its files hash to, where an index says so; a folder of other bytes is damaged.

    Returns:
        None where it has to be made.
    """
    if not folder.is_dir():
        return None
    try:
        document = read_document(folder)
        made_of = document["provenance"]["source_sha256"]
        fits = made_of == sha256 and (config is None or document.get("config") == config)
        columns = index_columns(folder, document) if fits else None
    except (Contradiction, KeyError, TypeError):
        return None
    if columns is None or (content and columns["content_sha256"] != content):
        return None
    return columns


def index_columns(folder: Path, document: Mapping[str, Any] | None = None) -> Row:
    """Columns of a made object, from its folder: the same whether it was made now or before.

    Args:
        folder: Of the object.
        document: Its `object.json`, where that has been read.
    """
    document = document or read_document(folder)
    known = document["provenance"]
    return {
        **{name: known[name] for name in MADE if name in known},
        "volume": document["volume"],
        "rest_poses": len(document["rest_heights"]),
        "content_sha256": content_sha256(folder),
    }


def remove_partials(library: Path) -> None:
    """Remove what killed workers left half written, and nothing of other machines at work."""
    for partial in orphans(library.glob(f"{OBJECTS}/*/.*.partial")):
        shutil.rmtree(partial, ignore_errors=True)
    for pattern in (".*.partial", ".*.tmp"):
        for partial in orphans(library.glob(pattern)):
            partial.unlink(missing_ok=True)
    sweep([library / TIMES, library / PARTS])
