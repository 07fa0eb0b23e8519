"""`bench tables`: the paper's tables of the data synthesis on a library, with intervals.

Every row is a run in a folder of its own, made and tested as `synth` and `validate` do; regions are
measured apart. All of it goes on where it was stopped, and figures are counted from what is there.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bidexdata.errors import BadValue, NotUsable
from bidexdata.kinds import kind_of
from bidexdata.runs import bench_rows
from bidexdata.runs.bench_figures import region_figures, row_figures
from bidexdata.runs.bench_markdown import markdown
from bidexdata.runs.bench_paper import PAPER
from bidexdata.runs.bench_regions import measure_regions
from bidexdata.runs.bench_rows import Row
from bidexdata.runs.bench_speed import noted_in
from bidexdata.runs.chosen import DEFAULT_PROTOCOL
from bidexdata.runs.run import Run
from bidexdata.runs.shards import write_text
from bidexdata.runs.stage import TaskExecution
from bidexdata.runs.synth import SynthRequest, start_run, synth_library
from bidexdata.runs.validate import validate_run

if TYPE_CHECKING:
    from bidexdata.objects.library import Library

VERSION = "1.1"
"""Of the keys of tables.json."""
SIZES_MM = (300, 500, 800)
GRASPS = 5
"""Per scene (paper)."""
JSON_FILE, MARKDOWN_FILE = "tables.json", "tables.md"
REGIONS = "regions"
"""Folder of what is measured of regions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TablesRequest:
    """What `bench tables` was asked for."""

    hand: str = "shadow"
    sizes_mm: tuple[int, ...] = SIZES_MM
    grasps: int = GRASPS
    limit: int | None = None
    """Objects of the library, the first in its order; None: all. May be another in every call."""
    seed: int = 0
    rig: str = ""
    """Name or spec of the rig that grasps on a table are made for and tested with; empty: for none, and
    no test with arms."""

    def __post_init__(self) -> None:
        if self.limit is not None and self.limit < 1:
            raise BadValue(f"--limit {self.limit}: give at least 1")


@dataclass(frozen=True, slots=True)
class TablesReport:
    """What the tables say, where they are, and what went wrong on the way."""

    data: Mapping[str, Any]
    """As in tables.json."""
    json_file: Path
    markdown_file: Path
    failures: tuple[str, ...]
    """One line per stage in which tasks failed; the same command tries them again."""


def make_tables(
    library: str | Path,
    out: str | Path,
    asked: TablesRequest,
    *,
    execution: TaskExecution | None = None,
    rows: Sequence[Row] = (),
    say: Callable[[str], None] = lambda _: None,
) -> TablesReport:
    """Make what is missing of every row, and the tables of what there is.

    Args:
        library: Its folder.
        out: Folder of the rows and the tables.
        asked: What to make.
        execution: Where and how.
        rows: In place of the tables' own.
        say: Takes a line before each stage.

    Raises:
        PathNotFound: There is no library.
        NotUsable: `out` is something else, or the rig cannot carry the hand.
        ConfigConflict: `out` holds rows of another configuration.
    """
    from bidexdata.objects.library import Library

    out, rows = Path(out), tuple(rows) or bench_rows.ROWS
    asked = dataclasses.replace(asked, sizes_mm=tuple(sorted(asked.sizes_mm)))
    requests = {row.name: _request(row, asked) for row in rows}
    opened = Library.open(library)
    _refuse_other(out)
    rig = _rig_name(asked)
    ids = opened.object_ids[: asked.limit]
    how = dataclasses.replace(execution or TaskExecution(), objects=frozenset(ids))
    for row in rows:  # whatever contradicts an earlier call does so before anything is computed
        start_run(opened, out / row.name, requests[row.name])
    failures = []
    for number, row in enumerate(rows, 1):
        say(f"row {number} of {len(rows)}, {row.name}: {row.title}, {row.setting}")
        at = _rig_of(row, asked)
        tests = row.tests(rig)
        failures += _make_row(opened, out / row.name, requests[row.name], at, tests, how)
    say(f"{REGIONS}: Q1 of region pairs")
    failed = measure_regions(opened, ids, asked.sizes_mm, asked.seed, out / REGIONS, how)
    failures += _failed_text(out / REGIONS, failed)
    data = tables(opened, out, asked, rows, ids, rig)
    write_text(out / JSON_FILE, json.dumps(data, indent=1) + "\n")
    write_text(out / MARKDOWN_FILE, markdown(data))
    return TablesReport(data, out / JSON_FILE, out / MARKDOWN_FILE, tuple(failures))


