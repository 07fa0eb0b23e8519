"""Files beside a mesh file: read only where they lie in its folder, links followed."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from bidexdata.objects.failure import PrepareFailure
from bidexdata.record.status import Status

from .content import unreadable

_BLOCK = 1 << 20
"""Bytes read at once where a file is not needed whole."""


def lies_inside(path: Path, folder: Path) -> bool:
    """Tell whether a path, its links followed, lies in a folder."""
    return real_path(path).is_relative_to(real_path(folder))


def real_path(path: Path) -> Path:
    """The path with its links followed, as far as that goes: not where they form a loop."""
    try:
        return Path(os.path.realpath(path))
    except (OSError, ValueError):  # a NUL in its name
        return Path(os.path.abspath(path))


def beside(folder: Path, name: str) -> Path:
    """The path of a file by its name relative to a folder.

    Args:
        folder: Nothing outside it is named, whatever the name or a link says.
        name: Relative path.

    Raises:
        PrepareFailure: It lies outside.
    """
    path = folder / name
    if "\0" in name or not lies_inside(path, folder):
        raise unreadable(f"it names {name[:80]!r}, which is outside its folder and was not read")
    return path


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
    return regular_bytes(beside(folder, name), most)


def regular_bytes(path: Path, most: int) -> bytes:
    """Read a file that is a file: no device or pipe, which may never end.

    Raises:
        PrepareFailure: It does not exist, cannot be read or is too large.
    """
    return b"".join(regular_blocks(path, regular_size(path, most)))


def regular_size(path: Path, most: int) -> int:
    """Size of a file that is a file [bytes].

    Raises:
        PrepareFailure: It does not exist, cannot be looked at, is no file or is too large.
    """
    try:
        found = os.stat(path)
    except (FileNotFoundError, NotADirectoryError, ValueError) as err:  # ValueError: a NUL
        raise unreadable(f"{_short(path)}: no such file") from err
    except OSError as err:
        raise _unreadable(path, err) from err
    if not stat.S_ISREG(found.st_mode):
        raise unreadable(f"{_short(path)}: not a regular file")
    if found.st_size > most:
        raise PrepareFailure(
            Status.TOO_COMPLEX, f"{path.name} has {found.st_size} bytes; load.max_bytes is {most}"
        )
    return found.st_size


def regular_blocks(path: Path, size: int) -> Iterator[bytes]:
    """Read a file block by block.

    Args:
        path: Of the file.
        size: What `regular_size` said.

    Raises:
        PrepareFailure: It cannot be read, or has another size meanwhile.
    """
    left = size
    try:
        with path.open("rb") as stream:
            while block := stream.read(_BLOCK):
                left -= len(block)
                if left < 0:
                    break
                yield block
    except OSError as err:
        raise _unreadable(path, err) from err
    if left:
        raise unreadable(f"{_short(path)}: its size changed while it was read")


def _unreadable(path: Path, err: OSError) -> PrepareFailure:
    return unreadable(f"{_short(path)}: {err.strerror or type(err).__name__}")


def _short(path: Path) -> str:
    return path.name if len(path.name) <= 80 else f"{path.name[:80]}..."
