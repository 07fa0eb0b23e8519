"""The generation example stands outside: it uses public names, and the package knows nothing of it."""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path

import pytest

import bidexdata

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "generation"
FILES = sorted(EXAMPLE.rglob("*.py"))
DOORS = ("bidexdata", "bidexdata.loaders")
"""Modules that it may import from: their names are documented."""


def _public(door: str) -> set[str]:
    if door == "bidexdata":
        return set(dir(bidexdata))
    module = import_module(door)
    tree = ast.parse(Path(str(module.__file__)).read_text("utf-8"))
    # `import x as x` marks a re-export, also those that only type checkers run.
    imports = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    return {a.asname for n in imports for a in n.names if a.asname == a.name}


def _imports(path: Path) -> list[tuple[str, str]]:
    found = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found += [(node.module, alias.name) for alias in node.names]
        elif isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
    return found


def test_there_is_an_example_to_look_at():
    assert EXAMPLE / "bidexgrasp_model" / "model.py" in FILES


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_it_imports_public_names_alone(path: Path):
    for module, name in _imports(path):
        if module.split(".")[0] == "bidexdata":
            assert module in DOORS, f"{path.name} imports {module}, which is not public"
            assert not name or name in _public(module), f"{path.name}: {module} exports no {name}"


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_it_reaches_for_no_private_attribute_of_the_package(path: Path):
    tree = ast.parse(path.read_text("utf-8"))
    named = {a.asname or a.name for n in ast.walk(tree)
             if isinstance(n, ast.ImportFrom) and (n.module or "").startswith("bidexdata")
             for a in n.names}  # fmt: skip
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            private = node.attr.startswith("_") and not node.attr.startswith("__")
            assert not (private and node.value.id in named), f"{path.name}: {node.attr}"


def test_the_package_imports_nothing_of_it():
    for path in sorted((ROOT / "bidexdata").rglob("*.py")):
        for module, _ in _imports(path):
            assert module.split(".")[0] not in ("bidexgrasp_model", "examples"), path.name
