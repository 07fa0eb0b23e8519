"""Laws of the large runs that `benchmarks.scale` makes, and one of them from end to end."""

from __future__ import annotations

import json

import numpy as np
import pytest
from made_release import OBJECTS, made_release

from benchmarks import scale, scale_data
from bidexdata.formats.release import Release
from bidexdata.hands import load_hands
from bidexdata.runs.run import Run


def test_noise_is_in_the_last_bits_alone():
    rng = np.random.default_rng(0)
    edges = [0.0, -0.0, np.nan, np.inf, -np.inf]
    values = np.array([*edges, *rng.normal(size=500)], np.float32)
    noisy = scale_data.noisy(values, rng)
    kept = len(edges)
    assert noisy[:kept].tobytes() == values[:kept].tobytes()
    before, after = (v[kept:].view(np.uint32) for v in (values, noisy))
    np.testing.assert_array_equal(before >> 12, after >> 12)
    assert len(set((after & 0xFFF).tolist())) > 400


@pytest.mark.slow
def test_a_release_becomes_a_larger_one(tmp_path, capsys):
    hands = load_hands("capsule")
    source, out = tmp_path / "source", tmp_path / "large"
    # Objects of unknown licence would be left out of the larger one.
    made_release(source, [name for name in OBJECTS if name.startswith("box")], hands=hands)
    asked = ["--rows", "300", "--objects", "7", "--shards", "11", "--workers", "1"]
    scale.main([str(source), *asked, "--out", str(out)])
    run, release = Run.open(out / "run"), Release.open(out / "release")
    assert len(run.object_ids) == len(release.object_ids) == 7
    assert len(run.tasks) == 11
    batch = release.grasps()
    assert len(batch) == 300
    assert len(set(batch["grasp_id"].tolist())) == 300
    shapes = release.objects.column("shape_sha256").to_pylist()
    assert len(set(shapes)) == 7
    assert set(np.unique(batch["size_mm"])) == {300, 500}
    assert len(OBJECTS) < 7
    figures = json.loads((out / "packed.json").read_text())
    assert 0 < figures["pack_peak_gb"] < 3
    assert "batches_slower" in capsys.readouterr().out
    scale.main([str(source), *asked, "--out", str(out), "--drop-shards"])
    assert not (out / "run").exists()
    assert (out / "release").is_dir()
