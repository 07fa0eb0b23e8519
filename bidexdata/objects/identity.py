"""Who an input is: the bytes that identify it and the id made from its name and their hash."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePath
from typing import NamedTuple

from bidexdata.objects.readers.gltf import named_buffers
from bidexdata.objects.readers.inside import beside, regular_blocks, regular_size
from bidexdata.objects.sources import SourceItem
from bidexdata.objects.sources.shapes import shape_bytes
from bidexdata.record.status import Status
from bidexdata.wording import counted

from .failure import PrepareFailure

_GENERIC = frozenset(
    {
        *("coacd", "collision", "decomposed", "google_16k", "mesh", "meshes", "model", "obj"),
        *("nontextured", "normalized", "object", "poisson", "scene", "simplified", "textured"),
        *("tsdf", "visual"),
    }
)
"""Names of files and folders that say nothing of the object; the folder above names it then."""


class Identity(NamedTuple):
    """What tells an input from others."""

    sha256: str
    """Of the bytes that identify it."""
    size: int
    """Number of them."""


def source_identity(item: SourceItem, most: int) -> Identity:
    """Hash what identifies an input, block by block: its file or files, or the recipe of a shape.

    Args:
        item: The input.
        most: Largest size of what is read, all files together [bytes].

    Raises:
        PrepareFailure: The file does not exist, cannot be read or is too large.
    """
    if item.shape is not None:
        return identity_of([shape_bytes(item.shape)])
    if item.problem:
        raise PrepareFailure(Status.UNREADABLE, item.problem)
    assert item.path is not None
    _check_there(item, item.path)
    if item.pieces:
        shown = () if item.shown is None else (item.shown,)
        named = [(p.relative_to(item.path).as_posix(), p) for p in (*item.pieces, *shown)]
        # The same file prepared without its pieces is another solid: it must have another identity.
        return identity_of(_with_names("pieces", named, most))
    buffers = _buffers(item.path, most)
    if buffers:
        return identity_of(_with_names("glTF", [("", item.path), *buffers], most))
    return identity_of(regular_blocks(item.path, regular_size(item.path, most)))


def identity_of(blocks: Iterable[bytes]) -> Identity:
    """Hash bytes that come block by block."""
    digest, size = hashlib.sha256(), 0
    for block in blocks:
        digest.update(block)
        size += len(block)
    return Identity(digest.hexdigest(), size)


def object_id_of(item: SourceItem, sha256: str) -> str:
    """Slug of the source's own name, `-`, first 8 hex digits of the hash that identifies it.

    Where the source lies is no part of the name: what it calls the input is all that counts.
    """
    if item.shape is not None:
        name = item.shape.replace("/", "_")
    elif item.pieces:
        name = PurePath(item.source_name).name
    else:
        assert item.path is not None
        parts = [item.path.stem, *reversed(PurePath(item.source_name).parent.parts)]
        telling = (p for p in parts if p.lower() not in _GENERIC and p.strip("./"))
        name = next(telling, item.path.stem)
    return named_id(name, sha256)


def named_id(name: str, sha256: str) -> str:
    """Slug of a name, `-`, first 8 hex digits of a hash."""
    slug = re.sub(r"[^a-z0-9_-]+", "-", name.lower()).strip("-")[:48] or "object"
    return f"{slug}-{sha256[:8]}"


def _check_there(item: SourceItem, path: Path) -> None:
    try:
        os.stat(path)
    except (FileNotFoundError, NotADirectoryError, ValueError) as err:  # ValueError: a NUL
        missing = Path(*path.parts[-2:]).as_posix()
        said = "the paths of a list start at the list's own folder" if item.listed else missing
        raise PrepareFailure(Status.NO_FILE, said) from err
    except OSError as err:
        raise PrepareFailure(Status.UNREADABLE, err.strerror or type(err).__name__) from err


def _with_names(kind: str, named: Sequence[tuple[str, Path]], most: int) -> Iterator[bytes]:
    """Names, sizes and contents of files that are one input together."""
    yield f"{kind}\n".encode()
    left = most
    for name, path in named:
        size = regular_size(path, most)
        left -= size
        if left < 0:
            files = counted(len(named), "file")
            reason = f"its {files} have more bytes together than load.max_bytes = {most}"
            raise PrepareFailure(Status.TOO_COMPLEX, reason)
        yield f"{name} {size}\n".encode("utf-8", "surrogateescape")
        yield from regular_blocks(path, size)


def _buffers(path: Path, most: int) -> list[tuple[str, Path]]:
    """Files beside a glTF file that its reader would read; it says why it does not read others."""
    if path.suffix.lower() not in (".gltf", ".glb"):
        return []
    found = []
    for name in named_buffers(regular_blocks(path, regular_size(path, most))):
        with contextlib.suppress(PrepareFailure):
            buffer = beside(path.parent, name)
            regular_size(buffer, most)
            found.append((name, buffer))
    return found
