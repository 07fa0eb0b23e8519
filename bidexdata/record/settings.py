"""Settings of a protocol as plain data: what verdicts of one test depend on, and whose are equal.

How arms are driven (the key `arm`) changes nothing in tests of floating hands. So their marks leave it
out, and runs and releases from before there were arms agree with those of today.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bidexdata.config import differing_keys
from bidexdata.errors import NotUsable
from bidexdata.record.fields import WITH_ARMS

_ARM, _TESTS = "arm", "tests"


def settings_of_test(settings: Mapping[str, Any], test: str) -> dict[str, Any]:
    """Give the part of a protocol's settings that verdicts of one test depend on."""
    if test in WITH_ARMS:
        return dict(settings)
    return {
        key: [t for t in value if t not in WITH_ARMS] if key == _TESTS else value
        for key, value in settings.items()
        if key != _ARM
    }


def differing_settings(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """Name the keys in which two protocols of one name contradict each other.

    One that has no test with arms says nothing of them, and agrees with any.
    """
    if _ARM in one and _ARM in other:
        return differing_keys(one, other)
    return differing_keys(settings_of_test(one, ""), settings_of_test(other, ""))


def fuller_settings(one: Mapping[str, Any], other: Mapping[str, Any]) -> Mapping[str, Any]:
    """Of two that agree give the one that says how arms are driven; the first where both do."""
    return other if _ARM in other and _ARM not in one else one


def shared_settings(
    sources: Iterable[tuple[Path, Mapping[str, Mapping[str, Any]]]], remedy: str
) -> dict[str, Mapping[str, Any]]:
    """Give the settings of the protocols of several runs or releases; one name, one protocol.

    Args:
        sources: Where each lies, for messages, and its protocols' settings by name.
        remedy: What to do where two differ, the end of a sentence.

    Returns:
        The fuller settings of every name, sorted by it.

    Raises:
        NotUsable: Two have different settings under one name.
    """
    found: dict[str, tuple[Path, Mapping[str, Any]]] = {}
    for path, protocols in sources:
        for name, settings in protocols.items():
            first, known = found.setdefault(name, (path, settings))
            differing = differing_settings(known, settings)
            if differing:
                raise NotUsable(
                    f"{path} and {first} have verdicts of different protocols called {name!r} "
                    f"({differing[0]}); {remedy}"
                )
            found[name] = (first, fuller_settings(known, settings))
    return {name: settings for name, (_, settings) in sorted(found.items())}
