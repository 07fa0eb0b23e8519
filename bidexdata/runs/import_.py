"""The stage `import`: grasps of another project become a run with a library of its own.

Three passes, each by worker processes: every file is read once (which can be used, of which
object), the objects are made, the rows of each object are written as one shard. `run.json` is
written between the second and the third: it names the library, and the rows' ids depend on it.
A command that was stopped goes on; what is there already and made of the same bytes is kept. From
`run.json` on the library stays what it is: an object that failed is not tried again.
"""

from __future__ import annotations

import dataclasses
import logging
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from bidexdata.config import differing_keys, fingerprint
from bidexdata.errors import BidexError, ConfigConflict, NotUsable, PathNotFound
from bidexdata.kinds import RUN_FILE
from bidexdata.objects.library import Library
from bidexdata.objects.sources.item import UNKNOWN
from bidexdata.objects.storage import read_document
from bidexdata.record import GraspBatch, Status
from bidexdata.record.scene import Setting, setting_of
from bidexdata.runs.import_objects import find_objects, make_objects, read_begun
from bidexdata.runs.import_scan import (
    FILES,
    MEMORY_GIB,
    FileRow,
    read_bounded,
    read_files,
    scan,
    write_files,
)
from bidexdata.runs.logs import log_to
from bidexdata.runs.made_with import package_versions
from bidexdata.runs.plan import Task, read_plan, write_plan
from bidexdata.runs.run import Run, open_unchanged
from bidexdata.runs.run_folder import PLAN_FILE, refuse_foreign
from bidexdata.runs.shards import done_tasks, shard_path, sweep, write_shard
from bidexdata.runs.spec import (
    RunSpec,
    portable_hand,
    read_spec,
    write_spec,
)
from bidexdata.runs.stage import StageReport, TaskExecution, TaskSummary, run_stage
from bidexdata.runs.worker_limits import limit_memory
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.formats.importers.format import Format, ObjectSource, Placed
    from bidexdata.hands.model import Hand

LIBRARY = "library"
"""Folder of an imported run's own library."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportRequest:
    """What `bidexdata import` was asked for."""

    format: str
    path: Path
    """The other project's folder."""
    hand: str = "shadow"
    setting: Setting = "floating"
    objects: Path | None = None
    """Folder of the objects, where they do not lie at their own paths."""
    limit: int | None = None
    """Only the first so many files in byte order of the path."""

    def __post_init__(self) -> None:
        setting_of(self.setting)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportReport:
    """What became of the files."""

    run: Path
    fingerprint: str = ""
    """Of the run; empty when nothing could be imported."""
    files: tuple[FileRow, ...] = ()
    objects: tuple[Mapping[str, Any], ...] = ()
    """Index rows of the library."""
    stage: StageReport = field(default_factory=lambda: StageReport(tasks=0, before=0))
    """Of the last pass."""
    by_status: Mapping[str, int] = field(default_factory=dict)
    """Rows of the run per status; `joint_range` are grasps that our hand cannot take."""
    unknown: tuple[str, ...] = ()
    """What the files do not say, one phrase each."""
    seconds: float = 0.0

    @property
    def failed(self) -> tuple[FileRow, ...]:
        """Files of which nothing could be imported."""
        return tuple(f for f in self.files if f.failed)

    @property
    def rows(self) -> int:
        """Grasps that the files hold and the run takes."""
        return sum(f.rows for f in self.files)

    @property
    def left_out(self) -> int:
        """Grasps of readable files that could not be used."""
        return sum(f.left_out for f in self.files)


