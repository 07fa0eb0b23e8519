"""Temporary files and folders beside their places: named by their writer, and swept when it is gone.

A name ends in `.<host>.<pid>.<anything>`, so that writers of one target do not touch each other's,
and what a killed one left is known for what it is.
"""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

STALE_AFTER = 24 * 3600.0
"""Age at which another machine's temporary file is taken for an orphan [s]."""


def temporary_beside(path: Path, ending: str) -> Path:
    """A hidden name beside `path` that no other process takes."""
    return path.parent / f".{path.name}.{socket.gethostname()}.{os.getpid()}.{ending}"


def orphans(temporaries: Iterable[Path]) -> Iterator[Path]:
    """Yield those of some temporary files or folders whose writer is gone.

    Their names end in `.<host>.<pid>.<anything>`; another machine's are orphans after a day.
    """
    host, now = socket.gethostname(), time.time()
    for path in temporaries:
        stem, _, pid = path.name.rpartition(".")[0].rpartition(".")
        ours = stem.endswith(f".{host}") and pid.isdecimal()
        with contextlib.suppress(OSError):
            old = now - path.stat().st_mtime > STALE_AFTER
            if old or (ours and not _alive(int(pid))):
                yield path


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it is there, and not ours
        return True
    return True


def sync_folder(folder: Path) -> None:
    """Make a rename survive a power cut, where the file system lets us ask for it."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
