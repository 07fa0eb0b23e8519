"""Laws of the command line: help is fast and light, errors are one sentence and a documented code."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from bidexdata.cli.main import COMMANDS, run

ROOT = Path(__file__).resolve().parents[2]
ENV = {**os.environ, "PYTHONPATH": str(ROOT)}
CPU_LIMIT = 0.5
"""Seconds of CPU for `--help`: it must feel instant; wall time would depend on what else runs."""


def cpu_seconds(code: str) -> tuple[float, str]:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, env=ENV
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def test_help_is_fast_and_loads_nothing_heavy():
    heavy = ["torch", "warp", "mujoco", "trimesh", "scipy", "pyarrow", "viser", "numpy", "rich"]
    code = (
        "import sys\nfrom bidexdata.cli.main import run\nassert run(['--help']) == 0\n"
        f"print([m for m in {heavy} if m in sys.modules])"
    )
    times, outputs = zip(*(cpu_seconds(code) for _ in range(3)), strict=True)
    assert outputs[0].splitlines()[-1] == "[]"
    assert min(times) < CPU_LIMIT
    for name in COMMANDS:
        assert re.search(rf"^  {name}\b", outputs[0], re.MULTILINE), name


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_the_common_options(name: str, capsys: pytest.CaptureFixture):
    assert run([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert text.startswith(f"Usage: bidexdata {name}")
    for option in ("--json", "--quiet", "--debug"):
        assert option in text


@pytest.mark.parametrize("name", ["prepare", "synth"])
def test_long_commands_take_the_options_of_long_commands(name: str, capsys: pytest.CaptureFixture):
    run([name, "--help"])
    text = capsys.readouterr().out
    for option in ("--workers", "--executor", "--shard", "--seed", "--config", "--set"):
        assert option in text


def test_version_is_that_of_the_package(capsys: pytest.CaptureFixture):
    import bidexdata

    assert run(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"bidexdata {bidexdata.__version__}"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "Usage"),
        (["fly"], "fly"),
        (["info"], "PATH"),
        (["info", "x", "--fast"], "--fast"),
        (["synth", "LIB", "--out", "RUN", "--sizes", "big"], "--sizes 'big'"),
        (["synth", "LIB", "--out", "RUN", "--sizes", "0.30001"], "millimetres"),
        (["synth", "LIB", "--out", "RUN", "--sizes", "0.3,nan"], "millimetres"),
        (["synth", "LIB", "--out", "RUN", "--shard", "4/4"], "--shard '4/4'"),
        (["synth", "LIB", "--out", "RUN", "--grasps", "0"], "grasps"),
        (["prepare", "--out", "LIB"], "SOURCE"),
    ],
)
def test_a_line_that_cannot_be_parsed_gives_2(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture
):
    assert run(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["prepare", "nowhere.obj", "--out", "{tmp}/lib"], "nowhere.obj"),
        (["prepare", "shapes:boks", "--out", "{tmp}/lib"], "box"),
        (
            ["prepare", "shapes:box", "--out", "{tmp}/lib", "--set", "convex.thresold=1"],
            "threshold",
        ),
        (["prepare", "shapes:box", "--out", "{tmp}/lib", "--config", "{tmp}/no.yaml"], "no.yaml"),
        (["prepare", "shapes:box", "--out", "{tmp}/lib", "--executor", "magic"], "inline"),
        (["synth", "{tmp}/nolib", "--out", "{tmp}/run"], "nolib"),
        (["synth", "{tmp}", "--out", "{tmp}/run", "--preset", "papre"], "paper"),
        (["synth", "{tmp}", "--out", "{tmp}/run", "--device", "cuda:99"], "this machine has: cpu"),
        (["synth", "{tmp}", "--out", "{tmp}/run", "--setting", "water"], "tabletop"),
        (["validate", "{tmp}/norun"], "norun"),
        (["validate", "{tmp}", "--protocol", "papre-1"], "paper-1"),
        (
            ["pack", "{tmp}/norun", "--out", "{tmp}/rel", "--name", "n", "--version", "1.0.0"],
            "norun",
        ),
        (["info", "{tmp}/nothing"], "nothing"),
        (["info", "{tmp}"], "neither"),
        (["verify", "{tmp}"], "manifest"),
    ],
)
def test_a_named_thing_that_does_not_exist_gives_3_and_one_sentence(
    arguments: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture
):
    assert run([a.format(tmp=tmp_path) for a in arguments]) == 3
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert says in err
    assert len(err.strip().splitlines()) == 1


def test_a_bug_gives_1_and_says_how_to_report_it(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
):
    from bidexdata.runs import info as runs_info

    def broken(*_: object) -> dict:
        raise RuntimeError("a screw is loose\nand another")

    monkeypatch.setattr(runs_info, "describe", broken)
    assert run(["info", str(tmp_path)]) == 1
    err = capsys.readouterr().err
    assert "a screw is loose" in err
    assert "--debug" in err
    assert "bidexdata --version" in err
    assert "issue tracker" in err
    assert len(err.strip().splitlines()) == 1
    assert run(["info", str(tmp_path), "--debug"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_nothing_prepared_gives_6_and_names_the_reasons(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    (tmp_path / "bad.obj").write_text("this is no mesh")
    arguments = ["prepare", str(tmp_path / "bad.obj"), "--out", str(tmp_path / "lib")]
    assert run([*arguments, "--executor", "inline"]) == 6
    out, err = capsys.readouterr()
    assert "bad.obj" in out
    assert err.splitlines()[-1].startswith("error: no input of 1")


def test_ctrl_c_gives_130():
    code = (
        "import sys, time\n"
        "from bidexdata.cli import main\n"
        "from bidexdata.runs import info\n"
        "def wait(*_):\n"
        "    print('waiting', flush=True)\n"
        "    time.sleep(60)\n"
        "info.describe = wait\n"
        "sys.exit(main.run(['info', '.']))\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        env=ENV,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "waiting"
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err.strip() == "interrupted; the same command goes on after the last finished task"


@pytest.mark.parametrize("name", ["hands", "protocols", "presets"])
def test_lists_name_what_there_is_and_json_has_the_documented_keys(
    name: str, capsys: pytest.CaptureFixture
):
    assert run([name]) == 0
    lines = capsys.readouterr().out
    assert run([name, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert list(data) == [name]
    assert run([name, "--help"]) == 0
    documented = set(re.findall(r"\w+", capsys.readouterr().out))
    for entry in data[name]:
        assert entry["name"] in lines
        assert set(entry) <= documented
    assert run([name, "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_bench_lists_what_can_be_measured_and_each_has_help(capsys: pytest.CaptureFixture):
    assert run(["bench", "--json"]) == 0
    names = [b["name"] for b in json.loads(capsys.readouterr().out)["benches"]]
    assert names == ["tables", "speed"]
    every = ("--json", "--quiet", "--debug")
    own = {"tables": ("--workers", "--executor", "--seed"), "speed": ("--hand", "--device")}
    for name in names:
        assert run(["bench", name, "--help"]) == 0
        text = capsys.readouterr().out
        for option in (*every, *own[name]):
            assert option in text


def test_a_dry_run_lists_the_inputs_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    arguments = [
        "prepare",
        "shapes:box/3",
        "--out",
        str(tmp_path / "lib"),
        "--dry-run",
        "--limit",
        "2",
    ]
    assert run(arguments) == 0
    *_, not_counted, last = capsys.readouterr().out.splitlines()
    assert not_counted.startswith("near duplicates are not counted")
    assert last == "2 inputs (2 ok); nothing was written"
    assert not (tmp_path / "lib").exists()
    wanted = ["--set", "select.without_categories=[box]", "--json"]
    assert run([*arguments, *wanted]) == 0
    data = json.loads(capsys.readouterr().out)
    assert [left["source_name"] for left in data["left_out"]] == ["shapes:box/0", "shapes:box/1"]
    assert {left["status"] for left in data["left_out"]} == {"not_selected"}
    assert "select.without_categories" in data["left_out"][0]["reason"]
    assert data["failures"] == []


def test_an_empty_folder_is_not_said_to_be_missing(tmp_path: Path, capsys: pytest.CaptureFixture):
    (tmp_path / "empty").mkdir()
    assert run(["prepare", str(tmp_path / "empty"), "--out", str(tmp_path / "lib")]) == 3
    err = capsys.readouterr().err
    assert "nothing usable there; expected mesh files in it" in err


def test_no_arguments_give_the_help_and_no_complaint(capsys: pytest.CaptureFixture):
    assert run([]) == 2
    err = capsys.readouterr().err
    assert err.startswith("Usage: bidexdata")
    assert "error:" not in err
