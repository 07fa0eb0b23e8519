"""Files that other projects made go the whole way: import, validate, pack, verify, draw."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from bidexdata.cli import main as cli
from bidexdata.formats.closest import distance_to_triangles
from bidexdata.formats.importers import load_format
from bidexdata.objects.config import PrepareConfig, SdfConfig, SurfaceConfig
from bidexdata.record import Status

FEW = 6
DEEPEST = {"dexgraspnet": 0.005, "bimangrasp": 0.018, "dexgraspbench": 0.003}
"""No hand is deeper in its object [m]. Measured: 3.4, 16.2 and 1.8 mm; fingers of the unfinished BimanGrasp
sample go through the walls of a bin, and PD is how far a finger would have to move out of one."""
FARTHEST = 0.006
"""Mean distance of fingers from the object, of a centimetre at most [m]."""


SAME_DISTANCE = 1e-4
"""[m]; its distances are roots of float32 squares, off by up to 0.02 mm near the surface."""


def few(source, target):
    """The first grasps of every file of lists."""
    for path in source.glob("*.npy"):
        target.mkdir(exist_ok=True)
        np.save(target / path.name, np.load(path, allow_pickle=True)[:FEW], allow_pickle=True)
    return target


def commanded(capsys, *words):
    code = cli.run([*map(str, words), "--json", "--quiet"])
    return code, json.loads(capsys.readouterr().out or "{}")


def test_bimangrasp_s_contact_points_are_as_far_from_our_object_as_from_its_own(shared):
    """Its signed distances to its own pieces, for contact points in the frame of its file."""
    root = shared / "peers" / "bimangrasp"
    form = load_format("bimangrasp")
    (path,) = root.glob("*.npy")
    config = PrepareConfig(surface=SurfaceConfig(points=100), sdf=SdfConfig(cells=12))
    solid = form.load_object(form.find_object(path.stem, root, None), config)
    grasps, known = form.read(path.read_bytes(), path.name), np.load(root / "grasps.npz")
    unit, origin = solid.provenance["unit_in_file"], np.array(solid.provenance["origin_in_file"])
    triangles = np.concatenate([p.vertices[p.faces] for p in solid.pieces])
    for i, scale in enumerate(grasps.scale):
        for side in ("left", "right"):
            ours = known[f"{side}_contact_points"][i] - scale * origin
            found = distance_to_triangles(ours.astype(float), triangles * scale * unit)
            theirs = np.abs(known[f"{side}_contact_sdf"][i])
            np.testing.assert_allclose(found, theirs, atol=SAME_DISTANCE)


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
    assert max(r["pd"] for r in touching) < DEEPEST[form]
    assert np.mean([r["contact_distance"] for r in touching]) < FARTHEST
    packed = ("pack", run, "--out", release, "--name", "peer", "--version", "1.0.0")
    # Nobody states the licences of these meshes, so they stay behind.
    policy = ("--licences", "ids-only")
    assert commanded(capsys, *packed, "--protocol", protocol, *policy)[0] == 0
    code, checked = commanded(capsys, "verify", release, "--full")
    assert (code, checked["ok"]) == (0, True)
    sheet = tmp_path / "sheet.png"
    assert commanded(capsys, "render", run, "--out", sheet, "--count", 4)[0] == 0
    assert sheet.stat().st_size > 20_000
