from __future__ import annotations

import math
from dataclasses import replace

import pytest

from bidexdata.config import fingerprint, from_plain, to_plain, with_overrides
from bidexdata.errors import BadConfig, UnknownName
from bidexdata.record.fields import JUDGED, ON_TABLE, TESTS, WITH_ARMS
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
    assert set(WITH_ARMS) < set(ON_TABLE) < set(JUDGED) <= set(TESTS)


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
        {"load_after": 0.001},
        {"load_after": 0.202},
        {"hold": 0.25},
        {"hold": 3.04},
        {"lift": LiftRules(hold=0.04)},
        {"lift": LiftRules(hold=0.15)},
    ],
)
def test_impossible_protocols_are_refused(change):
    with pytest.raises(BadConfig, match=next(iter(change))):
        replace(load_protocol("paper-1"), **change)


def written(path, base, name):
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"base: {base}\nname: {name}\ndescription: of a test\nhold: 1.0\n")
    return path


def test_a_base_is_found_beside_the_file_that_names_it(tmp_path, monkeypatch):
    written(tmp_path / "mine" / "first.yaml", "paper-1-mass500g", "first-1")
    second = written(tmp_path / "mine" / "second.yaml", "first.yaml", "second-1")
    for folder in (tmp_path, tmp_path / "mine"):
        monkeypatch.chdir(folder)
        found = load_protocol(second)
        assert (found.name, found.hold, found.scene.mass) == ("second-1", 1.0, 0.5)


@pytest.mark.parametrize(
    ("base", "says"),
    [
        ("paper-l", "no protocol is called 'paper-l' (did you mean 'paper-1'?)"),
        ("paper-1-warp", "use --protocol paper-1"),
        ("nowhere.yaml", "no such file"),
    ],
)
def test_a_base_that_is_not_there_is_named_with_the_file_that_asks_for_it(tmp_path, base, says):
    first = written(tmp_path / "mine" / "first.yaml", base, "first-1")
    second = written(tmp_path / "mine" / "second.yaml", "first.yaml", "second-1")
    for path in (first, second):
        with pytest.raises(BadConfig) as caught:
            load_protocol(path)
        assert str(caught.value).startswith(f"{first}: base: ")
        assert says in str(caught.value)


@pytest.mark.parametrize("bases", [["a.yaml"], ["b.yaml", "a.yaml"], ["b.yaml", "../x/b.yaml"]])
def test_a_file_that_leads_back_to_itself_is_refused(tmp_path, bases):
    names = ("a", "b")
    for name, base in zip(names, bases, strict=False):
        written(tmp_path / "x" / f"{name}.yaml", base, f"{name}-1")
    with pytest.raises(BadConfig, match=r"cannot be its own base \((a|b)\.yaml -> .*\)$"):
        load_protocol(tmp_path / "x" / "a.yaml")


def test_a_key_that_published_settings_leave_out_can_be_set():
    paper = load_protocol("paper-1")
    assert "load_after" not in to_plain(paper)
    late = with_overrides(paper, ["name=late-1", "load_after=0.2"])
    assert late.load_after == 0.2
    assert from_plain(Protocol, to_plain(late)) == late
