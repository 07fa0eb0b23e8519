"""How an imported run begins: what run.json says, and a task per object."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.config import differing_keys, fingerprint
from bidexdata.errors import BidexError, ConfigConflict
from bidexdata.objects.library import Library
from bidexdata.objects.storage import read_document
from bidexdata.record.scene import Setting, setting_of
from bidexdata.runs.import_scan import FILES, FileRow, write_files
from bidexdata.runs.made_with import package_versions
from bidexdata.runs.plan import Task, read_plan, write_plan
from bidexdata.runs.run import Run
from bidexdata.runs.run_folder import PLAN_FILE
from bidexdata.runs.spec import RunSpec, portable_hand, write_spec

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


def asked_spec(
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


def refuse_other(out: Path, old: RunSpec, asked: RunSpec) -> None:
    """Refuse to go on in a run of something else.

    Raises:
        ConfigConflict: Names the keys that differ.
    """
    made = {"sizes_mm": old.sizes_mm, "source_fingerprint": old.source_fingerprint}
    wanted = dataclasses.replace(asked, **made)
    differing = differing_keys(old.identity(), wanted.identity())
    if differing:
        raise ConfigConflict(out, differing)


def planned_objects(out: Path) -> set[str] | None:
    """Objects of the plan; None where it is gone or damaged."""
    try:
        return {task.object_id for task in read_plan(out / PLAN_FILE)}
    except BidexError:
        return None


def start_run(
    out: Path, asked: RunSpec, files: Sequence[FileRow], library: Library, old: RunSpec | None
) -> tuple[Run, list[Task]]:
    """Write the plan, the list of files and run.json, or check that they are those of before.

    Raises:
        ConfigConflict: They are not; names the keys that differ.
    """
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
