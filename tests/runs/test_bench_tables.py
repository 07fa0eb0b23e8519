"""Laws of `bench tables`: rows are runs of stated configurations, figures are counts of their rows."""

from __future__ import annotations

import dataclasses
import itertools
import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from made_armed import write_rig

from bidexdata.cli.main import run as command
from bidexdata.config import differing_keys, to_plain, with_overrides
from bidexdata.errors import ConfigConflict, NotUsable
from bidexdata.objects.library import Library
from bidexdata.record import Scene
from bidexdata.runs import bench_rows
from bidexdata.runs.bench_markdown import length_text, markdown, mean_text, rate_text
from bidexdata.runs.bench_paper import PAPER
from bidexdata.runs.bench_regions import KINDS, PAIRS, object_q1, pair_q1
from bidexdata.runs.bench_rows import (
    OURS_CHAIN,
    PAPER_CHAIN,
    ROWS,
    TABLE_2,
    TABLE_3,
    WITHOUT,
    Change,
)
from bidexdata.runs.bench_speed import TIMES, Speed, speed_of
from bidexdata.runs.bench_tables import TablesReport, TablesRequest, make_tables
from bidexdata.runs.info import describe
from bidexdata.runs.run import Run
from bidexdata.runs.stage import TaskExecution
from bidexdata.synthesis.config import SynthConfig
from bidexdata.synthesis.methods import load_method
from bidexdata.synthesis.presets import load_preset
from bidexdata.synthesis.regions import select_region_pairs

INLINE = TaskExecution(executor="inline", quiet=True)
ASKED = TablesRequest(hand="capsule", sizes_mm=(300,), grasps=2)
SHORT = {
    "bidexgrasp": {
        "regions.anchors": 40,
        "optimise.approach.steps": 30,
        "optimise.pregrasp.steps": 10,
        "optimise.grasp.steps": 20,
    },
    "bodex": {"schedule.steps": 50},
    "bimangrasp": {"annealing.steps": 20, "energy.object_points": 200},
}
BY_NAME = {row.name: row for row in ROWS}
MADE = (*TABLE_2, "bodex", "paper_r")
"""Rows that are made here: one of every method, setting and preset."""
SPEED = ("s", "s_attempts", "s_cpu_seconds", "sgs")


def shortened() -> tuple[bench_rows.Row, ...]:
    """Rows of the tables with short searches."""
    return tuple(
        dataclasses.replace(
            row, changes=(*row.changes, *(Change(*c) for c in SHORT[row.method].items()))
        )
        for row in map(BY_NAME.__getitem__, MADE)
    )


def files_of(folder: Path) -> dict[Path, tuple[int, bytes]]:
    """Time and bytes of every file but logs."""
    found = (p for p in folder.rglob("*") if p.is_file() and "logs" not in p.parts)
    return {p.relative_to(folder): (p.stat().st_mtime_ns, p.read_bytes()) for p in found}


def without_speed(data: dict) -> dict:
    rows = {
        name: {key: value for key, value in row.items() if key not in SPEED}
        for name, row in data["rows"].items()
    }
    return {**data, "rows": rows}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tables") / "library"
    made = ["prepare", "shapes:box/2", "--out", str(folder), "--executor", "inline"]
    assert command([*made, "--quiet"]) == 0
    return folder


@pytest.fixture(scope="module")
def first(library: Path) -> TablesReport:
    """The tables of the first object alone."""
    asked = dataclasses.replace(ASKED, limit=1)
    return make_tables(library, library.parent / "out", asked, execution=INLINE, rows=shortened())


@pytest.fixture(scope="module")
def made(library: Path, first: TablesReport) -> TablesReport:
    """Of both objects, in the same folder."""
    out = library.parent / "out"
    return make_tables(library, out, ASKED, execution=INLINE, rows=shortened())


@pytest.mark.parametrize(
    ("names", "preset"), [(PAPER_CHAIN, "paper"), (OURS_CHAIN, "default")], ids=["paper", "ours"]
)
def test_neighbours_in_an_paper_differ_in_the_keys_that_are_named_and_in_no_other(names, preset):
    chain = [BY_NAME[name] for name in names]
    for (lacking, having), part in zip(itertools.pairwise(chain), WITHOUT[preset], strict=True):
        plain = [to_plain(row.config()) for row in (lacking, having)]
        differing = {text.partition(":")[0] for text in differing_keys(plain[0], plain[1])}
        assert differing == {change.key for change in part}
        assert sorted(lacking.changes) == sorted((*having.changes, *part))
    assert chain[-1].config() == load_preset(preset)
    assert {row.setting for row in chain} == {"tabletop"}


