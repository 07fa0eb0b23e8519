"""The stage `import`: grasps of another project become a run with a library of its own.

Three passes, each by worker processes: every file is read once (which can be used, of which
object), the objects are made, the rows of each object are written as one shard. `run.json` is
written between the second and the third: it names the library, and the rows' ids depend on it.
A command that was stopped goes on; what is there already and made of the same bytes is kept. From
`run.json` on the library stays what it is: an object that failed is not tried again.
"""

from __future__ import annotations

import logging
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from bidexdata.config import fingerprint
from bidexdata.errors import NotUsable, PathNotFound
from bidexdata.kinds import RUN_FILE
from bidexdata.objects.library import Library
from bidexdata.runs.import_objects import find_objects, make_objects, read_begun
from bidexdata.runs.import_plan import (
    LIBRARY,
    ImportRequest,
    asked_spec,
    planned_objects,
    refuse_other,
    start_run,
)
from bidexdata.runs.import_report import (
    ImportReport,
    by_status,
    counted_by_status,
    unknown_origins,
)
from bidexdata.runs.import_scan import FILES, MEMORY_GIB, read_bounded, read_files, scan
from bidexdata.runs.logs import log_to
from bidexdata.runs.made_with import package_versions
from bidexdata.runs.plan import Task
from bidexdata.runs.run import open_unchanged
from bidexdata.runs.run_folder import refuse_foreign
from bidexdata.runs.shards import done_tasks, shard_path, sweep, write_shard
from bidexdata.runs.spec import read_spec
from bidexdata.runs.stage import TaskExecution, TaskSummary, run_stage
from bidexdata.runs.worker_limits import limit_memory

if TYPE_CHECKING:
    from bidexdata.formats.importers.format import Format
    from bidexdata.hands.model import Hand


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
    asked = asked_spec(form, request, out, files, sources, hands)
    if old is not None:
        refuse_other(out, old, asked)  # before anything is written into the run's library
    begun = (
        None
        if old is None
        else read_begun(out / LIBRARY, planned_objects(out), old.source_fingerprint)
    )
    files, index = make_objects(form, files, sources, out / LIBRARY, execution, begun)
    if not any(f.rows for f in files):
        taken = {"files": tuple(files), "objects": tuple(index), "unknown": form.unknown}
        return ImportReport(run=out, **taken, seconds=time.monotonic() - start)
    library = Library.open(out / LIBRARY)
    run, tasks = start_run(out, asked, files, library, old)
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
        by_status=by_status(run),
        unknown=(*form.unknown, *unknown_origins(index)),
        seconds=time.monotonic() - start,
    )


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
    return TaskSummary(len(batch), len(batch), counted_by_status(batch))
