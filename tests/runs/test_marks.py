"""What shards carry may not change with the package: a run of yesterday goes on today.

The hex digits are those that the functions gave before the record knew of arms; a change of one
refuses every run that was made before.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from bidexdata.record import HandHeader, Header
from bidexdata.runs.plan import Round
from bidexdata.runs.run import Run, verdict_fingerprint
from bidexdata.runs.spec import RunSpec
from bidexdata.validation.protocols import load_protocol

HANDS = (
    HandHeader("made", "left", "0a" * 32, ("j0", "j1"), ("c0",), "palm"),
    HandHeader("made", "right", "0b" * 32, ("j0", "j1"), ("c0",), "palm"),
)
SPEC = RunSpec(
    preset="default",
    config={"steps": 200},
    hand="made",
    hands=HANDS,
    sizes_mm=(300, 500),
    source="../library",
    source_fingerprint="0123456789abcdef",
    seed=7,
    rounds=(Round(5, 20),),
)
TABLETOP = replace(SPEC, setting="tabletop", rest_poses=2)


@pytest.mark.parametrize(
    ("spec", "mark"),
    [(SPEC, "4f02771ef4506893"), (TABLETOP, "b86757d57852944d")],
    ids=["floating", "tabletop"],
)
def test_the_fingerprint_of_a_run_without_a_rig_is_what_it_was(spec, mark):
    assert spec.fingerprint == mark


@pytest.mark.parametrize(
    ("protocol", "test", "mark"),
    [
        ("paper-1", "f", "78299d9ca9fc85af"),
        ("paper-1", "l", "f35cb035c3559708"),
        ("dexgraspbench-1", "f", "27d41d9e61f1f9b7"),
        ("bimandexgraspbench-1", "f", "b13451612cd8b66c"),
    ],
)
def test_the_marks_of_verdicts_are_what_they_were(protocol, test, mark):
    run = Run(Path("run"), TABLETOP)
    assert verdict_fingerprint(run, load_protocol(protocol), test) == mark


def test_a_header_without_arms_is_written_as_it_was():
    header = replace(Header(HANDS, {"synth": "1"}, "0.1.0", {"s": {"ok": 2}}), schema_version="1.3")
    assert header.to_json() == HEADER_JSON


HEADER_JSON = '{"counts":{"s":{"ok":2}},"fingerprints":{"synth":"1"},"hands":[{"contact_names":["c0"],"joint_names":["j0","j1"],"name":"made","root_body":"palm","side":"left","spec_hash":"0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a0a"},{"contact_names":["c0"],"joint_names":["j0","j1"],"name":"made","root_body":"palm","side":"right","spec_hash":"0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b"}],"schema_version":"1.3","version":"0.1.0"}'
