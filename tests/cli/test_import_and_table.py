"""`bidexdata import` and `table`: exit codes, keys, and that other commands take what they make."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from made_dexgraspbench import made_dexgraspbench
from made_named_qpos import made_bodex, made_named

from bidexdata.cli.main import COMMANDS, run
from bidexdata.objects.config import PrepareConfig, SdfConfig, SurfaceConfig
from bidexdata.runs import import_objects
from bidexdata.validation import validate


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    small = PrepareConfig(surface=SurfaceConfig(points=100), sdf=SdfConfig(cells=12))
    monkeypatch.setattr(import_objects, "PrepareConfig", lambda: small)


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    return made_dexgraspbench(tmp_path_factory.mktemp("bench"))


def importing(bench: Path, out: Path, *more: str) -> list[str]:
    named = ["import", "dexgraspbench", str(bench), "--out", str(out), "--hand", "capsule"]
    return [*named, "--executor", "inline", *more]


def documented(name: str) -> set[str]:
    return set(re.findall(r"\w+", COMMANDS[name].__doc__ or ""))


def test_an_import_reports_its_files_and_the_next_command(bench, tmp_path, capsys):
    out = tmp_path / "run"
    (bench / "graspdata" / "bad.npy").write_bytes(b"nothing")
    assert run(importing(bench, out, "--json", "--quiet")) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["files"], data["files_failed"], data["n"], data["objects"]) == (9, 1, 8, 2)
    assert data["failures"][0]["file"] == "graspdata/bad.npy"
    assert data["next"] == f"bidexdata validate {out} --protocol dexgraspbench-1"
    assert set(data) - {"next"} <= documented("import")
    assert run(importing(bench, out)) == 0
    text = capsys.readouterr().out
    assert "graspdata/bad.npy: it is no .npy file" in text
    assert "8 grasps of 2 objects from 9 files (8 read, 1 failed)" in text
    assert run(["info", str(out)]) == 0
    text = capsys.readouterr().out
    assert "imported from 8 files; not usable: 1 file and 0 grasps" in text
    assert "kept" not in text
    assert "attempts" not in text


@pytest.mark.parametrize("success", [False, True])
def test_its_verdicts_are_packed_next_if_one_is_a_success(
    bench, tmp_path, capsys, monkeypatch, success
):
    def judged(*args, **options):
        columns = validate_grasps(*args, **options)
        columns["success"][:] = success
        return columns

    validate_grasps = validate.validate_grasps
    monkeypatch.setattr(validate, "validate_grasps", judged)
    out = tmp_path / "run"
    assert run(importing(bench, out, "--limit", "1", "--quiet")) == 0
    capsys.readouterr()
    short = ("--set", "name=short-1", "--set", "hold=0.2", "--executor", "inline")
    code = run(["validate", str(out), "--protocol", "dexgraspbench-1", *short, "--json"])
    following = json.loads(capsys.readouterr().out)["next"]
    if success:
        assert code == 0
        assert following.startswith(f"bidexdata pack {out} --out RELEASE")
        assert following.endswith("--protocol short-1")
    else:
        assert (code, following) == (6, f"bidexdata info {out}")


def test_its_run_can_be_drawn_tabled_and_refuses_another_setting(bench, tmp_path, capsys):
    out = tmp_path / "run"
    assert run(importing(bench, out, "--limit", "2", "--quiet")) == 0
    sheet = ["render", str(out), "--out", str(tmp_path / "s.png"), "--count", "2", "--quiet"]
    assert run(sheet) == 0
    assert (tmp_path / "s.png").stat().st_size > 10_000
    assert run(importing(bench, out, "--limit", "2", "--setting", "tabletop")) == 5
    assert "setting: 'floating' -> 'tabletop'" in capsys.readouterr().err
    for path, kind in ((out, "run"), (out / "library", "library")):
        table = tmp_path / f"{kind}.csv"
        assert run(["table", str(path), "--out", str(table), "--json", "--quiet"]) == 0
        data = json.loads(capsys.readouterr().out)
        lines = table.read_text().splitlines()
        assert data["kind"] == kind
        assert data["n"] == len(lines) - 1
        assert len(data["columns"]) == len(lines[0].split(","))
        assert set(data) <= documented("table")
    assert run(["table", str(out), "--out", str(tmp_path / "t.csv"), "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_nothing_imported_gives_6_with_the_reasons(bench, tmp_path, capsys):
    objects = tmp_path / "none"
    objects.mkdir()
    moved = tmp_path / "bench"
    (moved / "graspdata").mkdir(parents=True)
    for file in bench.rglob("0.npy"):
        (moved / "graspdata" / f"{file.parent.name}.npy").write_bytes(file.read_bytes())
    more = ("--objects", str(objects))
    assert run(importing(moved, tmp_path / "run", *more)) == 6
    out, err = capsys.readouterr()
    assert "has no urdf/meshes" in out
    assert err.splitlines()[-1].startswith("error: not one grasp of")
    assert not (tmp_path / "run").exists()
    for k in range(12):
        (moved / "graspdata" / f"more{k}.npy").write_bytes(b"nothing")
    assert run(importing(moved, tmp_path / "run", *more)) == 6
    out = capsys.readouterr().out
    assert "more files: --json\n" in out
    assert "files.parquet" not in out
    assert run(importing(moved, tmp_path / "run", "--objects", str(bench / "objects"))) == 0


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["import", "dexgraspbench", "{tmp}/no", "--out", "{tmp}/r"], 3, "no such file or folder"),
        (["import", "graspnet", "{tmp}", "--out", "{tmp}/r"], 3, "known: dexgraspbench"),
        (["import", "dexgraspbench", "{tmp}", "--out", "{tmp}/r"], 3, "holds no file"),
        (
            ["import", "dexgraspbench", "{tmp}", "--out", "{tmp}/r", "--setting", "water"],
            3,
            "one of floating, tabletop",
        ),
        (["import", "dexgraspbench"], 2, "PATH"),
        (["table", "{tmp}/no", "--out", "{tmp}/t.csv"], 3, "no such file or folder"),
        (["table", "{tmp}", "--out", "{tmp}/t.xls"], 3, ".parquet"),
        (["table", "{tmp}"], 2, "--out"),
    ],
)
def test_what_cannot_be_done_is_one_sentence(arguments, code, says, tmp_path, capsys):
    assert run([a.format(tmp=tmp_path) for a in arguments]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize("form", ["dexgraspnet", "bimangrasp", "bodex"])
def test_other_formats_become_runs_and_say_what_is_not_known(form, tmp_path, capsys):
    from bidexdata.formats.importers import load_format

    source = tmp_path / "source"
    made_bodex(source) if form == "bodex" else made_named(source, form)
    out = tmp_path / "run"
    words = ["import", form, str(source), "--out", str(out), "--hand", "capsule"]
    assert run([*words, "--executor", "inline", "--json", "--quiet"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["files"], data["files_failed"], data["objects"]) == (2, 0, 2)
    assert data["by_status"] == {"ok": data["n"]}
    known = load_format(form)
    assert data["unknown"][:-1] == list(known.unknown)
    assert data["unknown"][-1].startswith("licence of 2 of 2 objects")
    assert any("made here" in u for u in data["unknown"]) == known.made_stages
    assert run([*words, "--executor", "inline"]) == 0
    text = capsys.readouterr().out
    assert all(f"not known: {phrase}" in text for phrase in data["unknown"])
    made = json.loads((out / "run.json").read_text())["config"].get("made_stages")
    assert made == ({"palm": 0.01, "joints": 0.1} if known.made_stages else None)


def test_grasps_that_the_hand_cannot_take_are_counted_and_packed_as_audit_rows(tmp_path, capsys):
    source = made_named(tmp_path / "source", "dexgraspnet")
    file = source / "dataset" / "brick.npy"
    rows = np.load(file, allow_pickle=True)
    rows[0]["qpos"]["robot0:FFJ1"] = -52.0
    np.save(file, rows, allow_pickle=True)
    out, release = tmp_path / "run", tmp_path / "release"
    words = ["import", "dexgraspnet", str(source), "--out", str(out), "--hand", "capsule"]
    assert run([*words, "--executor", "inline"]) == 0
    assert "without a pose: 1 joint_range (joints lie outside" in capsys.readouterr().out
    packed = ["pack", str(out), "--out", str(release), "--name", "a", "--version", "1.0.0"]
    packed += ["--licences", "ids-only"]  # the files state none
    assert run([*packed, "--quiet", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert (figures["n"], figures["selected_rows"], figures["audit_rows"]) == (12, 11, 1)
    assert run(["verify", str(release), "--full", "--quiet"]) == 0
    assert run(["info", str(release)]) == 0
    assert "11 selected rows, 1 audit row" in capsys.readouterr().out


@pytest.mark.parametrize("form", ["dexgraspbench", "dexgraspnet", "bimangrasp", "bodex"])
def test_no_grasp_found_says_what_was_expected(form, tmp_path, capsys):
    from bidexdata.formats.importers import load_format

    expected = load_format(form).expected
    words = ["import", form, str(tmp_path / "in"), "--out", str(tmp_path / "run")]
    (tmp_path / "in" / "a").mkdir(parents=True)
    assert run([*words, "--executor", "inline"]) == 3
    assert f"expected {expected}" in capsys.readouterr().err
    np.save(tmp_path / "in" / "a" / "b_grasp.npy", np.ones(3))
    assert run([*words, "--executor", "inline"]) == 6
    out, err = capsys.readouterr()
    assert "it holds an array (3,) of float64, not" in out
    assert err.strip().endswith(f"expected {expected}")
