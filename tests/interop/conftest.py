import subprocess
import sys
from pathlib import Path

import pytest
from made_release import made_release

from bidexdata.formats.citation import About


def _environment(folder: Path, *packages: str) -> Path:
    """The interpreter of a new virtual environment with packages; skips without an index."""
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    python = folder / "bin" / "python"
    install = [str(python), "-m", "pip", "install", "--quiet", "--no-compile", *packages]
    done = subprocess.run(install, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"needs a package index: {done.stderr.strip().splitlines()[-1]}")
    return python


@pytest.fixture(scope="session")
def readers(tmp_path_factory) -> Path:
    """An interpreter with other people's readers and nothing of ours."""
    packages = ("datasets", "duckdb", "polars", "pandas", "mlcroissant", "huggingface_hub")
    return _environment(tmp_path_factory.mktemp("readers") / "env", *packages)


@pytest.fixture(scope="session")
def cff(tmp_path_factory) -> Path:
    """An interpreter with cffconvert, whose dependencies are too old for the others."""
    return _environment(tmp_path_factory.mktemp("cff") / "env", "cffconvert", "setuptools")


@pytest.fixture(scope="session")
def published(tmp_path_factory) -> Path:
    """A made release with all that a person may say of it."""
    about = About(
        authors=("Curie, Marie", "Radium Institute"), date="2026-01-31", url="https://example.org/x"
    )
    return made_release(tmp_path_factory.mktemp("published") / "release", about=about)
