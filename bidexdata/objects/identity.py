"""Who an input is: the bytes that identify it and the id made from its name and their hash."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.sources import SourceItem
from bidexdata.objects.sources.shapes import shape_bytes
from bidexdata.record.status import Status

_GENERIC = frozenset(
    {
        *("coacd", "collision", "decomposed", "google_16k", "mesh", "meshes", "model", "obj"),
        *("nontextured", "normalized", "object", "poisson", "scene", "simplified", "textured"),
        *("tsdf", "visual"),
    }
)
"""Names of files and folders that say nothing of the object; the folder above names it then."""


def source_bytes(item: SourceItem) -> bytes:
    """The bytes that identify an input: of its file, or of the recipe of a shape.

    Raises:
        PrepareFailure: The file does not exist or cannot be read.
    """
    if item.shape is not None:
        return shape_bytes(item.shape)
    assert item.path is not None
    try:
        return item.path.read_bytes()
    except OSError as err:
        reason = err.strerror or type(err).__name__
        raise PrepareFailure(Status.UNREADABLE, f"{item.path.name}: {reason}") from err


def object_id_of(item: SourceItem, data: bytes) -> str:
    """Slug of the source's own name, `-`, first 8 hex digits of the sha256 of its bytes."""
    if item.shape is not None:
        name = item.shape.replace("/", "_")
    else:
        assert item.path is not None
        parts = [item.path.stem, *reversed(Path(item.source_name).parent.parts)]
        parts += list(reversed(item.path.resolve().parent.parts))
        name = next((p for p in parts if p.lower() not in _GENERIC), item.path.stem)
    return named_id(name, hashlib.sha256(data).hexdigest())


def named_id(name: str, sha256: str) -> str:
    """Slug of a name, `-`, first 8 hex digits of a hash."""
    slug = re.sub(r"[^a-z0-9_-]+", "-", name.lower()).strip("-")[:48] or "object"
    return f"{slug}-{sha256[:8]}"