def tables(
    library: Library,
    out: Path,
    asked: TablesRequest,
    rows: Sequence[Row],
    ids: Sequence[str],
    rig: str,
) -> dict[str, Any]:
    """What tables.json holds; docs/tables.md says what its keys are."""
    names = [row.name for row in rows]
    return {
        "version": VERSION,
        "library": {
            "fingerprint": library.fingerprint,
            "objects": len(library.object_ids),
            "object_ids": list(ids),
        },
        "hand": asked.hand,
        "sizes_mm": list(asked.sizes_mm),
        "grasps": asked.grasps,
        "seed": asked.seed,
        "protocol": DEFAULT_PROTOCOL,
        "rig": rig or None,
        "rows": {
            row.name: {
                "title": row.title,
                "says": row.says,
                "setting": row.setting,
                "base": row.base,
                "changes": dict(row.changes),
                "command": row.command(
                    asked.hand, asked.sizes_mm, asked.grasps, asked.seed, _rig_of(row, asked)
                ),
                **row_figures(row, _opened(out / row.name, rig), ids, rig),
            }
            for row in rows
        },
        "table_2": [name for name in bench_rows.TABLE_2 if name in names],
        "table_3": [name for name in bench_rows.TABLE_3 if name in names],
        "regions": region_figures(library, ids, asked.sizes_mm, asked.seed, out / REGIONS),
        "paper": PAPER,
    }


def _refuse_other(out: Path) -> None:
    if out.exists() and (not out.is_dir() or kind_of(out) != "nothing"):
        what = "no folder" if not out.is_dir() else f"a {kind_of(out)}"
        raise NotUsable(f"{out} is {what}; choose another --out for the tables")


def _request(row: Row, asked: TablesRequest) -> SynthRequest:
    return SynthRequest(
        config=row.config(),
        method=row.method,
        preset=row.preset,
        hand=asked.hand,
        sizes_mm=asked.sizes_mm,
        setting=row.setting,
        grasps=asked.grasps,
        seed=asked.seed,
        rig=_rig_of(row, asked),
    )


def _rig_of(row: Row, asked: TablesRequest) -> str:
    """The rig that a row's grasps are made for: arms need a table to stand at."""
    return asked.rig if row.setting == "tabletop" else ""


def _rig_name(asked: TablesRequest) -> str:
    """Name of the rig, which can carry the hand; empty for none.

    Raises:
        NotUsable: It cannot, or there is no such rig or hand.
    """
    if not asked.rig:
        return ""
    from bidexdata.arms import load_rig, mount_robot
    from bidexdata.arms.payload import require_payload
    from bidexdata.hands import load_hands

    robot = mount_robot(load_rig(asked.rig), load_hands(asked.hand))
    require_payload(robot)
    return robot.rig.spec.name


def _opened(path: Path, rig: str) -> Run:
    """A row's run, for the rig where it has motions of its arms."""
    run = Run.open(path)
    return run.for_rig(rig) if rig in run.arm_rigs() else run


def _make_row(
    library: Library,
    run: Path,
    request: SynthRequest,
    rig: str,
    tests: Sequence[str],
    how: TaskExecution,
) -> list[str]:
    """Synthesise, lead arms to and test what is missing of a row."""
    from bidexdata.runs.arms import arms_run
    from bidexdata.validation.protocols import load_protocol

    made = synth_library(library.path, run, request, execution=how, on_task=noted_in(run))
    failures = _failed_text(run, made.failures)
    opened = Run.open(run)
    if opened.done():  # on a table there may be no scene
        if rig:
            failures += _failed_text(run, arms_run(opened, rig, execution=how).failures)
            opened = opened.for_rig(rig)
        tested = validate_run(opened, load_protocol(DEFAULT_PROTOCOL), tests, execution=how)
        for report in tested.values():
            failures += _failed_text(run, report.failures)
    return failures


def _failed_text(folder: Path, failures: Sequence[Any]) -> list[str]:
    if not failures:
        return []
    return [f"{folder}: {len(failures)} of its tasks failed (first: {failures[0].reason})"]
