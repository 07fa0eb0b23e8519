"""The second pass of an import: the objects of the files become a library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bidexdata.config import to_plain
from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.library import object_folder, write_index
from bidexdata.objects.storage import read_document, write_object
from bidexdata.record import Status
from bidexdata.runs.executors import TaskFailure, run_tasks
from bidexdata.runs.import_scan import MEMORY_GIB, FileRow
from bidexdata.runs.object_folders import index_columns, made_columns, remove_partials
from bidexdata.runs.progress import Progress
from bidexdata.runs.stage import TaskExecution
from bidexdata.runs.worker_limits import limit_memory

if TYPE_CHECKING:
    from bidexdata.formats.importers.format import Format, ObjectSource


def find_objects(
    form: Format, root: Path, objects: Path | None, files: Sequence[FileRow]
) -> tuple[list[FileRow], dict[str, ObjectSource]]:
    """Find the object of every file; files without one fail."""
    from bidexdata.formats.importers.format import BadFile

    found: dict[str, tuple[str, str]] = {}  # name -> object_id, reason
    sources: dict[str, ObjectSource] = {}
    kept = []
    for file in files:
        name = file.object_name
        if not file.failed and name not in found:
            try:
                source = form.find_object(name, root, objects)
                found[name] = source.object_id, ""
                sources.setdefault(source.object_id, source)
            except BadFile as bad:
                found[name] = "", bad.reason
        object_id, reason = ("", "") if file.failed else found[name]
        kept.append(file.refused(reason) if reason else file._replace(object_id=object_id))
    return kept, sources


def make_objects(
    form: Format,
    files: Sequence[FileRow],
    sources: Mapping[str, ObjectSource],
    library: Path,
    execution: TaskExecution,
) -> tuple[list[FileRow], list[dict[str, Any]]]:
    """Make the objects that are not there yet, and the library's index; files without one fail."""
    ids = sorted(sources)
    remove_partials(library)
    folders, config = {i: library / object_folder(i) for i in ids}, _config()
    missing = [i for i in ids if made_columns(folders[i], sources[i].sha256, config=config) is None]
    failures: dict[str, tuple[Status, str]] = {}
    work = partial(_make_object, form.name, str(library))
    how: dict[str, Any] = {"executor": execution.executor, "workers": execution.workers}
    before = len(ids) - len(missing)
    with Progress(len(ids), "object made", quiet=execution.quiet, already=before) as progress:
        for source, result in run_tasks([sources[i] for i in missing], work, **how):
            crashed = isinstance(result, TaskFailure)
            failure = (Status.CRASHED, result.reason) if crashed else result
            if failure is not None:
                failures[source.object_id] = failure
                progress.write(f"object {source.name}: {failure[1]}")
            progress.advance(note=source.name)
    index = [_index_row(folders[i], sources[i], failures.get(i)) for i in ids]
    if index:
        write_index(library, index, config)
    reasons = {i: f"its object failed: {reason}" for i, (_, reason) in failures.items()}
    kept = [
        f.refused(reasons[f.object_id]) if f.object_id in reasons and not f.failed else f
        for f in files
    ]
    return kept, index


def _make_object(form_name: str, library: str, source: ObjectSource) -> tuple[Status, str] | None:
    """Make one object and write its folder: the work of a task. None: it worked."""
    from bidexdata.formats.importers import load_format
    from bidexdata.formats.importers.format import BadFile

    limit_memory(MEMORY_GIB)
    try:
        obj = load_format(form_name).load_object(source, PrepareConfig())
    except PrepareFailure as failure:
        return failure.status, failure.reason
    except BadFile as bad:
        return Status.UNREADABLE, bad.reason
    except MemoryError:
        return Status.TOO_COMPLEX, f"needs more than {MEMORY_GIB:g} GiB"
    write_object(Path(library) / object_folder(source.object_id), obj, _config())
    return None


def _config() -> dict[str, Any]:
    """The configuration that decides an object's bytes."""
    plain = to_plain(PrepareConfig())
    return {name: plain[name] for name in ("load", "surface", "sdf", "rest")}


def _index_row(
    folder: Path, source: ObjectSource, failure: tuple[Status, str] | None
) -> dict[str, Any]:
    status, reason = failure or (Status.OK, "")
    row: dict[str, Any] = {
        "source_name": source.name,
        "object_id": source.object_id,
        "status": int(status),
        "status_label": status.label,
        "reason": reason and f"{status.sentence}: {reason}",
        "source_sha256": source.sha256,
        "source_bytes": source.bytes,
        "warnings": [],
    }
    if failure is not None:
        return row
    known = read_document(folder)["provenance"]
    origin = {name: known[name] for name in ("source", "licence", "author", "category")}
    return {**row, **origin, **index_columns(folder)}
