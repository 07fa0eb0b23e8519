"""What goes to the package index: the package with its data once, and nothing beside it."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
FACES = ("cli", "formats", "loaders", "viewer", "DATASET_CARD.md")
"""Links at the root of the checkout; what they point to lies in the package."""


def files_under(*folders: str) -> set[str]:
    paths = (p for folder in folders for p in (ROOT / folder).rglob("*"))
    return {
        p.relative_to(ROOT).as_posix()
        for p in paths
        if p.is_file() and not {"__pycache__", "results", "MUJOCO_LOG.TXT"} & set(p.parts)
    }


def test_the_licence_is_named_once():
    # PEP 639: an index refuses a licence classifier beside the SPDX expression.
    assert PROJECT["license"] == "Apache-2.0"
    assert not [c for c in PROJECT["classifiers"] if c.startswith("License ::")]
    assert (ROOT / "bidexdata" / "py.typed").is_file()


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> tuple[Path, Path]:
    """The source distribution, and the wheel that is built from it."""
    out = tmp_path_factory.mktemp("dist")
    done = subprocess.run(
        [sys.executable, "-m", "build", "--outdir", str(out), str(ROOT)],
        capture_output=True,
        text=True,
        check=False,
    )
    said = done.stdout + done.stderr
    if done.returncode and "No matching distribution found for hatchling" in said:
        pytest.skip("needs a package index, from which `build` installs hatchling")
    assert done.returncode == 0, said
    return next(out.glob("*.tar.gz")), next(out.glob("*.whl"))


@pytest.mark.slow
def test_the_wheel_is_the_package_and_its_data(built):
    with zipfile.ZipFile(built[1]) as wheel:
        names = [n for n in wheel.namelist() if ".dist-info/" not in n]
        metadata = next(n for n in wheel.namelist() if n.endswith(".dist-info/METADATA"))
        text = wheel.read(metadata).decode()
    assert sorted(names) == sorted(files_under("bidexdata"))
    assert {
        "bidexdata/py.typed",
        "bidexdata/formats/dataset_card.md",
        "bidexdata/hands/specs/LICENSE",
        "bidexdata/hands/specs/allegro.yaml",
        "bidexdata/hands/specs/capsule.yaml",
        "bidexdata/hands/specs/capsule_links.yaml",
        "bidexdata/hands/specs/leap.yaml",
        "bidexdata/hands/specs/shadow.yaml",
    } <= set(names)
    assert "License-Expression: Apache-2.0" in text


@pytest.mark.slow
def test_the_source_distribution_holds_every_file_once_and_no_links(built):
    with tarfile.open(built[0]) as archive:
        members = archive.getmembers()
    assert not [m.name for m in members if m.issym() or m.islnk()]
    names = [m.name.split("/", 1)[1] for m in members if m.isfile()]
    assert len(set(names)) == len(names)
    folders = ("bidexdata", "benchmarks", "docs", "examples", "tests", "typings")
    assert files_under(*folders) <= set(names)
    assert {"LICENSE", "README.md", "pyproject.toml", "Makefile", "constraints.txt"} <= set(names)
    assert not [n for n in names if n.split("/", maxsplit=1)[0] in FACES]