def test_ours_are_the_defaults_and_peers_their_own():
    assert BY_NAME["ours_floating"].config() == BY_NAME["ours_tabletop"].config() == SynthConfig()
    for name, method in (("bimangrasp", "bimangrasp"), ("bodex", "bodex")):
        assert BY_NAME[name].config() == load_method(method).config()
    assert [BY_NAME[name].setting for name in TABLE_2] == ["floating", "floating", "tabletop"]
    assert {*TABLE_2, *TABLE_3} == set(BY_NAME)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_the_command_of_a_row_makes_its_configuration(row: bench_rows.Row):
    words = shlex.split(row.command("capsule", (300, 500), 2, 0))
    options = [(a, b) for a, b in itertools.pairwise(words) if a.startswith("--")]
    given = dict(options)
    method = given.get("--method", "bidexgrasp")
    base = load_method(method).config()
    if method == "bidexgrasp":
        base = load_preset(given.get("--preset", "default"))
    assert with_overrides(base, [b for a, b in options if a == "--set"]) == row.config()
    assert (given["--setting"], given["--sizes"]) == (row.setting, "0.3,0.5")


def test_a_row_is_a_run_of_its_configuration_and_setting(library, made):
    for row in shortened():
        spec = Run.open(made.json_file.parent / row.name).spec
        assert spec.config == to_plain(row.config())
        assert (spec.method, spec.preset, spec.setting) == (row.method, row.preset, row.setting)
        found = made.data["rows"][row.name]
        assert found["fingerprint"] == spec.fingerprint
        assert found["changes"] == dict(row.changes)


def test_counts_are_those_of_info_on_each_run(made):
    for row in shortened():
        info = describe(made.json_file.parent / row.name)
        figures, found = info["figures"], made.data["rows"][row.name]
        assert found["by_status"] == figures["by_status"]
        assert (found["objects"], found["scenes"]) == (figures["objects"], figures["scenes"])
        assert set(figures["tests"]) == set(row.tests())
        for kind, rows in (("selected", "selected_rows"), ("unselected", "audit_rows")):
            assert found[kind]["rows"] == figures[rows]
            for test in row.tests():
                assert found[kind][f"suc_{test}"] == figures["tests"][test][kind]
        for metric in ("pd", "spd", "cdc"):
            mean = found["selected"][metric]
            assert (mean and mean["mean"]) == figures[metric]
        assert (found["kept"], found["selected"]["d"]) == (figures["kept"], figures["d"])
        assert found["objects_untested"] == 0
        assert found["s"] > 0


def test_unselected_means_are_those_of_the_audit_rows(made):
    run = Run.open(made.json_file.parent / "ours_tabletop")
    depths = []
    for batch in run.batches("paper-1", "f"):
        depths += batch["pd"][batch["audit"]].tolist()
    known = np.array(depths)[np.isfinite(depths)]
    mean = made.data["rows"]["ours_tabletop"]["unselected"]["pd"]
    assert mean["n"] == len(known) > 0
    assert mean["mean"] == pytest.approx(known.mean())


def test_the_first_objects_alone_count_where_that_is_asked_for(library, first, made):
    both = made.data["library"]["object_ids"]
    assert (first.data["library"]["object_ids"], len(both)) == (both[:1], 2)
    for name, row in first.data["rows"].items():
        whole = made.data["rows"][name]
        assert (row["objects"], whole["objects"]) == (1, 2)
        for kind, test in itertools.product(("selected", "unselected"), ("suc_f", "suc_l")):
            some, every = row[kind].get(test), whole[kind].get(test)
            assert (some is None) == (every is None)
            if some:
                assert some["k"] <= every["k"]
                assert some["n"] <= every["n"]
        assert (row["unselected"]["suc_f"]["n"], whole["unselected"]["suc_f"]["n"]) == (2, 4)
    assert first.data["regions"]["objects"] == 1


def test_the_markdown_shows_the_figures_of_the_json(made):
    data = json.loads(made.json_file.read_text())
    assert data == json.loads(json.dumps(made.data))
    text = made.markdown_file.read_text()
    assert text == markdown(data)
    lines = text.splitlines()
    for row in data["rows"].values():
        for kind in ("unselected", "selected"):
            (line, *_) = [s for s in lines if s.startswith(f"| {row['title']} | {kind} |")]
            for test in row[kind]:
                if test.startswith("suc_"):
                    rate = row[kind][test]
                    assert f" {rate_text(rate)} |" in line
                    assert f"{rate['k']}/{rate['n']})" in line
            assert f" {length_text(row[kind]['pd'])} |" in line
        assert f"`{row['command']}`" in text
        assert all(kind["device_name"] in text for kind in row["made_with"]["synth"])
        assert all(f"`{k}={v}`" in text for k, v in row["changes"].items())
    for name, kind in data["regions"]["kinds"].items():
        (line,) = [s for s in lines if s.startswith(f"| {name} |")]
        assert f" {mean_text(kind['q1'], 2, 100.0)} |" in line
        assert f" {rate_text(kind['positive'])} |" in line
    for figure in ("75.84", "26.80", "80.83", "28.3", "44.4", "1.25", "0.79", "15.2"):
        assert f"| {figure} |" in text
    widths = {len(re.findall(r"(?<!\\)\|", s)) for s in lines if s.startswith("|")}
    assert len(widths) == 3  # one per table


