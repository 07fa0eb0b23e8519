"""Folders of objects in a library that is being made: which are whole, and what the index says.

An object's folder is written under a temporary name and renamed, so it is whole or not there;
what a killed worker leaves is told from what another machine is writing just now.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from bidexdata.errors import Contradiction
from bidexdata.kinds import OBJECTS
from bidexdata.objects.library import content_sha256
from bidexdata.objects.storage import read_document
from bidexdata.runs.prepare_parts import Row
from bidexdata.runs.shards import orphans

MADE = (
    *("source_faces", "source_diagonal", "repair", "repair_steps", "hausdorff"),
    *("piece_method", "pieces", "volume_ratio", "solid_hausdorff"),
    *("aspect", "thickness", "components", "genus", "mesh_hash", "warnings"),
)
"""Columns of the index that only making an object gives; an import leaves some out."""


def is_made(folder: Path, sha256: str, config: Any = None) -> bool:
    """Tell whether an object's folder is whole and was made of these bytes.

    Args:
        folder: Of the object.
        sha256: Of its source.
        config: The configuration that must have made it; any when omitted.
    """
    if not folder.is_dir():
        return False
    try:
        document = read_document(folder)
        content_sha256(folder)
    except Contradiction:
        return False
    made_of = document["provenance"].get("source_sha256")
    return made_of == sha256 and (config is None or document.get("config") == config)


def index_columns(folder: Path) -> Row:
    """Columns of a made object, from its folder: the same whether it was made now or before."""
    document = read_document(folder)
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
    for partial in orphans(library.glob(".*.partial")):
        partial.unlink(missing_ok=True)
