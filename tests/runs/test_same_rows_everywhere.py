"""Whatever runs the tasks, and however the plan is divided, a run has the same bytes."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from bidexdata.cli.main import run
from bidexdata.runs.content_hash import run_content_hash
from bidexdata.runs.run import Run

pytestmark = pytest.mark.slow

OBJECTS = 12


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("library") / "library"
    assert run(["prepare", "shapes", "--limit", str(OBJECTS), "--out", str(out), "--quiet"]) == 0
    return out


def made(library: Path, out: Path, *how: tuple[str, ...]) -> dict[str, str]:
    """Synthesise and validate in one or several calls; a hash per shard, and that of the content."""
    small = ["--hand", "capsule", "--sizes", "0.3", "--grasps", "2", "--candidates", "4"]
    for options in how:
        assert run(["synth", str(library), "--out", str(out), *small, "--quiet", *options]) == 0
    for options in how:
        assert run(["validate", str(out), "--quiet", *options]) in (0, 6)
    done = Run.open(out)
    assert len(done.object_ids) == OBJECTS
    assert len(done.done()) == len(done.tasks)
    shards = {
        path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*.arrow"))
    }
    return {**shards, "content": run_content_hash(done)}


@pytest.fixture(scope="module")
def by_processes(library, tmp_path_factory) -> dict[str, str]:
    shards = made(library, tmp_path_factory.mktemp("processes") / "run", ("--workers", "2"))
    assert any(name.startswith("validate/") for name in shards)
    return shards


def test_two_shards_of_the_plan_make_the_same_run(library, by_processes, tmp_path):
    parts = (("--shard", "0/2"), ("--shard", "1/2"))
    assert made(library, tmp_path / "run", *parts) == by_processes


def test_ray_makes_the_same_run(library, by_processes, tmp_path):
    pytest.importorskip("ray")
    how = ("--executor", "ray", "--workers", "2")
    assert made(library, tmp_path / "run", how) == by_processes
