"""What an adapter of a foreign format gives: files, the grasps of one file, an object."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import BidexError
from bidexdata.frames import quat_canonical
from bidexdata.objects.config import LoadConfig, PrepareConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.identity import named_id
from bidexdata.objects.prepared import PreparedObject
from bidexdata.objects.readers.inside import lies_inside, regular_blocks, regular_size
from bidexdata.record.scene import Setting

FloatArray = NDArray[np.float64]
_POSE_DIGITS = 4
"""Decimals of a quaternion below which two poses on a table are one scene."""
_MOST_BYTES = LoadConfig().max_bytes


class BadFile(BidexError):
    """One foreign file cannot be imported; the import counts it and goes on."""

    def __init__(self, reason: str):
        self.reason = reason
        super().__init__(reason)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForeignGrasps:
    """The N grasps of one file, hands in our conventions, world and object as in the file."""

    object_name: str
    """How the file names its object."""
    scale: FloatArray
    """Metres per unit of the object's own files, (N,)."""
    object_pos: FloatArray
    """Origin of the object's own frame in the file's world [m], (N, 3)."""
    object_quat_wxyz: FloatArray
    """Its orientation, unit, (N, 4)."""
    hand_pos: FloatArray
    """Origins of our hand frames in the file's world per stage [m], (N, H, S, 3). S is 3, or 1 of
    formats that have the grasp alone; the other stages are then made of it (stages.py)."""
    hand_quat_wxyz: FloatArray
    """Unit, (N, H, S, 4)."""
    joints: tuple[FloatArray, ...]
    """Per hand in the order of the format's `joint_names`, our signs [rad], (N, S, J)."""
    row: NDArray[np.int64]
    """Number of each grasp within the file, (N,)."""
    several: bool
    """Whether the file holds more than one grasp, so that a reference needs the number."""
    left_out: tuple[str, ...] = ()
    """Why other grasps of the file are not here, one sentence each."""

    def __len__(self) -> int:
        return len(self.row)


class Placed(NamedTuple):
    """Where an object stands in a file, which decides its scene."""

    scale: float
    """Metres per unit of the object's files."""
    quat_wxyz: tuple[float, ...]
    """Orientation, canonical, rounded to `_POSE_DIGITS`."""


def placed(grasps: ForeignGrasps) -> list[Placed]:
    """Where the object stands in each grasp."""
    quat = np.round(quat_canonical(grasps.object_quat_wxyz), _POSE_DIGITS) + 0.0
    pairs = zip(grasps.scale.tolist(), quat.tolist(), strict=True)
    return [Placed(scale, tuple(q)) for scale, q in pairs]


def files_below(root: Path, folder: str, ending: str) -> list[str]:
    """Files of an ending below a folder of `root`, hidden ones aside.

    Args:
        root: What the paths are relative to.
        folder: Where to look, `.` for all of it.
        ending: Of the names.

    Returns:
        Paths in byte order.
    """
    found = []
    for place, folders, names in os.walk(root / folder):
        folders[:] = sorted(n for n in folders if not n.startswith("."))
        found += [
            Path(place, name).relative_to(root).as_posix()
            for name in names
            if name.endswith(ending) and not name.startswith(".")
        ]
    return sorted(found, key=os.fsencode)


@dataclass(frozen=True, slots=True)
class ObjectSource:
    """Where the object of some grasps lies; make it with `of`."""

    name: str
    """The source's own name of the object."""
    folder: Path
    files: tuple[Path, ...]
    """All files that decide the object, in byte order."""
    sha256: str
    """Hash of their names and contents."""
    bytes: int
    about: Mapping[str, str] = field(default_factory=dict)
    """What is stated of its origin: source, licence, author, category."""

    @classmethod
    def of(
        cls,
        name: str,
        folder: Path,
        files: Sequence[Path],
        about: Mapping[str, str] | None = None,
        *,
        top: Path | None = None,
        most: int = _MOST_BYTES,
    ) -> ObjectSource:
        """Hash the files of an object, block by block.

        Args:
            name: The source's own name of the object.
            folder: Of the object.
            files: In it.
            about: What is stated of its origin.
            top: What the caller named: nothing outside of it is read, links followed. The folder
                when omitted.
            most: Largest size of the files together [bytes].

        Raises:
            BadFile: One of them cannot be read or lies outside, or they are too large.
        """
        digest, total = hashlib.sha256(), 0
        for file in files:
            if not lies_inside(file, top or folder):
                raise BadFile(
                    f"object {name}: {file.name} is a link to outside of {top or folder} and was not "
                    "read; --objects names a folder of objects elsewhere"
                )
            try:
                size = regular_size(file, most)
                total += size
                if total > most:
                    what = f"object {name}: its {len(files)} files have more than {most} bytes"
                    raise BadFile(f"{what} together, which are not read")
                digest.update(f"{file.relative_to(folder).as_posix()} {size}\n".encode())
                for block in regular_blocks(file, size):
                    digest.update(block)
            except PrepareFailure as failure:
                raise BadFile(f"object {name}: {failure.reason}") from failure
        return cls(name, folder, tuple(files), digest.hexdigest(), total, dict(about or {}))

    @property
    def object_id(self) -> str:
        """Identity of the object in our library."""
        return named_id(self.name, self.sha256)


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """An adapter of one foreign format."""

    name: str
    description: str
    sides: tuple[str, ...]
    """The hands in the order of the H axis."""
    joint_names: tuple[tuple[str, ...], ...]
    """Names of our hand's joints in the order of the files, per hand."""
    files: Callable[[Path], list[str]]
    """Grasp files below a folder, relative to it, in byte order."""
    expected: str
    """What the files are called and hold, for the error where none is found."""
    read: Callable[[bytes, str], ForeignGrasps]
    """(contents of a file, its path relative to the folder) -> its grasps; raises `BadFile`."""
    max_bytes: int
    """Files larger than this are refused unread."""
    find_object: Callable[[str, Path, Path | None], ObjectSource]
    """(name in the file, imported folder, folder of objects given by the caller) -> its object;
    raises `BadFile`."""
    load_object: Callable[[ObjectSource, PrepareConfig], PreparedObject]
    """Make the object; raises `PrepareFailure`."""
    protocol: str
    """The protocol to judge such grasps by: the other project's own where this package has it."""
    made_stages: bool = False
    """Whether the files have the grasp alone, so that pre-grasp and squeeze are made here."""
    settings: tuple[Setting, ...] = ("floating", "tabletop")
    """What its scenes can be: where the files have no pose of the object, only `floating`."""
    unknown: tuple[str, ...] = ()
    """What no file of the format says, one phrase each."""
