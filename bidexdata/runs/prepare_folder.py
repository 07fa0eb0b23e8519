"""The folder of a library that `prepare` writes, and which configuration it was made with."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from bidexdata import __version__
from bidexdata.config import differing_keys, to_plain
from bidexdata.errors import ConfigConflict, Contradiction, NotUsable
from bidexdata.kinds import INDEX, OBJECTS, REPORT, kind_of
from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.storage import read_document

LOGS = ".logs"
"""Folder of the tracebacks of what went wrong in this package; no part of the library."""


def check_out(out: Path, config: PrepareConfig) -> None:
    """Refuse a folder that holds something else or was made with another configuration."""
    if not out.exists():
        return
    if not out.is_dir():
        raise NotUsable(f"{out} is a file; --out needs a folder")
    own = {INDEX, OBJECTS, REPORT}
    foreign = [p.name for p in out.iterdir() if p.name not in own and not p.name.startswith(".")]
    if foreign:
        # A release has `objects` too, and must not be written to.
        kind = kind_of(out)
        what = f"holds {sorted(foreign)[0]}" if kind in ("nothing", "library") else f"is a {kind}"
        raise NotUsable(f"{out} {what} and is no folder for a library; choose another --out")
    before, now = _made_with(out), prepare_identity(config)
    if before is not None and before != now:
        raise ConfigConflict(out, differing_keys(before, now))


def _made_with(out: Path) -> Any:
    """The configuration that made a library, by one of its objects; None where none can be read."""
    for path in (out / OBJECTS).glob("[!.]*/[!.]*/object.json"):
        with contextlib.suppress(Contradiction):  # a cut one is made again
            return read_document(path.parent).get("config")
    return None


def prepare_identity(config: PrepareConfig) -> dict[str, Any]:
    """The configuration that decides bytes: limits and selection decide whether there are any."""
    plain = to_plain(config)
    del plain["limits"], plain["select"]
    return plain


def prepare_asked(config: PrepareConfig) -> dict[str, Any]:
    """What decides which inputs give no object: a failure is final until one of these changes."""
    return {**to_plain(config), "bidexdata": __version__}