def import_run(
    request: ImportRequest, out: str | Path, *, execution: TaskExecution | None = None
) -> ImportReport:
    """Import the grasps below a folder, or go on where an import stopped.

    A file that cannot be used is counted with its reason and never ends the import.

    Args:
        request: What, and how to understand it.
        out: The run.
        execution: Where and how.

    Raises:
        UnknownName: There is no such format or hand.
        PathNotFound: There is no such folder.
        NotUsable: The folder holds no file of the format, the format has no such setting, or the
            hand has other joints.
        ConfigConflict: `out` is a run of something else.
        Contradiction: `out` is this run, and its library is damaged beyond repair.
    """
    from bidexdata.formats.importers import load_format
    from bidexdata.formats.importers.rows import joint_orders

    start, out = time.monotonic(), Path(out)
    execution = execution or TaskExecution()
    form = load_format(request.format)
    names = _file_names(form, request)
    hands = _load_hands(form, request.hand)
    joint_orders(form, hands)
    old = read_spec(out) if (out / RUN_FILE).exists() else None
    if old is None:
        refuse_foreign(out, LIBRARY, "import", "logs", FILES)
    files = scan(form, request.path, names, execution)
    files, sources = find_objects(form, request.path, request.objects, files)
    asked = _asked(form, request, out, files, sources, hands)
    if old is not None:
        _refuse_other(out, old, asked)  # before anything is written into the run's library
    begun = (
        None if old is None else read_begun(out / LIBRARY, _planned(out), old.source_fingerprint)
    )
    files, index = make_objects(form, files, sources, out / LIBRARY, execution, begun)
    if not any(f.rows for f in files):
        taken = {"files": tuple(files), "objects": tuple(index), "unknown": form.unknown}
        return ImportReport(run=out, **taken, seconds=time.monotonic() - start)
    library = Library.open(out / LIBRARY)
    run, tasks = _start(out, asked, files, library, old)
    folder = run.stage_folder("rows")
    sweep([folder])
    stage = run_stage(
        tasks,
        done_tasks(folder),
        partial(_import_task, form.name, str(request.path), str(out), run.fingerprint),
        unit="object imported",
        logs=out / "logs",
        execution=execution,
    )
    return ImportReport(
        run=out,
        fingerprint=run.fingerprint,
        files=tuple(files),
        objects=tuple(index),
        stage=stage,
        by_status=_by_status(run),
        unknown=(*form.unknown, *_unknown_origins(index)),
        seconds=time.monotonic() - start,
    )


def _by_status(run: Run) -> dict[str, int]:
    total: Counter[str] = Counter()
    for batch in run.batches():
        total.update(_counted(batch))
    return dict(sorted(total.items()))


def _unknown_origins(index: Sequence[Mapping[str, Any]]) -> list[str]:
    """Of how many objects nobody stated the licence."""
    made = [r for r in index if r["status"] == Status.OK]
    silent = sum(r["licence"] == UNKNOWN for r in made)
    if not silent:
        return []
    return [f"licence of {silent} of {counted(len(made), 'object')}: an INDEX.csv beside them says"]


def _file_names(form: Format, request: ImportRequest) -> list[str]:
    if not request.path.is_dir():
        raise PathNotFound(request.path, f"a folder of {form.name}")
    if request.objects is not None and not request.objects.is_dir():
        raise PathNotFound(request.objects, "the folder of the objects")
    if request.setting not in form.settings:
        raise NotUsable(
            f"--setting {request.setting}: {form.name} says nothing of the object's pose in the "
            f"world; use {' or '.join(form.settings)}"
        )
    names = form.files(request.path)[: request.limit]
    if not names:
        raise NotUsable(
            f"{request.path} holds no file that the format {form.name} reads; "
            f"expected {form.expected}"
        )
    return names


def _load_hands(form: Format, hand: str) -> tuple[Hand, ...]:
    from bidexdata.hands import load_hand, load_hands

    if len(form.sides) == 2:
        return load_hands(hand)
    if "," in hand:
        raise NotUsable(f"--hand {hand}: {form.name} holds one hand ({form.sides[0]}); name one")
    return (load_hand(hand, cast("Any", form.sides[0])),)


def _asked(
    form: Format,
    request: ImportRequest,
    out: Path,
    files: Sequence[FileRow],
    sources: Mapping[str, ObjectSource],
    hands: Sequence[Hand],
) -> RunSpec:
    """What run.json will say, but for what is known of objects that are made."""
    from bidexdata.formats.importers.stages import made_of

    read = [[f.file, f.sha256, f.object_id] for f in files if not f.failed]
    return RunSpec(
        kind="import",
        config={
            "format": form.name,
            **({"made_stages": made_of()} if form.made_stages else {}),
            "files": len(read),
            "source": fingerprint(read),
            "objects": fingerprint(sorted(s.sha256 for s in sources.values())),
        },
        hand=portable_hand(request.hand, out),
        hands=tuple(h.header() for h in hands),
        setting=request.setting,
        source=LIBRARY,
        versions=package_versions(),
    )


