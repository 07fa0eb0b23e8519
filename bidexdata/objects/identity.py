"""Who an input is: the bytes that identify it and the id made from its name and their hash."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path, PurePath

from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.readers.inside import regular_bytes
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


def source_bytes(item: SourceItem, most: int) -> bytes:
    """The bytes that identify an input: of its file or files, or of the recipe of a shape.

    Args:
        item: The input.
        most: Largest size of a file that is read [bytes].

    Raises:
        PrepareFailure: The file does not exist, cannot be read or is too large.
    """
    if item.shape is not None:
        return shape_bytes(item.shape)
    if item.problem:
        raise PrepareFailure(Status.UNREADABLE, item.problem)
    assert item.path is not None
    if not item.path.exists():
        raise PrepareFailure(Status.NO_FILE, "the paths of a list start at the list's own folder")
    if not item.pieces:
        return regular_bytes(item.path, most)
    # The same file prepared without its pieces is another solid: it must have another identity.
    parts = [b"pieces\n"]
    for path in (*item.pieces, *(() if item.shown is None else (item.shown,))):
        data = regular_bytes(path, most)
        inside = path.relative_to(item.path).as_posix()
        parts += [f"{inside} {len(data)}\n".encode(), data]
    return b"".join(parts)


def object_id_of(item: SourceItem, data: bytes) -> str:
    """Slug of the source's own name, `-`, first 8 hex digits of the sha256 of its bytes."""
    if item.shape is not None:
        name = item.shape.replace("/", "_")
    elif item.pieces:
        name = PurePath(item.source_name).name
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
