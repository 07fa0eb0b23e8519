"""Chosen: whose verdicts a command means where a run or release has those of several protocols."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.errors import NotUsable, UnknownName
from bidexdata.record.fields import TESTS

if TYPE_CHECKING:
    from bidexdata.runs.run import Run

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


def tests_of_protocol(protocol: str, tests: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """The tests that a protocol has verdicts of, in the order of `TESTS`."""
    found = set(tests)
    return tuple(test for test in TESTS if (protocol, test) in found)


def rig_option(run: Run) -> tuple[str, ...]:
    """`--rig NAME` where the next command must say it to mean the run's rig; else nothing."""
    from bidexdata.runs.arm_folder import chosen_rig

    try:
        unsaid = chosen_rig(run.path, run.spec.rig.name if run.spec.rig else "")
    except NotUsable:  # several, and none of them is the one
        unsaid = ""
    asked = run.asked_rig or unsaid
    return () if asked == unsaid else ("--rig", asked)


def other_rigs(run: Run) -> tuple[str, ...]:
    """Rigs that a run has arm solutions of, besides the one that is meant."""
    return tuple(name for name in run.arm_rigs() if name != run.rig)


def refuse_other_rig(path: str | Path, own: str, asked: str | Path | None) -> None:
    """Refuse to go on with a rig that a library or release has no arm solutions of.

    Args:
        path: What is looked into, for messages.
        own: Name of the rig that it has solutions of; empty for none.
        asked: A name, or the path of a spec; None asks for none.

    Raises:
        UnknownName: It is another.
    """
    from bidexdata.runs.arm_folder import rig_name

    if asked is not None and rig_name(asked) != own:
        raise UnknownName(
            f"rig with arm solutions in {path}", rig_name(asked), [own] if own else []
        )


def check_protocol(tests: Iterable[tuple[str, str]], asked: str | None) -> None:
    """Refuse to go on with a protocol that there are no verdicts of; None asks for none.

    Raises:
        UnknownName: It is not among those of `tests`.
    """
    known = sorted({protocol for protocol, _ in tests})
    if asked is not None and asked not in known:
        raise UnknownName("protocol with verdicts here", asked, known)
