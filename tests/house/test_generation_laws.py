"""The generation example keeps its own laws, can be installed alone, and names what it needs."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "generation"
PACKAGE = EXAMPLE / "bidexgrasp_model"
PROJECT = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LARGEST = 400


def run(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join(map(str, (ROOT, EXAMPLE)))
    return subprocess.run(
        [str(c) for c in command],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": paths},
        timeout=1800,
    )


@pytest.mark.parametrize(
    "marked", ["not slow", pytest.param("slow", marks=pytest.mark.slow)], ids=["quick", "slow"]
)
def test_the_laws_of_the_example_hold(marked: str):
    """In a process of its own: they have fixtures and run-time checks of their own."""
    done = run(sys.executable, "-m", "pytest", "-m", marked, "-p", "no:cacheprovider", cwd=EXAMPLE)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]


def test_its_project_names_every_package_that_it_imports():
    required = {re.split(r"[\[<>=~! ]", d)[0] for d in PROJECT["dependencies"]}
    for path in PACKAGE.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module]
            tops = {n.split(".")[0] for n in names} - {*sys.stdlib_module_names, PACKAGE.name}
            assert tops <= required, f"{path.name} imports {tops - required}"


@pytest.mark.parametrize("path", sorted(PACKAGE.glob("*.py")), ids=lambda p: p.name)
def test_each_file_has_one_idea_and_a_sentence_that_says_it(path: Path):
    text = path.read_text("utf-8")
    assert len(text.splitlines()) <= LARGEST
    assert ast.get_docstring(ast.parse(text))
    named = path.name.startswith("__") or f"`{path.name}`" in (EXAMPLE / "README.md").read_text(
        "utf-8"
    )
    assert named, f"README.md does not say what {path.name} is"


@pytest.mark.slow
def test_it_is_installed_from_its_own_project(tmp_path: Path):
    done = run(
        sys.executable, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", tmp_path, EXAMPLE,
        cwd=tmp_path,
    )  # fmt: skip
    said = done.stdout + done.stderr
    if done.returncode and "No matching distribution found for hatchling" in said:
        pytest.skip("needs a package index, from which pip installs hatchling")
    assert done.returncode == 0, said
    (wheel,) = tmp_path.glob("bidexgrasp_model-*.whl")
    with zipfile.ZipFile(wheel) as packed:
        names = {n for n in packed.namelist() if ".dist-info/" not in n}
        (entry,) = (n for n in packed.namelist() if n.endswith("entry_points.txt"))
        assert "bidexgrasp-model = bidexgrasp_model.cli:main" in packed.read(entry).decode()
    assert names == {f"{PACKAGE.name}/{p.name}" for p in PACKAGE.glob("*.py")}
    target = tmp_path / "site"
    done = run(
        sys.executable, "-m", "pip", "install", "--no-deps", "--target", target, wheel, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert (target / "bin" / "bidexgrasp-model").is_file()
