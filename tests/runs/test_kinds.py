"""What a folder is: every reader gives the same answer, and says what it needs instead."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from bidexdata import Library, Release, Run
from bidexdata.errors import NotUsable, PathNotFound
from bidexdata.kinds import WrongKind, kind_of
from bidexdata.runs.browse import open_browsable
from bidexdata.runs.info import describe

PACKAGE = Path(__file__).resolve().parents[2] / "bidexdata"
FOLDERS = {
    "library": ["index.parquet", "objects/"],
    "run": ["run.json", "tasks.parquet", "synth/"],
    "release": ["manifest.json", "objects/", "objects.parquet"],
    "nothing": ["thesis.tex"],
}
OPEN = {"library": Library.open, "run": Run.open, "release": Release.open}


def make(folder: Path, names: list[str]) -> Path:
    folder.mkdir()
    for name in names:
        (folder / name).mkdir() if name.endswith("/") else (folder / name).touch()
    return folder


@pytest.mark.parametrize("kind", FOLDERS)
def test_a_folder_is_what_the_file_at_its_top_says(tmp_path: Path, kind: str):
    assert kind_of(make(tmp_path / "it", FOLDERS[kind])) == kind


def test_objects_alone_are_an_unfinished_library_and_with_other_things_nothing(tmp_path: Path):
    unfinished = make(tmp_path / "it", ["objects/", ".parts/"])
    assert kind_of(unfinished) == "library"
    with pytest.raises(NotUsable, match="unfinished"):
        Library.open(unfinished)
    (unfinished / "grasps").mkdir()  # a release that lost its manifest
    assert kind_of(unfinished) == "nothing"


@pytest.mark.parametrize("there", FOLDERS)
@pytest.mark.parametrize("wanted", OPEN)
def test_opening_something_else_says_what_it_is_and_what_is_needed(
    tmp_path: Path, there: str, wanted: str
):
    if there == wanted:
        return
    folder = make(tmp_path / "it", FOLDERS[there])
    with pytest.raises(WrongKind) as caught:
        OPEN[wanted](folder)
    said = str(caught.value)
    assert (f"is no {wanted}" if there == "nothing" else f"is a {there}; ") in said
    assert wanted in said
    assert "`bidexdata " in said
    assert caught.value.exit_code == 3


@pytest.mark.parametrize("look", [open_browsable, describe, *OPEN.values()])
def test_nothing_at_all_is_no_such_file(tmp_path: Path, look):
    with pytest.raises(PathNotFound, match=r"nowhere: no such file or folder; expected a "):
        look(tmp_path / "nowhere")


@pytest.mark.parametrize("look", [open_browsable, describe])
def test_readers_of_all_three_name_all_three(tmp_path: Path, look):
    folder = make(tmp_path / "it", FOLDERS["nothing"])
    with pytest.raises(WrongKind, match=r"neither a library .*, a run .* nor a release \("):
        look(folder)


ASKS_BY_ITSELF = {"cli/validate.py"}
"""Files that still look for a top file themselves; the set may only shrink."""


def test_what_knows_runs_asks_kind_of_instead_of_looking_for_top_files():
    for room in ("runs", "viewer", "cli"):
        for path in (PACKAGE / room).glob("*.py"):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            said = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)}
            if f"{room}/{path.name}" not in ASKS_BY_ITSELF:
                assert not said & {"manifest.json", "run.json", "index.parquet"}, path
