"""Methods of synthesis in runs: an identity of their own, and the same rows and commands."""

import dataclasses

import numpy as np
import pytest

from bidexdata.cli.main import run as cli
from bidexdata.config import fingerprint, from_plain, to_plain, with_overrides
from bidexdata.errors import BadConfig, ConfigConflict, UnknownName
from bidexdata.runs.info import describe_run
from bidexdata.runs.run import Run
from bidexdata.runs.spec import RunSpec, grown
from bidexdata.runs.synth import SynthRequest
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.method_names import DEFAULT_METHOD, METHODS
from bidexdata.synthesis.methods import load_method, method_of


@pytest.mark.parametrize("name", METHODS)
def test_a_method_is_named_by_its_configuration_which_survives_plain_data(name):
    method = load_method(name)
    config = method.config()
    assert method.name == name
    assert method_of(config) is method
    assert from_plain(method.config, to_plain(config)) == config
    assert config.steps > 0


def test_an_unknown_method_is_named_with_the_known_ones():
    with pytest.raises(UnknownName, match="bimangrasp"):
        load_method("bimangrsp")


def test_runs_of_different_methods_differ_and_the_default_is_what_it_was():
    base = RunSpec(config=to_plain(SynthConfig()), sizes_mm=(300,))
    assert dataclasses.replace(base, method=DEFAULT_METHOD).fingerprint == base.fingerprint
    prints = {
        dataclasses.replace(
            base, method=name, config=to_plain(load_method(name).config())
        ).fingerprint
        for name in METHODS
    }
    assert len(prints) == len(METHODS)
    assert "method" not in base.identity()


def test_a_run_does_not_go_on_by_another_method(tmp_path):
    old = RunSpec(config=to_plain(SynthConfig()))
    with pytest.raises(ConfigConflict, match=r"method: 'bidexgrasp' -> 'bodex'"):
        grown(tmp_path, old, dataclasses.replace(old, method="bodex", config={}))


def test_what_a_method_does_not_have_is_refused_in_a_sentence():
    bimangrasp = load_method("bimangrasp").config()
    with pytest.raises(BadConfig, match="knows no table"):
        SynthRequest(config=bimangrasp, method="bimangrasp", setting="tabletop")
    with pytest.raises(BadConfig, match="--preset paper belongs to"):
        SynthRequest(config=bimangrasp, method="bimangrasp", preset="paper")


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    out = tmp_path_factory.mktemp("methods") / "LIB"
    assert cli(["prepare", "shapes:box", "--out", str(out), "--limit", "1", "--quiet"]) == 0
    return out


@pytest.mark.parametrize(
    ("name", "short"),
    [
        ("bodex", ("schedule.steps=50",)),
        ("bimangrasp", ("annealing.steps=20", "energy.object_points=200")),
    ],
)
def test_a_peers_run_resumes_and_later_commands_take_it(library, tmp_path, capsys, name, short):
    run = tmp_path / name
    changes = [word for key in short for word in ("--set", key)]
    made = ["synth", str(library), "--out", str(run), "--hand", "capsule", "--sizes", "0.3"]
    made += ["--grasps", "1", "--executor", "inline", "--method", name, *changes, "--quiet"]
    assert cli(made) == 0
    opened = Run.open(run)
    assert opened.spec.method == name
    (before,) = opened.batches()
    assert cli(made) == 0  # nothing is left to do
    (after,) = Run.open(run).batches()
    for column in before.columns:
        np.testing.assert_array_equal(before[column], after[column])
    assert cli(["validate", str(run), "--executor", "inline", "--quiet"]) in {0, 6}
    described = describe_run(Run.open(run))
    assert described["method"] == name
    assert described["figures"]["audit_rows"] == 1
    config = with_overrides(load_method(name).config(), list(short))
    assert fingerprint(opened.spec.config) == fingerprint(config)
    out = tmp_path / "release"
    packed = ["pack", str(run), "--out", str(out), "--name", "n", "--version", "1.0.0", "--quiet"]
    assert cli(packed) == 0
    assert cli(["verify", str(out), "--quiet"]) == 0
