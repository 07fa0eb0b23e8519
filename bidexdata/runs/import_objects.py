"""The second pass of an import: the objects of the files become a library."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bidexdata.config import to_plain
from bidexdata.errors import BidexError, Contradiction, NotUsable
from bidexdata.objects.config import PrepareConfig
from bidexdata.objects.failure import PrepareFailure
from bidexdata.objects.library import Library, library_fingerprint, object_folder, write_index
from bidexdata.objects.storage import read_document, write_object
from bidexdata.record import Status
from bidexdata.runs.executors import TaskFailure, run_tasks
from bidexdata.runs.import_scan import MEMORY_GIB, FileRow
from bidexdata.runs.left_out import reason_row
from bidexdata.runs.object_folders import index_columns, made_columns, remove_partials
from bidexdata.runs.prepare_parts import Row
from bidexdata.runs.progress import Progress
from bidexdata.runs.stage import TaskExecution
from bidexdata.runs.task_failures import failure_row, log_raised
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


class Begun(NamedTuple):
    """What a run that has begun knows of its library, which must stay what it was."""

    objects: frozenset[str]
    """Those of the plan: no other may come into the library."""
    fingerprint: str
    """Of the library."""
    rows: Mapping[str, Mapping[str, Any]]
    """Of its index by object; none where that is gone, damaged or another."""


def read_begun(library: Path, planned: Iterable[str] | None, known: str) -> Begun:
    """Look at the library of a run that has begun.

    Args:
        library: Its folder.
        planned: Objects of the run's plan; those of the index where there is no plan any more.
        known: The fingerprint that the run has of the library.

    Raises:
        Contradiction: Neither plan nor index says which objects the run has.
    """
    rows: dict[str, Mapping[str, Any]] = {}
    with contextlib.suppress(BidexError):  # written anew, if the objects are still the same
        index = Library.open(library)
        if index.fingerprint == known:
            rows = {r["object_id"]: r for r in index.index.to_pylist()}
    if planned is None and not rows:
        raise Contradiction(
            f"{library.parent}: its plan and the index of its library are damaged or gone; "
            "import into another --out"
        )
    made = (i for i, row in rows.items() if row["status"] == Status.OK)
    return Begun(frozenset(made if planned is None else planned), known, rows)


def make_objects(
    form: Format,
    files: Sequence[FileRow],
    sources: Mapping[str, ObjectSource],
    library: Path,
    execution: TaskExecution,
    begun: Begun | None = None,
) -> tuple[list[FileRow], list[dict[str, Any]]]:
    """Make the objects that are not there yet, and the library's index; files without one fail.

    The library of a run that has begun gets no object more: what failed then stays a failure.

    Raises:
        NotUsable: An object of a run that has begun is gone and cannot be made again just now.
        Contradiction: What was made again is not what it was.
    """
    ids = sorted(sources)
    remove_partials(library)
    folders, config = {i: library / object_folder(i) for i in ids}, _config()
    rows: dict[str, dict[str, Any]] = {}
    if begun is not None:
        rows = {i: _as_before(i, sources[i], begun) for i in ids if i not in begun.objects}
    missing = [
        i
        for i in ids
        if i not in rows and not _is_made(folders[i], sources[i].sha256, config, begun)
    ]
    before = len(ids) - len(missing)
    work = partial(_make_object, form.name, str(library))
    how: dict[str, Any] = {"executor": execution.executor, "workers": execution.workers}
    with Progress(len(ids), "object made", quiet=execution.quiet, already=before) as progress:
        for source, result in run_tasks([sources[i] for i in missing], work, **how):
            if isinstance(result, TaskFailure) and result.kind == "exception":
                log_raised(source.object_id, result, library.parent / "logs")
            failed = failure_row(result) if isinstance(result, TaskFailure) else result
            if failed is not None:
                rows[source.object_id] = _known_row(source) | failed
                progress.write(f"object {source.name}: {failed['reason']}")
            progress.advance(note=source.name)
    index = [rows[i] if i in rows else _index_row(folders[i], sources[i]) for i in ids]
    if begun is not None:
        _check_begun(library, index, begun)
    elif index:
        write_index(library, index, config)
    reasons = {r["object_id"]: r["reason"] for r in index if r["status"] != Status.OK}
    kept = [
        f.refused(f"its object failed: {reasons[f.object_id]}")
        if f.object_id in reasons and not f.failed
        else f
        for f in files
    ]
    return kept, index


def _is_made(folder: Path, sha256: str, config: Any, begun: Begun | None) -> bool:
    """Tell whether an object is there; for a run that has begun, as it was then."""
    known = begun.rows.get(folder.name) if begun is not None else None
    if known is not None:  # whatever configuration this version has
        return made_columns(folder, sha256, content=known["content_sha256"]) is not None
    return made_columns(folder, sha256, config=config) is not None


def _as_before(object_id: str, source: ObjectSource, begun: Begun) -> dict[str, Any]:
    """The row of an object that the run has not: what it failed of is in the index."""
    if object_id in begun.rows:
        return dict(begun.rows[object_id])
    return _known_row(source) | reason_row(Status.NOT_SELECTED, "the run began without it")


def _check_begun(library: Path, index: Sequence[Mapping[str, Any]], begun: Begun) -> None:
    """Refuse a library that is not the run's any more, before anything says that it is."""
    lost = [r for r in index if r["object_id"] in begun.objects and r["status"] != Status.OK]
    if lost:
        raise NotUsable(
            f"{library.parent}: the object {lost[0]['source_name']} of the run is damaged or gone and "
            f"could not be made again ({lost[0]['reason']}); the same command tries again"
        )
    found = {r["object_id"]: r["content_sha256"] for r in index if r["status"] == Status.OK}
    if library_fingerprint(found) != begun.fingerprint:
        raise Contradiction(
            f"{library.parent}: objects of the run were damaged or gone, and what was made again is "
            "not what they were; import into another --out"
        )
    if not begun.rows:
        write_index(library, index, _config())


def _make_object(form_name: str, library: str, source: ObjectSource) -> Row | None:
    """Make one object and write its folder: the work of a task. None: it worked."""
    from bidexdata.formats.importers import load_format
    from bidexdata.formats.importers.format import BadFile

    limit_memory(MEMORY_GIB)
    try:
        obj = load_format(form_name).load_object(source, PrepareConfig())
    except PrepareFailure as failure:
        return reason_row(failure.status, failure.reason)
    except BadFile as bad:
        return reason_row(Status.UNREADABLE, bad.reason)
    except MemoryError:
        return reason_row(Status.TOO_COMPLEX, f"needs more than {MEMORY_GIB:g} GiB")
    write_object(Path(library) / object_folder(source.object_id), obj, _config())
    return None


def _config() -> dict[str, Any]:
    """The configuration that decides an object's bytes."""
    plain = to_plain(PrepareConfig())
    return {name: plain[name] for name in ("load", "surface", "sdf", "rest")}


def _known_row(source: ObjectSource) -> dict[str, Any]:
    """What the index says of an object whatever becomes of it."""
    return {
        "source_name": source.name,
        "object_id": source.object_id,
        "source_sha256": source.sha256,
        "source_bytes": source.bytes,
        "warnings": [],
    }


def _index_row(folder: Path, source: ObjectSource) -> dict[str, Any]:
    known = read_document(folder)["provenance"]
    origin = {name: known[name] for name in ("source", "licence", "author", "category")}
    return {
        **_known_row(source),
        **reason_row(Status.OK, ""),
        **origin,
        **index_columns(folder),
    }
