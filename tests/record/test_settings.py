"""Which settings of a protocol a test depends on, and when two protocols of a name agree."""

from __future__ import annotations

from pathlib import Path

import pytest

from bidexdata.config import to_plain
from bidexdata.errors import NotUsable
from bidexdata.record.settings import (
    differing_settings,
    fuller_settings,
    settings_of_test,
    shared_settings,
)
from bidexdata.validation import load_protocol
from bidexdata.validation.protocols import without_arms

FULL = to_plain(load_protocol("paper-1"))
OLD = to_plain(without_arms(load_protocol("paper-1")))


def test_tests_of_floating_hands_do_not_depend_on_arms():
    for test in ("f", "l"):
        assert settings_of_test(FULL, test) == OLD == settings_of_test(OLD, test)
    assert settings_of_test(FULL, "a") == FULL
    assert list(settings_of_test(FULL, "l")) == list(OLD)


def test_a_protocol_that_says_nothing_of_arms_agrees_with_one_that_does():
    assert differing_settings(OLD, FULL) == differing_settings(FULL, OLD) == []
    assert fuller_settings(OLD, FULL) is FULL
    assert fuller_settings(FULL, OLD) is FULL
    same = dict(FULL)
    assert fuller_settings(same, FULL) is same


def test_other_settings_are_named_by_their_keys():
    stiff = {**FULL, "arm": {**FULL["arm"], "arm_gain": 4.0}}
    assert differing_settings(FULL, stiff) == ["arm.arm_gain: 1.0 -> 4.0"]
    assert differing_settings(OLD, stiff) == []
    longer = {**OLD, "hold": 4.0}
    assert differing_settings(FULL, longer) == ["hold: 3.0 -> 4.0"]
    fewer = {**OLD, "tests": ["f"]}
    assert differing_settings(fewer, FULL) == ["tests: ['f'] -> ['f', 'l']"]


def test_several_sources_share_the_fuller_settings_of_every_name():
    sources = [(Path("one"), {"b": OLD}), (Path("two"), {"b": FULL, "a": OLD}), (Path("none"), {})]
    for order in (sources, sources[::-1]):
        shared = shared_settings(order, "stop")
        assert list(shared) == ["a", "b"]
        assert shared["b"] is FULL
    assert shared_settings([], "stop") == {}


def test_sources_that_mean_different_things_by_one_name_are_refused():
    sources = [(Path("one"), {"p": OLD}), (Path("two"), {"p": {**OLD, "hold": 4.0}})]
    said = (
        r"^two and one have verdicts of different protocols called 'p' \(hold: 3.0 -> 4.0\); stop$"
    )
    with pytest.raises(NotUsable, match=said):
        shared_settings(sources, "stop")
