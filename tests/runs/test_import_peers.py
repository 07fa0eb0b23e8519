"""Files that other projects made go the whole way: import, validate, pack, verify, draw."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from bidexdata.cli import main as cli
from bidexdata.record import Status

FEW = 6
DEEPEST, FARTHEST = 0.012, 0.006
"""A grasp of these samples has no hand deeper in its object, and no finger farther from it than a
clipped centimetre allows on average [m]. Source: their READMEs (7 mm) and the other hand's links."""


def few(source, target):
    """The first grasps of every file of lists."""
    for path in source.glob("*.npy"):
        target.mkdir(exist_ok=True)
        np.save(target / path.name, np.load(path, allow_pickle=True)[:FEW], allow_pickle=True)
    return target


def commanded(capsys, *words):
    code = cli.run([*map(str, words), "--json", "--quiet"])
    return code, json.loads(capsys.readouterr().out or "{}")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "protocol"),
    [("dexgraspnet", "paper-1"), ("bimangrasp", "paper-1"), ("dexgraspbench", "dexgraspbench-1")],
)
def test_a_sample_goes_the_whole_way(form, protocol, shared, menagerie, tmp_path, capsys):
    peer = shared / "peers" / form
    lists = form != "dexgraspbench"
    source = few(peer, tmp_path / "few") if lists else peer
    more = ("--objects", peer / "objects") if lists else ("--limit", 2 * FEW)
    run, release, table = (tmp_path / n for n in ("run", "release", "table.parquet"))
    code, told = commanded(capsys, "import", form, source, "--out", run, *more)
    assert code == 0
    assert told["files_failed"] == told["left_out"] == 0
    assert told["by_status"]["ok"] >= 2
    code, _ = commanded(capsys, "validate", run, "--protocol", protocol)
    assert code in (0, 6)  # not one of these two BimanGrasp grasps need hold
    assert commanded(capsys, "table", run, "--out", table, "--protocol", protocol)[0] == 0
    rows = [r for r in pq.read_table(table).to_pylist() if r["synth_status"] == Status.OK.label]
    assert len(rows) == told["by_status"]["ok"]
    touching = [r for r in rows if r["pd"] is not None and np.isfinite(r["pd"])]
    assert max(r["pd"] for r in touching) < DEEPEST
    assert np.mean([r["contact_distance"] for r in touching]) < FARTHEST
    packed = ("pack", run, "--out", release, "--name", "peer", "--version", "1.0.0")
    assert commanded(capsys, *packed, "--protocol", protocol)[0] == 0
    code, checked = commanded(capsys, "verify", release, "--full")
    assert (code, checked["ok"]) == (0, True)
    sheet = tmp_path / "sheet.png"
    assert commanded(capsys, "render", release, "--out", sheet, "--count", 4)[0] == 0
    assert sheet.stat().st_size > 20_000
