"""Settings of a protocol as plain data: what verdicts of one test depend on, and whose are equal.

How arms are driven (the key `arm`) changes nothing in tests of floating hands. So their marks leave it
out, and runs and releases from before there were arms agree with those of today.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bidexdata.config import differing_keys
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