def _refuse_other(out: Path, old: RunSpec, asked: RunSpec) -> None:
    made = {"sizes_mm": old.sizes_mm, "source_fingerprint": old.source_fingerprint}
    wanted = dataclasses.replace(asked, **made)
    differing = differing_keys(old.identity(), wanted.identity())
    if differing:
        raise ConfigConflict(out, differing)


def _planned(out: Path) -> set[str] | None:
    """Objects of the plan; None where it is gone or damaged."""
    try:
        return {task.object_id for task in read_plan(out / PLAN_FILE)}
    except BidexError:
        return None


def _start(
    out: Path, asked: RunSpec, files: Sequence[FileRow], library: Library, old: RunSpec | None
) -> tuple[Run, list[Task]]:
    """Write the plan, the list of files and run.json, or check that they are those of before."""
    tasks, sizes = _plan(files, library, asked.setting)
    spec = dataclasses.replace(asked, sizes_mm=tuple(sizes), source_fingerprint=library.fingerprint)
    if old is not None:
        differing = differing_keys(old.identity(), spec.identity())
        if differing:
            raise ConfigConflict(out, differing)
    write_files(out / FILES, files)
    if old is None or not (out / PLAN_FILE).is_file():
        write_plan(out / PLAN_FILE, tasks)
    if old is None:
        write_spec(out, spec)  # last: a killed start starts again
    return Run(out, old or spec), tasks


def _plan(
    files: Sequence[FileRow], library: Library, setting: Setting
) -> tuple[list[Task], list[int]]:
    """One task per object, with its scenes; and all sizes."""
    from bidexdata.formats.importers.rows import scenes_of

    places: dict[str, list[Placed]] = {}
    for file in files:
        if not file.failed:
            places.setdefault(file.object_id, []).extend(file.places)
    tasks, sizes = [], set()
    for object_id in sorted(places):
        provenance = read_document(library.folder(object_id))["provenance"]
        unit = float(provenance["unit_in_file"])
        scenes = scenes_of(object_id, unit, places[object_id], setting)
        ids = tuple(dict.fromkeys(s.scene_id for s in scenes))
        tasks.append(Task(fingerprint([object_id, ids, 0]), object_id, ids, 0))
        sizes |= {s.size_mm for s in scenes}
    return tasks, sorted(sizes)


def _import_task(
    form_name: str, root: str, run_path: str, run_fingerprint: str, task: Task
) -> TaskSummary:
    """Write the rows of one object."""
    from bidexdata.formats.importers import load_format
    from bidexdata.formats.importers.rows import record_rows

    limit_memory(MEMORY_GIB)
    run, form = open_unchanged(run_path, run_fingerprint), load_format(form_name)
    log_to(run.path / "logs")
    files = [f for f in read_files(run.path, task.object_id) if not f.failed]
    parts = []
    for file, (sha256, grasps) in zip(
        files, read_bounded(form_name, root, [f.file for f in files]), strict=True
    ):
        if sha256 != file.sha256:
            raise NotUsable(f"{file.file} changed while it was being imported; import it again")
        parts.append((file.file, grasps))
    batch = record_rows(
        parts,
        run.load_solid(task.object_id),
        run.hands(),
        form,
        setting=run.spec.setting,
        run_fingerprint=run.fingerprint,
        fingerprints={
            "run": run.fingerprint,
            "library": run.spec.source_fingerprint,
            "import": fingerprint(run.spec.config),
        },
        version=package_versions()["bidexdata"],
    )
    path = shard_path(run.stage_folder("rows"), task.task_id)
    write_shard(path, batch.to_arrow(), run.fingerprint)
    logging.getLogger(__name__).info("task %s: %d rows", task.task_id, len(batch))
    return TaskSummary(len(batch), len(batch), _counted(batch))


def _counted(batch: GraspBatch) -> dict[str, int]:
    """Rows per label of their status."""
    found, counts = np.unique(batch["synth_status"], return_counts=True)
    return {Status(s).label: int(n) for s, n in zip(found, counts, strict=True)}
