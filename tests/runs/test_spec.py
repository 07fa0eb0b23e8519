"""run.json: reads back, finds edits, lets only the number of grasps grow."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from bidexdata.errors import ConfigConflict, Contradiction, PathNotFound
from bidexdata.record import HandHeader
from bidexdata.record.batch import SCHEMA_VERSION
from bidexdata.runs.plan import Round
from bidexdata.runs.spec import RunSpec, grown, read_spec, write_spec

HANDS = tuple(
    HandHeader("capsule", side, "f" * 64, ("j0", "j1"), ("c0",), "palm")
    for side in ("left", "right")
)
SPEC = RunSpec(
    config={"optimise": {"steps": 200}, "regions": {"anchors": 100}},
    hand="capsule",
    hands=HANDS,
    sizes_mm=(300, 500),
    source="../library",
    source_fingerprint="0123456789abcdef",
    rounds=(Round(10, 40),),
)
CHANGES = {
    "seed": {"seed": 1},
    "sizes_mm": {"sizes_mm": (300,)},
    "setting": {"setting": "tabletop"},
    "config.optimise.steps": {"config": {**SPEC.config, "optimise": {"steps": 100}}},
    "library.fingerprint": {"source_fingerprint": "f" * 16},
    "hands.left.spec_hash": {"hands": (dataclasses.replace(HANDS[0], spec_hash="0"), HANDS[1])},
}


def test_a_spec_reads_back_as_written(tmp_path: Path):
    write_spec(tmp_path, SPEC)
    assert read_spec(tmp_path) == SPEC


def test_keys_of_a_newer_minor_version_are_ignored(tmp_path: Path):
    write_spec(tmp_path, SPEC)
    data = json.loads((tmp_path / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps({**data, "schema_version": "1.9", "moon": 1}))
    assert read_spec(tmp_path).fingerprint == SPEC.fingerprint


@pytest.mark.parametrize(
    "edit",
    [
        lambda text: text[:-20],
        lambda text: text.replace('"seed": 0', '"seed": 1'),
        lambda text: text.replace('"seed": 0', '"seed": "x"'),
        lambda text: text.replace(
            f'"schema_version": "{SCHEMA_VERSION}"', '"schema_version": "2.0"'
        ),
        lambda text: "[]",
    ],
)
def test_an_edited_or_newer_file_is_a_contradiction(tmp_path: Path, edit):
    write_spec(tmp_path, SPEC)
    path = tmp_path / "run.json"
    path.write_text(edit(path.read_text()))
    with pytest.raises(Contradiction, match=r"run\.json"):
        read_spec(tmp_path)


def test_another_preset_is_named_by_its_name(tmp_path: Path):
    other = dataclasses.replace(SPEC, preset="paper", config={"optimise": {"steps": 1}}, seed=3)
    with pytest.raises(ConfigConflict) as err:
        grown(tmp_path, dataclasses.replace(SPEC, preset="default"), other)
    assert "preset: 'default' -> 'paper'" in str(err.value)
    assert "seed: 0 -> 3" in str(err.value)
    assert "optimise" not in str(err.value)


def test_a_folder_without_it_is_no_run(tmp_path: Path):
    with pytest.raises(PathNotFound, match="bidexdata synth"):
        read_spec(tmp_path)


def test_moving_run_and_library_together_changes_no_fingerprint():
    assert dataclasses.replace(SPEC, source="elsewhere").fingerprint == SPEC.fingerprint
    assert dataclasses.replace(SPEC, rounds=(Round(20, 80),)).fingerprint == SPEC.fingerprint


@pytest.mark.parametrize("key", CHANGES)
def test_any_other_configuration_is_refused_and_named(tmp_path: Path, key: str):
    wanted = dataclasses.replace(SPEC, **CHANGES[key])
    assert wanted.fingerprint != SPEC.fingerprint
    with pytest.raises(ConfigConflict) as caught:
        grown(tmp_path, SPEC, wanted)
    (named,) = caught.value.differing
    assert named.startswith(f"{key}: ")
    assert caught.value.exit_code == 5


def test_another_hand_is_named_first_and_hashes_are_short(tmp_path: Path):
    hands = tuple(dataclasses.replace(h, name="shadow", spec_hash="e" * 64) for h in HANDS)
    with pytest.raises(ConfigConflict) as caught:
        grown(tmp_path, SPEC, dataclasses.replace(SPEC, hands=hands, config={}))
    first = [f"hands.{side}.name: 'capsule' -> 'shadow'" for side in ("left", "right")]
    assert list(caught.value.differing[:2]) == first
    assert f"hands.left.spec_hash: '{'f' * 12}…' -> '{'e' * 12}…'" in caught.value.differing
    assert "f" * 13 not in str(caught.value)


def test_the_same_request_changes_nothing(tmp_path: Path):
    assert grown(tmp_path, SPEC, SPEC) is SPEC


def test_more_grasps_add_a_round_that_starts_after_the_last_attempt(tmp_path: Path):
    once = grown(tmp_path, SPEC, dataclasses.replace(SPEC, rounds=(Round(15, 60),)))
    assert once.rounds == (Round(10, 40), Round(5, 20, 40))
    twice = grown(tmp_path, once, dataclasses.replace(SPEC, rounds=(Round(16, 70),)))
    assert twice.rounds == (*once.rounds, Round(1, 10, 60))
    assert (twice.grasps, twice.candidates) == (16, 70)


@pytest.mark.parametrize("rounds", [Round(9, 40), Round(10, 41), Round(10, 39), Round(20, 45)])
def test_fewer_grasps_or_other_attempts_are_refused(tmp_path: Path, rounds: Round):
    with pytest.raises(ConfigConflict, match=r"grasps|candidates"):
        grown(tmp_path, SPEC, dataclasses.replace(SPEC, rounds=(rounds,)))
