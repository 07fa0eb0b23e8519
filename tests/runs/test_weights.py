"""A run and a protocol each have a weight of the object; a person learns where they differ."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bidexdata.config import to_plain, with_overrides
from bidexdata.runs.info import changed_keys
from bidexdata.runs.spec import RunSpec
from bidexdata.runs.weights import fitting_protocol, weight_difference
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.presets import load_preset
from bidexdata.validation import load_protocol


def spec(*assignments: str, preset: str = "default") -> RunSpec:
    config = with_overrides(load_preset(preset), assignments)
    return replace(RunSpec(), preset=preset, config=to_plain(config))


@pytest.mark.parametrize(
    ("assignments", "protocol"),
    [
        ((), "paper-1"),
        (("staging.density=25",), "paper-1-density25"),
        (("staging.density=250",), "paper-1-density250"),
        (("staging.mass=0.5",), "paper-1-mass500g"),
        (("staging.mass=0.7",), "paper-1"),
    ],
)
def test_the_protocol_that_fits_gives_the_object_the_weight_of_the_squeeze(assignments, protocol):
    run = spec(*assignments)
    assert fitting_protocol(run) == protocol
    agrees = assignments != ("staging.mass=0.7",)
    assert (weight_difference(run, load_protocol(protocol)) == "") is agrees


def test_the_difference_names_both_weights_and_the_remedy():
    said = weight_difference(spec(), load_protocol("paper-1-mass500g"))
    assert "2.5 kg/m^3" in said
    assert "0.5 kg;" in said
    assert "--set staging.mass=0.5" in said
    followed = spec("staging.mass=0.5")
    assert weight_difference(followed, load_protocol("paper-1-mass500g")) == ""


def test_a_run_that_does_not_say_its_weight_is_not_compared():
    assert weight_difference(RunSpec(), load_protocol("paper-1-mass500g")) == ""
    assert fitting_protocol(RunSpec()) == "paper-1"


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_info_names_what_was_set_and_nothing_else(preset):
    assert changed_keys(spec(preset=preset)) == []
    said = changed_keys(spec("staging.mass=0.5", "regions.kept=20", preset=preset))
    assert said == ["regions.kept=20", "staging.mass=0.5"]
    assert with_overrides(load_preset(preset), said) != SynthConfig()
