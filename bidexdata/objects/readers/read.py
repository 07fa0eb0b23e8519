"""Read any mesh file: the reader by its suffix."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from bidexdata.objects.config import LoadConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.record.status import Status

from .content import Content, unreadable
from .dae import read_dae
from .gltf import read_gltf
from .obj import read_obj
from .off import read_off
from .ply import read_ply
from .stl import read_stl
from .threemf import read_3mf

_READERS: dict[str, Callable[[Path, bytes, LoadConfig], Content]] = {
    ".3mf": read_3mf,
    ".dae": read_dae,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".obj": read_obj,
    ".off": read_off,
    ".ply": read_ply,
    ".stl": read_stl,
}
SUFFIXES = tuple(sorted(_READERS))
"""File types that are read, in lower case."""


def read_content(path: Path, data: bytes, config: LoadConfig) -> Content:
    """Read a mesh file.

    Args:
        path: Where it lies; only its suffix decides how it is read, and a glTF file's buffers are
            looked for beside it.
        data: Its bytes.
        config: Bounds.

    Raises:
        PrepareFailure: It is no mesh, or one that cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        known = ", ".join(SUFFIXES)
        raise PrepareFailure(Status.UNSUPPORTED, f"{suffix or 'no'} file type; known: {known}")
    if not data.strip(b"\0 \t\r\n"):
        raise unreadable("the file is empty" if not data else "the file holds only blanks")
    try:
        # What is not finite is refused or dropped later, with its count.
        with np.errstate(all="ignore"):
            return _READERS[suffix](path, data, config)
    except MemoryError as err:
        raise PrepareFailure(Status.TOO_COMPLEX, "reading it needs too much memory") from err
    except RecursionError as err:
        raise unreadable("it is nested too deep") from err
