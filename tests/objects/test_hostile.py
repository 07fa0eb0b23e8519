"""The broken and hostile files of the material beside the checkout: what is legal is right, the rest told."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.hostile import Told, told_of
from bidexdata.objects.closed import as_manifold
from bidexdata.objects.config import LoadConfig, PrepareConfig, RepairConfig
from bidexdata.objects.loading import load_mesh
from bidexdata.objects.repair import repair
from bidexdata.record.status import Status
from bidexdata.runs.prepare import prepare_library
from bidexdata.runs.workers import usable_cores

SECONDS, MEBIBYTES = 60, 4e9 / 2**20
"""What a file may take at most, its decomposition included, where nothing else needs the cores."""
BALL = trimesh.creation.icosphere(subdivisions=2, radius=0.2).volume
LEGAL = {
    # Sizes along x, y and z up, and volume, as make_nasty.py writes them.
    "legal name with spaces \u00fc\u00f1\u00ee \u306d\u3053.stl": ([0.4, 0.4, 0.4], BALL),
    "legal_binary_that_starts_with_solid.stl": ([0.4, 0.4, 0.4], BALL),
    "legal_hollow_sphere.stl": ([0.4, 0.4, 0.4], BALL),  # pieces cannot be hollow: it is filled
    "legal_data_uri.gltf": ([0.4, 0.2, 0.3], 0.024),
    "legal_negative_indices.obj": ([0.4, 0.3, 0.2], 0.024),
    "legal_quads_and_concave_ngons.obj": ([0.3, 0.3, 0.1], 0.005),
    "legal_tabs_between_numbers.obj": ([0.4, 0.3, 0.2], 0.024),
    "legal_tetrahedron.dae": ([1, 1, 1], 1 / 6),
    "legal_units_inches_15.7x11.8x7.9.obj": (np.array([0.4, 0.3, 0.2]) / 0.0254, 0.024 / 0.0254**3),
    "legal_units_millimetres_400x300x200.stl": ([400, 300, 200], 0.024e9),
    # Boxes of 0.4 x 0.3 x 0.2 (y up), twice as large: turned by 90 degrees about z at x = 1, scaled
    # by (1, 1/2, 3) at x = -1, mirrored at y = 1.2; the volumes are 8 (1 + 1.5 + 1) of one.
    "legal_scene_rotation_scale_mirror.glb": ([2.7, 1.2, 1.9], 28 * 0.024),
}


@pytest.mark.parametrize("name", LEGAL)
def test_legal_files_have_the_sizes_and_volumes_that_they_were_written_with(shared: Path, name):
    path = shared / "objects" / "nasty" / name
    size, volume = LEGAL[name]
    loaded = load_mesh(path, path.read_bytes(), LoadConfig())
    repaired = repair(loaded.mesh, RepairConfig())
    found = np.ptp(repaired.mesh.vertices, axis=0) * loaded.diagonal
    np.testing.assert_allclose(found, size, rtol=1e-5)
    solid = as_manifold(repaired.mesh)
    assert solid is not None
    assert solid.volume() * loaded.diagonal**3 == pytest.approx(volume, rel=1e-3)


@pytest.mark.slow
def test_hostile_files_give_rows_and_nothing_else(tmp_path, shared: Path, small):
    source, out = shared / "objects" / "nasty", tmp_path / "lib"
    assert {p.name for p in source.glob("legal*")} == set(LEGAL)
    report = prepare_library([str(source)], out, small, quiet=True, workers=1)
    assert len(report.rows) == 81
    status = {r["source_name"]: Status(r["status"]).label for r in report.rows}
    assert not set(status.values()) & {"crashed", "timed_out"}
    assert {status[name] for name in LEGAL} == {"ok"}
    assert status["draco_required.glb"] in ("unsupported", "unreadable")
    assert status["flat_plane.stl"] == "no_volume"
    assert status["point_cloud_no_faces.ply"] == "no_faces"
    assert all(r["reason"] or status[r["source_name"]] == "ok" for r in report.rows)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["lib"]
    assert {p.name for p in out.iterdir() if p.name[0] != "."} == {
        "index.parquet",
        "objects",
        "report.html",
    }


@pytest.mark.slow
def test_no_hostile_file_takes_more_than_a_minute_or_4_gb(shared: Path):
    told: dict[str, Told] = dict(told_of(shared / "objects" / "nasty", PrepareConfig()))
    assert len(told) == 81
    assert not {t.label for t in told.values()} & {"crashed", "timed_out"}
    assert all(t.mebibytes > 0 for t in told.values())
    assert {n: t.busy for n, t in told.items() if t.busy > SECONDS} == {}
    wall = SECONDS * max(1.0, max(os.getloadavg()) / usable_cores())  # others' work takes its share
    assert {n: t.seconds for n, t in told.items() if t.seconds > wall} == {}
    assert {n: t for n, t in told.items() if t.mebibytes + t.child > MEBIBYTES} == {}
