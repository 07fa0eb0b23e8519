"""What comments and pages cite is in the project."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MEASUREMENTS = (ROOT / "docs" / "measurements.md").read_text(encoding="utf-8")
# Put together here, so that this file may name them.
NOT_HERE = [re.compile(r"\bfacts" + r"(/| on )"), re.compile(r"\bDESIGN" + r"\b")]
CITED = re.compile(r"\bmeasurements(?:\.md)?,\s+(\d+)(?:\s+and\s+(\d+))?", re.IGNORECASE)


def _texts() -> list[Path]:
    named = [p for f in ("bidexdata", "benchmarks", "docs", "examples") for p in _in(f)]
    return sorted({*named, *_in("tests"), *ROOT.glob("*.md")} - {Path(__file__).resolve()})


def _in(folder: str) -> list[Path]:
    found = (ROOT / folder).rglob("*")
    return [p for p in found if p.suffix in {".py", ".md", ".yaml", ".toml"} and p.is_file()]


@pytest.mark.parametrize("path", _texts(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_no_file_cites_a_document_that_is_not_in_the_project(path: Path):
    text = path.read_text(encoding="utf-8")
    for pattern in NOT_HERE:
        assert not pattern.search(text), f"{path.name} cites {pattern.pattern}"


def test_every_cited_section_of_the_measurements_exists():
    sections = set(re.findall(r"^## (\d+)\. ", MEASUREMENTS, re.MULTILINE))
    # Line breaks and the indent or comment sign after them may fall inside a citation.
    code = {p: re.sub(r"\n[ #]*", " ", p.read_text(encoding="utf-8")) for p in _in("bidexdata")}
    cited = {(n, p.name) for p, t in code.items() for m in CITED.findall(t) for n in m if n}
    assert len(cited) > 10
    assert not {c for c in cited if c[0] not in sections}
