"""Chosen: whose verdicts a command means where a run or release has those of several protocols."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from bidexdata.errors import NotUsable, UnknownName

DEFAULT_PROTOCOL = "paper-1"


def chosen_protocol(
    path: str | Path,
    tests: Iterable[tuple[str, str]],
    asked: str | None = None,
    *,
    default: str = DEFAULT_PROTOCOL,
) -> str:
    """The protocol asked for; else the default, or the only one; empty where nothing is tested.

    Args:
        path: What has the verdicts, for messages.
        tests: The (protocol, test) pairs that it has.
        asked: A name.
        default: What is meant when none is asked for; a release has its own.

    Raises:
        UnknownName: There are no verdicts of this protocol.
        NotUsable: There is no saying which protocol is meant.
    """
    known = sorted({protocol for protocol, _ in tests})
    if asked is not None:
        if asked not in known:
            raise UnknownName("protocol with verdicts here", asked, known)
        return asked
    if default in known or not known:
        return default if known else ""
    if len(known) > 1:
        raise NotUsable(
            f"{path} has verdicts of several protocols; say which with --protocol: "
            f"{', '.join(known)}"
        )
    return known[0]
