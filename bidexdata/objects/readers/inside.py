"""Files beside a mesh file: read only where they lie in its folder, links followed."""

from __future__ import annotations

import os
from pathlib import Path

from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.readers.content import unreadable
from bidexdata.record.status import Status


def lies_inside(path: Path, folder: Path) -> bool:
    """Tell whether a path, its links followed, lies in a folder."""
    return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def leads_out(name: bytes) -> bool:
    """Tell whether a name goes up and out of the folder or archive of the file that has it."""
    return b".." in name.strip().replace(b"\\", b"/").split(b"/")


def file_inside(folder: Path, name: str, most: int) -> bytes:
    """Read a file by its name relative to a folder.

    Args:
        folder: Nothing outside it is read, whatever the name or a link says.
        name: Relative path.
        most: Largest size [bytes].

    Raises:
        PrepareFailure: It lies outside, does not exist, cannot be read or is too large.
    """
    path = folder / name
    if "\0" in name or not lies_inside(path, folder):
        raise unreadable(f"it names {name[:80]!r}, which is outside its folder and was not read")
    return regular_bytes(path, most)


def regular_bytes(path: Path, most: int) -> bytes:
    """Read a file that is a file: no device or pipe, which may never end.

    Raises:
        PrepareFailure: It does not exist, cannot be read or is too large.
    """
    try:
        if not path.exists():
            raise unreadable(f"{path.name}: no such file")
        if not path.is_file():
            raise unreadable(f"{path.name}: not a regular file")
        size = path.stat().st_size
        if size > most:
            raise PrepareFailure(
                Status.TOO_COMPLEX, f"{path.name} has {size} bytes; load.max_bytes is {most}"
            )
        return path.read_bytes()
    except OSError as err:
        reason = err.strerror or type(err).__name__
        raise unreadable(f"{path.name}: {reason}") from err
