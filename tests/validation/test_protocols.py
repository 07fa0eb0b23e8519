from __future__ import annotations

import math
from dataclasses import replace

import pytest

from bidexdata.config import fingerprint, from_plain, to_plain, with_overrides
from bidexdata.errors import BadConfig, UnknownName
from bidexdata.record.fields import JUDGED, ON_TABLE, TESTS
from bidexdata.validation import Protocol, load_protocol, protocol_names
from bidexdata.validation.protocols import LiftRules
from bidexdata.validation.validate import TESTS as FUNCTIONS


def test_paper_1_is_what_the_design_states():
    p = load_protocol("paper-1")
    assert p.closing_time == pytest.approx(0.8)
    assert (p.segment_changes, p.segment_steps, p.scene.timestep) == (10, 10, 0.004)
    assert (p.steps_per_check, p.checks) == (25, 30)
    assert (p.gravity, p.hold, p.limit_pos) == (9.8, 3.0, 0.05)
    assert math.degrees(p.limit_rot) == pytest.approx(15)
    assert p.start_depth == 0.01
    assert p.scene.density == 2.5
    assert (p.scene.friction_slide, p.scene.friction_spin, p.scene.condim) == (0.6, 0.02, 4)


def test_there_is_code_for_the_tests_that_can_be_run_and_no_others():
    assert tuple(FUNCTIONS) == JUDGED
    assert set(ON_TABLE) < set(JUDGED) < set(TESTS)


def test_every_protocol_has_a_sentence_and_survives_plain_data():
    for name in protocol_names():
        protocol = load_protocol(name)
        assert protocol.name == name
        assert len(protocol.description) > 20
        again = from_plain(Protocol, to_plain(protocol))
        assert again == protocol
        assert fingerprint(again) == fingerprint(protocol)


def test_any_changed_setting_changes_the_fingerprint():
    p = load_protocol("paper-1")
    for other in (replace(p, hold=2.0), replace(p, scene=replace(p.scene, condim=3))):
        assert fingerprint(other) != fingerprint(p)


def test_an_unknown_protocol_names_the_known_ones():
    with pytest.raises(UnknownName, match=r"no protocol is called 'paper1'.*paper-1"):
        load_protocol("paper1")


@pytest.mark.parametrize(
    "change",
    [
        {"hold": 0.0},
        {"limit_rot": 4.0},
        {"check_every": 1e-4},
        {"check_every": 0.07},
        {"segment_steps": 0},
        {"gravity": -9.8},
        {"gravity": math.nan},
        {"start_depth": -0.01},
        {"unstable_speed": 0.0},
        {"load_after": 0.0},
        {"directions": ("+x", "+x")},
        {"lift": LiftRules(hold=0.04)},
    ],
)
def test_impossible_protocols_are_refused(change):
    with pytest.raises(BadConfig, match=next(iter(change))):
        replace(load_protocol("paper-1"), **change)


def test_a_key_that_published_settings_leave_out_can_be_set():
    paper = load_protocol("paper-1")
    assert "load_after" not in to_plain(paper)
    late = with_overrides(paper, ["name=late-1", "load_after=0.2"])
    assert late.load_after == 0.2
    assert from_plain(Protocol, to_plain(late)) == late
