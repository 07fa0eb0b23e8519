"""A folder that is there whole or not at all: filled under a hidden name, synced once, renamed.

A killed writer leaves a hidden folder, which the next one to the same place removes. Two writers
at once do not touch each other's: the first to finish has the place, the other is refused.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bidexdata.errors import NotUsable
from bidexdata.temporaries import orphans, sync_folder, temporary_beside

_PARTIAL = "partial"


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Give a hidden folder to fill; at the end of the block it becomes `out`.

    Removed again where the block raises.

    Raises:
        NotUsable: `out` holds something by now.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    for orphan in orphans(out.parent.glob(f".{out.name}.*.{_PARTIAL}*")):
        shutil.rmtree(orphan, ignore_errors=True)
    partial = _make(out)
    try:
        yield partial
        sync_tree(partial)
        _rename(partial, out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    sync_folder(out.parent)


def refuse_taken(out: Path) -> None:
    """Refuse a place that holds something.

    Raises:
        NotUsable: It does.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise NotUsable(f"{out} exists already; a release is written once, choose another --out")


def sync_tree(folder: Path) -> None:
    """Put everything under a folder on the disk: by one call for its file system where there is one."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        sync = getattr(ctypes.CDLL(None, use_errno=True), "syncfs", None)
        if sync is not None:
            if sync(handle) == 0:
                return
            raise OSError(ctypes.get_errno(), "the disk did not take all of it", str(folder))
    finally:
        os.close(handle)
    for path in folder.rglob("*"):
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())
        else:
            sync_folder(path)


def _make(out: Path) -> Path:
    for number in itertools.count():  # another thread of this process may write the same place
        partial = temporary_beside(out, f"{_PARTIAL}{number}")
        try:
            partial.mkdir()
        except FileExistsError:
            continue
        return partial
    raise AssertionError("numbers do not end")


def _rename(partial: Path, out: Path) -> None:
    try:
        os.replace(partial, out)  # takes the place of an empty folder, and of nothing else
    except OSError:
        refuse_taken(out)
        raise
