"""The demo: its stages in order, each announced and timed; a second time it goes on."""

from __future__ import annotations

from pathlib import Path

import pytest

from bidexdata.errors import NotUsable
from bidexdata.formats.release import Release
from bidexdata.kinds import RUN_FILE
from bidexdata.runs.demo import NAME, Demo, run_demo, stages_of
from bidexdata.runs.stage import TaskExecution

INLINE = TaskExecution(executor="inline", quiet=True)
STAGES = ["prepare", "synth", "validate", "pack", "render"]


def shards(folder: Path) -> dict[Path, int]:
    return {p: p.stat().st_mtime_ns for p in folder.rglob("*.arrow")}


def test_a_folder_that_is_something_else_is_left_alone(tmp_path: Path):
    (tmp_path / RUN_FILE).write_text("{}")
    with pytest.raises(NotUsable, match="is a run; choose another --out"):
        run_demo(tmp_path, execution=INLINE)
    assert [p.name for p in tmp_path.iterdir()] == [RUN_FILE]


def test_the_stages_are_said_in_order_and_finished_parts_stay(tmp_path: Path):
    said: list[str] = []
    small = {"execution": INLINE, "sources": "shapes:box", "sizes_mm": (300,), "grasps": 1}
    first = run_demo(tmp_path, **small, say=said.append)
    demo = Demo(tmp_path, INLINE, 1, "shapes:box", (300,))
    assert said == [stage.sentence for stage in stages_of(demo)]
    assert list(first.seconds) == STAGES
    assert (first.objects, first.figures["objects"]) == (1, 1)
    assert Release.open(demo.release).name == NAME
    assert first.sheet.is_file()

    before = shards(demo.run)
    assert len(before) == 2
    (demo.release / "stray.txt").write_text("x")
    second = run_demo(tmp_path, **small)
    assert shards(demo.run) == before
    assert second.figures == first.figures
    assert not (demo.release / "stray.txt").exists()  # packed anew
