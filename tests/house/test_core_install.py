"""The core alone reads and loads a release: no package of an extra is touched."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

# Modules of the extras are not found, as on a machine where they are not installed.
HIDE = """
import sys
from importlib.machinery import PathFinder

class CoreOnly:
    @staticmethod
    def find_spec(name, path=None, target=None):
        return None if name.split(".")[0] in hidden else PathFinder.find_spec(name, path, target)

release, *hidden = sys.argv[1:]
sys.meta_path[sys.meta_path.index(PathFinder)] = CoreOnly
"""

LOAD = """
from bidexdata import BiDexDataset, Release
grasps = Release.open(release).grasps()
data = BiDexDataset(release, split="train", where="suc_f or not suc_f", points=64)
print(len(grasps), sum(len(item["joints"]) for item in data), len(data))
"""

READ = """
from bidexdata import BiDexDataset, Release
from bidexdata.errors import MissingExtra
print(len(Release.open(release).grasps()))
try:
    BiDexDataset(release)
except MissingExtra as err:
    print(err.package, err)
"""


def modules_of_extras() -> set[str]:
    """Top-level modules that only the extras `synth` and `view` bring."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

    def named(requirements):
        return {re.split(r"[^A-Za-z0-9._-]", r)[0].lower() for r in requirements}

    extras = project["optional-dependencies"]
    wanted = (
        named(extras["synth"] + extras["view"]) - {"bidexdata"} - named(project["dependencies"])
    )
    found = packages_distributions()
    return {
        m for m, names in found.items() if wanted & {n.lower().replace("_", "-") for n in names}
    }


def run(code: str, release: Path, hidden: set[str]) -> list[str]:
    argv = [sys.executable, "-c", HIDE + code, str(release), *sorted(hidden)]
    done = subprocess.run(argv, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_the_core_with_torch_opens_reads_and_iterates_a_release(packed):
    hidden = modules_of_extras()
    assert {"torch", "mujoco", "warp", "trimesh", "scipy", "viser"} <= hidden
    rows, hands, items = map(int, run(LOAD, packed, hidden - {"torch", "torchgen"})[0].split())
    assert rows > items > 0
    assert hands == 2 * items


def test_the_core_without_torch_reads_rows_and_names_the_missing_package(packed):
    rows, error = run(READ, packed, modules_of_extras())
    assert int(rows) > 0
    assert error.startswith("torch ")
    assert error.endswith("pip install torch")
