"""The same command again: after kills it finishes the library, after that it has nothing to do."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mesh_files import library_files as files

from bidexdata.cli.main import run

ROOT = Path(__file__).resolve().parents[2]
ENV = {**os.environ, "PYTHONPATH": str(ROOT)}
COARSE = ("--set", "sdf.cells=40", "--set", "surface.points=600")
KILLS = 5
REAL = ("duck.glb", "robosuite_cereal.obj", "aws_securitycamera.dae", "contactdb_table.stl")
"""Meshes beside the checkout that come nowhere near a bound of time, each of another format."""


def start(sources: list[str], out: Path) -> subprocess.Popen:
    """Start `prepare` with two workers, as the leader of a process group of its own."""
    command = [sys.executable, "-m", "bidexdata", "prepare", *sources, "--out", str(out), *COARSE]
    return subprocess.Popen(
        [*command, "--workers", "2", "--json", "--quiet"],
        env=ENV,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


@pytest.mark.slow
def test_five_kills_at_random_moments_leave_the_library_of_an_undisturbed_run(tmp_path: Path):
    train = ROOT.parent / "shared" / "objects" / "train"
    sources = ["shapes", *(str(train / name) for name in REAL if (train / name).is_file())]
    assert start(sources, tmp_path / "whole").wait(900) == 0

    out, rng = tmp_path / "killed", np.random.default_rng(0)
    # Each time at a random moment of work, after one more object is done: never all, never none.
    for kill in range(KILLS):
        process = start(sources, out)
        while len(list(out.glob("objects/*/*/object.json"))) <= kill:
            assert process.poll() is None, "the kill came too late"
            time.sleep(0.05)
        time.sleep(rng.uniform(0, 2))
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert not (out / "index.parquet").exists()
    said, _ = start(sources, out).communicate(timeout=900)
    report = json.loads(said)
    assert 0 < report["resumed"] < report["inputs"]
    assert report["by_status"] == {"ok": report["inputs"]}
    assert files(out) == files(tmp_path / "whole")


def test_a_finished_library_is_left_as_it_is_and_the_command_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    out = tmp_path / "lib"
    again = ["prepare", "shapes:box,cone", "--out", str(out), *COARSE, "--executor", "inline"]
    assert run([*again, "--quiet"]) == 0
    before = {p: p.stat().st_mtime_ns for p in (out / "objects").rglob("*") if p.is_file()}
    made = files(out)
    capsys.readouterr()
    assert run(again) == 0
    assert "nothing to do: every input was settled before" in capsys.readouterr().out
    assert run([*again, "--json", "--quiet"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["made"], report["resumed"], report["prepared"]) == (0, 2, 2)
    assert files(out) == made
    assert {p: p.stat().st_mtime_ns for p in before} == before
