"""The list of keys: each once, with its value as `--set` reads it, and never without a meaning."""

from __future__ import annotations

import doctest
import json
import re
from pathlib import Path

import pytest

from bidexdata.cli import config_keys
from bidexdata.cli.main import COMMANDS, run
from bidexdata.config import to_plain, with_overrides
from bidexdata.objects.config import PrepareConfig
from bidexdata.synthesis.method_names import METHODS
from bidexdata.synthesis.presets import describe_preset, load_preset, preset_names
from bidexdata.validation.protocols import load_protocol, protocol_names

ROOT = Path(__file__).resolve().parents[2]
PROTOCOLS = {name: load_protocol(name) for name in protocol_names()}
CONFIGS = {
    "prepare": PrepareConfig(),
    **{name: load_preset(name) for name in preset_names()},
    **PROTOCOLS,
}


def lister(name: str) -> str:
    return "protocols" if name in PROTOCOLS else "presets"


def leaves(plain: dict, prefix: str = "") -> dict[str, object]:
    found = {}
    for name, value in plain.items():
        nested = isinstance(value, dict)
        found |= leaves(value, f"{prefix}{name}.") if nested else {f"{prefix}{name}": value}
    return found


def listed(name: str, capsys: pytest.CaptureFixture) -> dict:
    assert run([lister(name), name, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("name", CONFIGS)
def test_every_key_is_listed_once_with_its_value_and_a_meaning(name: str, capsys):
    data = listed(name, capsys)
    keys = [key for group in data["groups"] for key in group["keys"]]
    assert {k["key"]: k["value"] for k in keys} == leaves(to_plain(CONFIGS[name]))
    assert len(keys) == len({k["key"] for k in keys})
    assert all(k["meaning"] for k in keys)
    assert all(g["meaning"] for g in data["groups"])
    documented = set(re.findall(r"\w+", COMMANDS[lister(name)].__doc__ or ""))
    assert set(data) | set(data["groups"][0]) | set(keys[0]) <= documented


@pytest.mark.parametrize("name", CONFIGS)
def test_the_text_spells_keys_and_values_as_set_reads_them(name: str, capsys):
    assert run([lister(name), name]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = {line.split()[0]: line for line in lines if line.startswith("  ")}
    assert set(rows) == set(leaves(to_plain(CONFIGS[name])))
    for key, value in leaves(to_plain(CONFIGS[name])).items():
        spelled = json.dumps(value)
        assert rows[key].split(maxsplit=1)[1].startswith(f"{spelled} ")
        assert with_overrides(CONFIGS[name], [f"{key}={spelled}"]) == CONFIGS[name]


def test_units_and_sources_come_from_the_text_and_a_presets_reason_goes_first(capsys):
    for name in preset_names():
        keys = {k["key"]: k for g in listed(name, capsys)["groups"] for k in g["keys"]}
        assert keys["placement.standoff"]["unit"] == "m"
        assert keys["placement.standoff"]["source"] == "Measurements, 4"
        assert keys["optimise.grasp.steps"]["source"]  # of presets.PAPER_OPEN
        for change in describe_preset(name).changes:
            assert keys[change.key]["source"] == f"{name}: {change.reason}"


@pytest.mark.parametrize("name", [*preset_names(), *METHODS[1:]])
def test_every_key_of_a_method_says_where_its_value_is_from(name: str, capsys):
    keys = [k for g in listed(name, capsys)["groups"] for k in g["keys"]]
    assert keys
    assert not [k["key"] for k in keys if not k["source"]]


def test_a_value_that_a_method_sets_has_the_methods_source(capsys):
    keys = {k["key"]: k for g in listed("bodex", capsys)["groups"] for k in g["keys"]}
    assert keys["qp.mu"]["source"].startswith("BODex: friction 0.1")
    assert keys["qp.gamma"]["source"] == "BODex's bound; the paper gives no value"
    assert keys["staging.force_floor"]["source"] == "BODex"


def test_the_parts_of_a_text():
    assert doctest.testmod(config_keys).failed == 0


def test_the_help_of_set_and_the_readme_say_where_the_keys_are(capsys):
    for command in ("prepare", "synth", "validate"):
        run([command, "--help"])
        said = " ".join(capsys.readouterr().out.split())
        assert "`bidexdata presets default`" in said
        assert "`bidexdata presets prepare`" in said
        assert "`bidexdata protocols paper-1`" in said
    run(["presets"])
    assert "bidexdata presets prepare" in capsys.readouterr().out
    run(["protocols"])
    assert "bidexdata protocols NAME" in capsys.readouterr().out
    readme = (ROOT / "README.md").read_text("utf-8")
    assert "bidexdata presets default" in readme
    assert "bidexdata presets prepare" in readme
    assert "bidexdata protocols paper-1" in readme


def test_a_protocol_file_is_listed_too_and_an_unknown_one_gives_3(tmp_path, capsys):
    mine = tmp_path / "mine.yaml"
    mine.write_text("base: paper-1\nname: long-1\ndescription: a longer hold\nhold: 5.0\n")
    assert run(["protocols", str(mine), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    keys = {k["key"]: k for g in data["groups"] for k in g["keys"]}
    assert (keys["hold"]["value"], keys["hold"]["unit"]) == (5.0, "s")
    assert run(["protocols", "paper-2"]) == 3
    assert "paper-1" in capsys.readouterr().err


def test_an_unknown_preset_gives_3_and_lists_the_known(capsys):
    assert run(["presets", "papre"]) == 3
    assert "did you mean 'paper'?" in capsys.readouterr().err
