"""docs/paper_to_code.md names code that exists, in the files that it names."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "paper_to_code.md"


def _rows() -> list[tuple[str, list[str]]]:
    """(identifiers cell, file patterns) of each table row that names files."""
    rows = []
    above: list[str] = []
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) != 3 or cells[0] in {"paper", "---"}:
            continue
        files = re.findall(r"`([\w/*.]+\.(?:py|yaml))`", cells[2])
        above = files or above
        rows.append((cells[1], above))
    return rows


def _files(pattern: str) -> list[Path]:
    """Of the package; `generation/` stands for the package of that example."""
    model = ROOT / "examples" / "generation" / "bidexgrasp_model"
    top, _, rest = pattern.partition("/")
    return list(model.glob(rest) if top == "generation" else (ROOT / "bidexdata").glob(pattern))


@pytest.mark.parametrize(("cell", "patterns"), _rows(), ids=lambda v: str(v)[:40])
def test_every_name_stands_in_its_file(cell: str, patterns: list[str]):
    files = [f for p in patterns for f in _files(p)]
    assert files, f"no such file: {patterns}"
    text = "\n".join(f.read_text(encoding="utf-8") for f in files)
    named = [n for n in re.findall(r"`([^`]+)`", cell) if not n.endswith(".py")]
    assert named
    for name in named:
        for part in name.strip(".").split("."):
            assert re.search(rf"\b{re.escape(part)}\b", text), f"{name} is not in {patterns}"
