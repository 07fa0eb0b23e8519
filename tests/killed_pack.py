"""Children that write a release and say when they reach a phase, so that a test can kill them there.

Phases are told by what the operating system is asked for, not by names inside the package:
`writing` (the first file is opened), `hashing` (a hand's MJCF is read again), `renaming` (just
before the folder gets its name).
"""

from __future__ import annotations

import os
import sys
from multiprocessing.connection import Connection
from pathlib import Path

from made_release import OBJECTS, made_release

PRELOADED = (
    *("numpy.random", "pyarrow.compute", "pyarrow.parquet", "pandas", "h5py", "mujoco", "yaml"),
    *("bidexdata.formats.writer", "bidexdata.formats.hdf5", "bidexdata.formats.clouds"),
    *("bidexdata.hands", "bidexdata.objects.prepared", "bidexdata.objects.storage"),
)
"""What the server that the children come from imports: each would spend seconds on it. This file is
not among them, for the server does not look into the folder of the tests."""
PHASES = ("writing", "hashing", "renaming")


def write_made(objects: int, out: str, told: Connection) -> None:
    """Write the release of the first made objects."""
    _tell(out, told)
    made_release(Path(out), OBJECTS[:objects])
    told.send("done")


def pack_run(run: str, out: str, told: Connection) -> None:
    """Pack a run."""
    from bidexdata.runs.pack import pack_runs

    _tell(out, told)
    pack_runs([run], out, name="tiny", version="1.0.0", quiet=True)
    told.send("done")


def _tell(out: str, told: Connection) -> None:
    left = list(PHASES)

    def reached(phase: str) -> None:
        if phase in left:
            left.remove(phase)
            told.send(phase)

    def hook(event: str, arguments: tuple) -> None:
        if event == "os.rename" and os.fspath(arguments[1]) == out:
            reached("renaming")
        elif event == "open" and isinstance(arguments[0], str | os.PathLike):
            path, mode = os.fspath(arguments[0]), arguments[1] or ""
            if "partial" in str(path):
                hashed = str(path).endswith("hand.xml") and mode == "r"
                reached("hashing" if hashed else "writing")

    sys.addaudithook(hook)
