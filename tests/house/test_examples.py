"""Every example runs as a user would run it, and asserts what it shows."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from made_release import made_release, made_rows

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("[0-9][0-9]_*.py"))
NEEDS = {"03_train_lightning": "lightning"}
"""Packages that no extra brings, by the example that needs them."""
ARMS = ("05_arms",)
"""Examples whose release has arms."""


def test_there_are_examples():
    assert EXAMPLES


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_an_example_runs_on_a_release_without_deprecation_warnings(
    path: Path, packed: Path, armed: Path
):
    if find_spec(NEEDS.get(path.stem, "sys")) is None:
        pytest.skip(f"needs the package {NEEDS[path.stem]}")
    # What such a package deprecates in torch is not ours to mend.
    kinds = [] if path.stem in NEEDS else ["DeprecationWarning", "FutureWarning"]
    strict = [flag for kind in kinds for flag in ("-W", f"error::{kind}")]
    done = subprocess.run(
        [sys.executable, *strict, str(path), str(armed if path.stem in ARMS else packed)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout


def run_example(name: str, release: Path) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, str(ROOT / "examples" / f"{name}.py"), str(release)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=600,
    )


def test_the_loss_on_hands_works_where_a_grasp_uses_few_contact_points(tmp_path: Path):
    def padded(object_id: str):
        rows = made_rows(object_id)
        rows.batch["contact_index"][::2, :, 1:] = -1
        for name in ("contact_point", "contact_normal", "contact_force"):
            rows.batch[name][::2, :, 1:] = np.nan
        return [rows]

    done = run_example("04_hand_losses", made_release(tmp_path / "release", rows_of=padded))
    assert done.returncode == 0, done.stderr
    assert "nan" not in done.stdout


def test_an_epoch_is_read_of_a_release_without_test_f(lifted: Path):
    done = run_example("01_load_release", lifted)
    assert done.returncode == 0, done.stderr


def test_a_release_without_a_success_is_named_in_one_sentence(tmp_path: Path):
    done = run_example("01_load_release", made_release(tmp_path / "release", tested=False))
    assert done.returncode == 1
    assert "no grasp of its split train has suc_f" in done.stderr
    assert "Traceback" not in done.stderr
