"""Every example runs as a user would run it, and asserts what it shows."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

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
