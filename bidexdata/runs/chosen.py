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
    tests = tuple(tests)
    check_protocol(tests, asked)
    known = sorted({protocol for protocol, _ in tests})
    if asked is not None:
        return asked
    if default in known or not known:
        return default if known else ""
    if len(known) > 1:
        raise NotUsable(
            f"{path} has verdicts of several protocols; say which with --protocol: "
            f"{', '.join(known)}"
        )
    return known[0]


def check_protocol(tests: Iterable[tuple[str, str]], asked: str | None) -> None:
    """Refuse to go on with a protocol that there are no verdicts of; None asks for none.

    Raises:
        UnknownName: It is not among those of `tests`.
    """
    known = sorted({protocol for protocol, _ in tests})
    if asked is not None and asked not in known:
        raise UnknownName("protocol with verdicts here", asked, known)
