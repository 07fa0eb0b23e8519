"""The house: imports run one way, the links resolve, importing the package is light."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "bidexdata"

# __main__ -> cli -> viewer -> runs -> loaders, formats -> synthesis | validation -> arms -> pictures
# -> simulation -> objects, hands -> wrench, record -> frames, errors, extras, config, devices,
# engine_log, kinds, temporaries, wording.
# Rooms on one floor do not import each other, but for the pairs in SAME_FLOOR.
FLOORS = [
    {
        *("frames", "errors", "extras", "config", "devices", "engine_log", "kinds", "temporaries"),
        *("wording", "yaml_lines"),
    },
    {"wrench", "record"},
    {"objects", "hands"},
    {"simulation"},
    {"pictures"},
    {"arms"},
    {"synthesis", "validation"},
    {"loaders", "formats"},
    {"runs"},
    {"viewer"},
    {"cli"},
    {"__main__"},
]
SAME_FLOOR = {
    ("config", "errors"),
    ("config", "yaml_lines"),
    ("yaml_lines", "errors"),
    ("devices", "errors"),
    ("extras", "errors"),
    ("kinds", "errors"),
    ("loaders", "formats"),
}
FLOOR_OF = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}


def _imports_of(path: Path) -> set[str]:
    """Rooms that a file imports, at its top or inside a function."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names = [node.module] if node.module != "bidexdata" else []
            names += [
                f"bidexdata.{a.name}"
                for a in node.names
                if node.module == "bidexdata" and a.name != "__version__"
            ]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        found |= {n.split(".")[1] for n in names if n.startswith("bidexdata.")}
    return found


def _files() -> list[Path]:
    return sorted(p for p in PACKAGE.rglob("*.py") if p != PACKAGE / "__init__.py")


@pytest.mark.parametrize("path", _files(), ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_imports_run_downstairs(path: Path):
    room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    assert room in FLOOR_OF, f"{room} has no floor in the house"
    for other in _imports_of(path) - {room}:
        down = FLOOR_OF[other] < FLOOR_OF[room] or (room, other) in SAME_FLOOR
        assert down, f"{path.name} ({room}) imports {other}, which is not below it"


@pytest.mark.parametrize("name", ["cli", "formats", "loaders", "viewer"])
def test_the_four_faces_are_relative_links_into_the_package(name: str):
    link = ROOT / name
    assert link.is_symlink()
    assert not Path(link.readlink()).is_absolute()
    assert link.resolve() == (PACKAGE / name).resolve()
    assert (link / "__init__.py").is_file()


def test_importing_the_package_loads_nothing_heavy():
    heavy = ["torch", "warp", "mujoco", "trimesh", "viser", "pyarrow", "scipy", "h5py"]
    code = f"import sys, bidexdata; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_kernels_live_in_files_that_type_checkers_skip():
    for path in _files():
        text = path.read_text(encoding="utf-8")
        if "@wp.kernel" in text or "@wp.func" in text:
            assert path.stem.endswith("_kernels"), path


def test_tests_import_no_private_name_of_the_package():
    for path in sorted((ROOT / "tests").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bidexdata"):
                private = [a.name for a in node.names if a.name.startswith("_")]
                assert private in ([], ["__version__"]), f"{path.name} imports {private}"
