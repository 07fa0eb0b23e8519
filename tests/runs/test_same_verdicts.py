"""A thousand verdicts twice, by one process and by two: the same bits."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from bidexdata.cli.main import run
from bidexdata.record.fields import columns_written_by
from bidexdata.runs.run import Run

FAMILIES = "shapes:box,bottle,mug,bowl,cylinder,ellipsoid"
LEAST = 1000


def columns_of(folder: Path) -> dict[str, np.ndarray]:
    batches = list(Run.open(folder).batches("paper-1", "f"))
    names = columns_written_by("validate")
    return {n: np.concatenate([b[n] for b in batches]) for n in ("grasp_id", *names)}


@pytest.mark.slow
def test_a_thousand_verdicts_are_the_same_whatever_the_workers(tmp_path: Path):
    library, one, two = (tmp_path / name for name in ("library", "one", "two"))
    assert run(["prepare", FAMILIES, "--out", str(library), "--quiet"]) == 0
    how = ["--hand", "capsule", "--sizes", "0.3,0.5,0.8", "--grasps", "36", "--quiet"]
    assert run(["synth", str(library), "--out", str(one), *how]) == 0
    shutil.copytree(one, two)
    assert run(["validate", str(one), "--executor", "inline", "--quiet"]) == 0
    assert run(["validate", str(two), "--workers", "2", "--quiet"]) == 0
    first, second = columns_of(one), columns_of(two)
    assert len(first["grasp_id"]) >= LEAST
    assert np.sum(~first["success"]) > 0
    for name, values in first.items():
        np.testing.assert_array_equal(second[name], values, err_msg=name)
