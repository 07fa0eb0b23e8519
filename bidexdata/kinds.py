"""What a folder is: a library, a run or a release, told by the file at its top.

Every command and every reader that takes one of them asks here.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from bidexdata.errors import PathNotFound

Kind = Literal["library", "run", "release", "nothing"]

INDEX = "index.parquet"
RUN_FILE = "run.json"
MANIFEST = "manifest.json"
OBJECTS = "objects"
"""Folder of the objects, in a library and in a release."""
REPORT = "report.html"
"""The page about a library, which is no part of it."""
PARTS = ".parts"
"""What machines that prepare one library leave for each other; gone when it is finished."""

_TOP_FILES: dict[Kind, str] = {"library": INDEX, "run": RUN_FILE, "release": MANIFEST}
_MADE_BY: dict[Kind, str] = {"library": "prepare", "run": "synth", "release": "pack"}


class WrongKind(PathNotFound):
    """There is something else at a path than the caller needs."""

    def __init__(self, path: str | Path, kind: Kind, wanted: Sequence[Kind]):
        super().__init__(path, _named(wanted))
        self.kind, self.wanted = kind, tuple(wanted)
        if kind != "nothing":
            message = f"{path} is a {kind}; this needs {_named(wanted)}"
        elif len(wanted) == 1:
            one = wanted[0]
            maker = f"`bidexdata {_MADE_BY[one]}` makes one"
            message = f"{path} is no {one} ({_TOP_FILES[one]} is missing); {maker}"
        else:
            *first, last = (f"a {kind} ({_TOP_FILES[kind]})" for kind in wanted)
            message = f"{path} is neither {', '.join(first)} nor {last}"
        self.args = (message,)


def kind_of(path: str | Path) -> Kind:
    """Say what is at `path`; a library that `prepare` has not finished is one too."""
    path = Path(path)
    for kind in ("release", "run", "library"):
        if (path / _TOP_FILES[kind]).is_file():
            return kind
    # Without its index a library is objects alone; a broken release has more beside them.
    if (path / OBJECTS).is_dir() or (path / PARTS).is_dir():
        own = (OBJECTS, REPORT)
        others = [p for p in path.iterdir() if p.name not in own and not p.name.startswith(".")]
        return "nothing" if others else "library"
    return "nothing"


def expect_kind(path: str | Path, *wanted: Kind) -> Kind:
    """Say which of the wanted kinds is at `path`.

    Raises:
        PathNotFound: Nothing is there.
        WrongKind: It is none of them.
    """
    if not Path(path).exists():
        raise PathNotFound(path, _named(wanted))
    kind = kind_of(path)
    if kind not in wanted:
        raise WrongKind(path, kind, wanted)
    return kind


def _named(wanted: Sequence[Kind]) -> str:
    if len(wanted) == 1:
        return f"a {wanted[0]} (made by `bidexdata {_MADE_BY[wanted[0]]}`)"
    return f"{', '.join(f'a {kind}' for kind in wanted[:-1])} or a {wanted[-1]}"
