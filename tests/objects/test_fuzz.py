"""Damaged files: refused or loaded, never anything else, and nothing else is touched."""

from __future__ import annotations

import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import trimesh
from damage import FORMATS, damaged, valid_files

from bidexdata.objects.config import (
    ConvexConfig,
    LimitsConfig,
    LoadConfig,
    PrepareConfig,
    SdfConfig,
    SurfaceConfig,
)
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.loading import load_mesh
from bidexdata.objects.sources.shapes import shape_mesh
from bidexdata.record.status import Status
from bidexdata.runs.prepare import prepare_library

QUICK = PrepareConfig(
    sdf=SdfConfig(cells=16),
    surface=SurfaceConfig(points=50),
    convex=ConvexConfig(mcts_iterations=4, mcts_nodes=4, cpu_seconds=5, second_cpu_seconds=5),
    limits=LimitsConfig(cpu_seconds=60.0, wall_seconds=120.0),
)
"""The same code with coarse grids: damage is about reading and repair."""


@pytest.fixture(scope="module")
def small_files(tmp_path_factory) -> dict[str, list[bytes]]:
    """Built-in shapes in every format that this installation writes."""
    meshes = [shape_mesh(name) for name in ("box/0", "mug/0")]
    made = [trimesh.Trimesh(m.vertices, m.faces, process=False) for m in meshes]
    return valid_files(tmp_path_factory.mktemp("none"), made, len(made))


@pytest.mark.parametrize("form", FORMATS)
def test_damaged_files_load_or_are_refused(form, small_files, tmp_path):
    if form not in small_files:
        pytest.skip(f"no package here writes {form}")
    rng = np.random.default_rng(0)
    makers = [damaged(data, rng, form) for data in small_files[form]]
    found = Counter()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for k in range(60):
            try:
                loaded = load_mesh(tmp_path / f"a.{form}", next(makers[k % 2]), LoadConfig())
                assert np.isfinite(loaded.mesh.vertices).all()
                found["ok"] += 1
            except PrepareFailure as failure:
                found[failure.status.label] += bool(failure.reason)
    assert found.total() == 60, found
    assert found["unreadable"] > 3, found
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_thousand_damaged_files_become_a_thousand_rows(shared: Path, tmp_path):
    train = shared / "objects" / "train"
    stl = sorted(train.glob("*.stl"))[:10]
    files = valid_files(train, [trimesh.load(p, force="mesh") for p in stl], 10)
    assert set(files) == set(FORMATS)
    assert all(len(found) == 10 for found in files.values())
    source, out, outside = tmp_path / "in", tmp_path / "out", tmp_path / "outside"
    for folder in (source, outside):
        folder.mkdir()
    rng = np.random.default_rng(1)
    for form, originals in files.items():
        makers = [damaged(data, rng, form) for data in originals]
        for k in range(125):
            (source / f"{form}_{k:03d}.{form}").write_bytes(next(makers[k % 10]))
    before = sorted(p.name for p in source.iterdir())
    report = prepare_library([str(source)], out, QUICK, quiet=True)
    assert len(report.rows) == 1000
    labels = Counter(Status(r["status"]).label for r in report.rows)
    assert not {"crashed", "timed_out"} & set(labels), labels
    assert all(r["reason"] or r["status"] == Status.OK for r in report.rows)
    assert sorted(p.name for p in source.iterdir()) == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in", "out", "outside"]
    assert not list(outside.iterdir())
    assert {p.name for p in out.iterdir() if p.name[0] != "."} == {
        "index.parquet",
        "objects",
        "report.html",
    }