def test_a_second_call_does_nothing_and_leaves_the_same_bytes(library, made):
    before = files_of(made.json_file.parent)
    again = make_tables(library, made.json_file.parent, ASKED, execution=INLINE, rows=shortened())
    assert again.data == made.data
    after = files_of(made.json_file.parent)
    assert {p: text for p, (_, text) in after.items()} == {p: t for p, (_, t) in before.items()}
    written = {p.name for p in after if after[p] != before[p]}
    assert written == {"tables.json", "tables.md"}


def test_what_a_killed_command_left_is_gone_on_with(library, made):
    out = library.parent / "killed"
    shutil.copytree(made.json_file.parent, out)
    for name in ("tables.json", "tables.md"):
        (out / name).unlink()
    next((out / "regions").iterdir()).unlink()
    next((out / "ours_floating" / "validate").rglob("*.arrow")).unlink()
    shutil.rmtree(out / "bodex" / "validate")
    next((out / "bodex" / "synth").rglob("*.arrow")).unlink()
    shutil.rmtree(out / "paper_r")
    with (out / "ours_tabletop" / TIMES).open("a") as file:
        file.write('{"task_id": "00')  # half a line
    again = make_tables(library, out, ASKED, execution=INLINE, rows=shortened())
    assert without_speed(again.data) == without_speed(dict(made.data))
    assert all(row["s"] > 0 for row in again.data["rows"].values())


@pytest.mark.parametrize(
    ("other", "key"),
    [
        ({"seed": 1}, "seed: 0 -> 1"),
        ({"sizes_mm": (500,)}, "sizes_mm"),
        ({"grasps": 1}, "may only grow"),
    ],
)
def test_a_folder_of_another_configuration_is_refused_and_left_as_it_is(library, made, other, key):
    before = files_of(made.json_file.parent)
    asked = dataclasses.replace(ASKED, **other)
    with pytest.raises(ConfigConflict, match=key):
        make_tables(library, made.json_file.parent, asked, execution=INLINE, rows=shortened())
    assert files_of(made.json_file.parent) == before


def test_rows_on_a_table_are_made_for_the_rig_and_floating_ones_for_none(library, tmp_path):
    rig, rows = write_rig(tmp_path / "rig"), tuple(r for r in shortened() if r.name in TABLE_2[1:])
    asked = dataclasses.replace(ASKED, grasps=1, rig=str(rig))
    found = make_tables(library, tmp_path / "out", asked, execution=INLINE, rows=rows)
    floating, tabletop = (Run.open(tmp_path / "out" / name).spec for name in TABLE_2[1:])
    assert floating.rig is None
    assert tabletop.rig is not None
    assert tabletop.rig.name == found.data["rig"] == "made"
    commands = {name: row["command"] for name, row in found.data["rows"].items()}
    assert f"--rig {rig}" in commands["ours_tabletop"]
    assert "--rig" not in commands["ours_floating"]
    without = dataclasses.replace(asked, rig="")
    with pytest.raises(ConfigConflict, match="rig: 'made' -> ''"):
        make_tables(library, tmp_path / "out", without, execution=INLINE, rows=rows)


def test_a_library_run_or_release_is_no_folder_for_tables(library, made):
    with pytest.raises(NotUsable, match="choose another --out"):
        make_tables(library, made.json_file.parent / "bimangrasp", ASKED, execution=INLINE)
    with pytest.raises(NotUsable, match="is no folder"):
        make_tables(library, made.json_file, ASKED, execution=INLINE)


