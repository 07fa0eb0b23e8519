"""The core alone reads and loads a release: no package of an extra is touched."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Set
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions
from pathlib import Path

import pytest
from made_release import made_release

from bidexdata.extras import EXTRA_OF, missing_extra
from bidexdata.hands import load_hands

ROOT = Path(__file__).resolve().parents[2]

# Modules of the extras are not found, as on a machine where they are not installed.
HIDE = """
import sys
from importlib.machinery import PathFinder

class CoreOnly(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
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


NAMES = """
import bidexdata
from bidexdata.errors import MissingExtra
for name in bidexdata._PUBLIC:
    try:
        getattr(bidexdata, name)
    except MissingExtra as err:
        print(name, err.package, err.extra)
"""

COMMAND = """
import shlex
from bidexdata.cli.main import run
sys.exit(run(shlex.split(release)))
"""


def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def named(requirements) -> set[str]:
    """Packages of some requirements, without versions, in lower case."""
    return {re.split(r"[^A-Za-z0-9._-]", r)[0].lower() for r in requirements}


@cache
def modules_of_extras() -> frozenset[str]:
    """Top-level modules that only the extras `synth` and `view` bring."""
    extras = project()["optional-dependencies"]
    wanted = (
        named(extras["synth"] + extras["view"]) - {"bidexdata"} - named(project()["dependencies"])
    )
    found = packages_distributions()
    return frozenset(
        m for m, names in found.items() if wanted & {n.lower().replace("_", "-") for n in names}
    )


def started(code: str, argument: str | Path, hidden: Set[str]) -> subprocess.CompletedProcess[str]:
    argv = [sys.executable, "-c", HIDE + code, str(argument), *sorted(hidden)]
    return subprocess.run(argv, capture_output=True, text=True, check=False, cwd=ROOT)


def run(code: str, release: Path, hidden: Set[str]) -> list[str]:
    done = started(code, release, hidden)
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


def test_every_extra_has_its_modules_in_the_table_and_none_has_others():
    extras = project()["optional-dependencies"]
    brought = {name: named(extras[name]) - {"bidexdata"} for name in extras if name != "all"}
    del brought["dev"]
    said: dict[str, set[str]] = {name: set() for name in brought}
    for package, extra in EXTRA_OF.values():
        said[extra].add(package.lower())
    assert said == brought
    found = packages_distributions()
    for module, (package, _) in EXTRA_OF.items():
        if module in found:
            assert package.lower() in {n.lower().replace("_", "-") for n in found[module]}


def test_the_extras_of_the_specification_are_there_and_all_has_them():
    extras = project()["optional-dependencies"]
    assert {"synth", "view", "publish", "ray", "all"} <= set(extras)
    (whole,) = extras["all"]
    assert {"synth", "view", "publish", "ray"} <= set(re.split(r"[\[\],]", whole))
    light = {"h5py", "jaxtyping", "numpy", "pyarrow", "pyyaml", "typer"}
    assert named(project()["dependencies"]) == light


def test_every_import_of_the_package_is_of_the_core_or_in_the_table():
    core = {"h5py", "jaxtyping", "numpy", "pyarrow", "yaml", "typer"}
    alone = {"tensordict"}  # no extra brings it; who asks for it is told so
    known = core | alone | set(EXTRA_OF) | set(sys.stdlib_module_names) | {"bidexdata"}
    for path in (ROOT / "bidexdata").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            assert {n.partition(".")[0] for n in names} <= known, path


def test_a_public_name_without_its_package_names_the_extra(packed):
    lines = [line.split(" ") for line in run(NAMES, packed, modules_of_extras())]
    told = {name: (package, extra) for name, package, extra in lines}
    assert told["HandModel"] == ("torch", "synth")
    assert {extra for _, extra in told.values()} == {"synth"}
    assert not {"BiDexDataset", "GraspBatch", "Library", "Release", "Run"} & set(told)


@pytest.fixture(scope="module")
def real(tmp_path_factory) -> Path:
    """A release of hands that the registry knows."""
    out = tmp_path_factory.mktemp("real") / "release"
    return made_release(out, hands=load_hands("capsule"))


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [
        ("prepare shapes --limit 1 --out {out}/library", "synth"),
        ("validate {release} --out {out}/again", "synth"),
        ("view {release}", "view"),
        ("view {release} --export 0 --out {out}/grasp.html", "view"),
        ("render {release} --out {out}/sheet.png", "synth"),
        ("hands check capsule", "synth"),
        ("verify {release} --full", "synth"),
        ("demo --out {out}/demo", "synth"),
    ],
)
def test_a_command_without_its_packages_names_the_extra(real, tmp_path, arguments, extra):
    line = arguments.format(release=real, out=tmp_path)
    done = started(COMMAND, line, modules_of_extras())
    assert (done.returncode, done.stdout) == (3, ""), done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("error: ")
    assert last.endswith(f"pip install 'bidexdata[{extra}]'")


@pytest.mark.parametrize("arguments", ["info {release}", "verify {release}", "table {release} --out {out}/t.csv"])  # fmt: skip
def test_what_reads_a_release_needs_the_core_alone(packed, tmp_path, arguments):
    line = arguments.format(release=packed, out=tmp_path)
    done = started(COMMAND, line, modules_of_extras())
    assert done.returncode == 0, done.stderr


def test_a_version_of_a_package_that_is_not_there_names_the_extra_too():
    assert str(missing_extra(PackageNotFoundError("warp-lang"))).endswith("'bidexdata[synth]'")
    assert (
        missing_extra(ModuleNotFoundError("no such thing", name="warp.fem")).package == "warp-lang"
    )
    assert missing_extra(ModuleNotFoundError("no such thing", name="nothing")) is None
    assert missing_extra(ValueError("warp")) is None