def test_the_command_prints_the_tables_and_names_the_files(
    library, made, monkeypatch, capsys: pytest.CaptureFixture
):
    monkeypatch.setattr(bench_rows, "ROWS", shortened())
    out = made.json_file.parent
    asked = ["bench", "tables", str(library), "--out", str(out), "--hand", "capsule"]
    asked += ["--grasps", "2", "--executor", "inline", "--rig", "none"]
    passed = any(row["unselected"]["suc_f"]["k"] for row in made.data["rows"].values())
    code = 0 if passed else 6
    assert command([*asked, "--sizes", "0.3", "--json"]) == code
    data = json.loads(capsys.readouterr().out)
    assert data.pop("files") == [str(made.markdown_file), str(made.json_file)]
    assert data.pop("seconds") > 0
    assert data == json.loads(made.json_file.read_text())
    assert command([*asked, "--sizes", "0.3"]) == code
    *lines, last = capsys.readouterr().out.splitlines()
    assert str(made.markdown_file) in last
    assert str(made.json_file) in last
    titles = tuple(BY_NAME[name].title for name in MADE)
    assert sum(line.startswith(titles) for line in lines) == len(MADE)
    assert command([*asked, "--sizes", "0.5"]) == 5
    out, err = capsys.readouterr()
    assert out == ""
    assert "sizes_mm" in err.splitlines()[-1]


def test_speeds_leave_out_each_workers_first_task_and_half_a_line(made, tmp_path):
    run = Run.open(made.json_file.parent / "ours_floating")
    ids = [task.task_id for task in run.tasks]
    moved = Run(tmp_path, run.spec)
    shutil.copy(run.path / "tasks.parquet", tmp_path)

    def line(task_id: str, seconds: float, process: int) -> str:
        plain = {"task_id": task_id, "attempts": 8, "cpu_seconds": seconds, "process": process}
        return json.dumps(plain) + "\n"

    (tmp_path / TIMES).write_text(line(ids[0], 9.0, 1) + line(ids[1], 2.0, 1) + '{"task')
    assert speed_of(moved, run.object_ids) == Speed(8, 2.0)
    (tmp_path / TIMES).write_text(line(ids[0], 9.0, 1) + line(ids[1], 2.0, 2))
    assert speed_of(moved, run.object_ids) == Speed(16, 11.0)
    (tmp_path / TIMES).unlink()
    assert speed_of(moved, run.object_ids).per_second is None


def test_kinds_of_regions_differ_in_what_chooses_pairs_alone():
    configs = {kind.name: kind.config() for kind in KINDS}
    assert list(configs) == ["paper_random", "paper", "random", "force", "torque"]
    assert configs["torque"] == SynthConfig().regions
    assert configs["paper"] == load_preset("paper").regions
    for name in ("random", "force"):
        assert dataclasses.replace(configs[name], score="torque") == configs["torque"]
    assert configs["paper_random"] == BY_NAME["paper_none"].config().regions


def test_pairs_that_ours_chooses_resist_and_contacts_that_push_one_way_do_not(library):
    opened = Library.open(library)
    obj = opened.load(opened.object_ids[0])
    scene = Scene(obj.object_id, 300)
    config = dataclasses.replace(SynthConfig().regions, anchors=40)
    pairs = select_region_pairs(obj, scene, config, np.random.default_rng(0))
    found = pair_q1(pairs, np.random.default_rng(0))
    assert len(found) == PAIRS
    assert max(found) > 0
    assert found == pair_q1(pairs, np.random.default_rng(0))
    one_way = pairs._replace(normals=np.zeros_like(pairs.normals) + np.float32([0, 0, 1]))
    assert pair_q1(one_way, np.random.default_rng(0)) == [0.0] * PAIRS


def test_regions_of_an_object_are_counted_by_kind(library, made):
    object_id = made.data["library"]["object_ids"][0]
    found = object_q1(str(library), ASKED.sizes_mm, ASKED.seed, object_id)
    stored = json.loads((made.json_file.parent / "regions" / f"{object_id}.json").read_text())
    assert stored["q1"] == found
    assert list(found) == [kind.name for kind in KINDS]
    for name, kind in made.data["regions"]["kinds"].items():
        assert kind["pairs"] == kind["q1"]["n"] == kind["positive"]["n"]
        assert len(found[name]) <= PAIRS
        assert min(found[name]) >= 0


def test_the_papers_figures_are_there_for_every_row_that_it_has():
    assert set(PAPER["table_2"]) == set(TABLE_2)
    assert set(PAPER["table_3"]) == {"bodex", *PAPER_CHAIN} - {"paper_none"}
    assert set(PAPER["regions"]) <= {kind.name for kind in KINDS}
    ours = PAPER["table_2"]["ours_tabletop"]["dexgraspnet"]
    last = PAPER["table_3"]["paper_r_dc_ps"]
    assert ours["suc_l"] == pytest.approx(last["suc_l"], abs=5e-4)  # the same run, rounded
    assert ours["pd"] == last["pd"] == 0.0015
