"""`export`: rows of a release become files of another project, with their objects."""

from __future__ import annotations

import csv
import os
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.errors import NotUsable, UnknownName
from bidexdata.record import Status
from bidexdata.runs.progress import Progress

if TYPE_CHECKING:
    from bidexdata.formats.release import Release
    from bidexdata.record import GraspBatch

INDEX = "INDEX.csv"
"""Beside the objects: where each is from, as `import` reads it."""
_STATED = ("source", "licence", "author", "category")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportReport:
    """What was written."""

    out: Path
    grasps: int
    """Rows written, one file each."""
    skipped: Mapping[str, int]
    """Rows without a pose, per label of their status."""
    objects: int
    hands: tuple[str, ...]
    """Sides."""
    seconds: float


def export_release(
    path: str | Path,
    out: str | Path,
    *,
    format: str = "dexgraspbench",
    split: str | None = None,
    limit: int | None = None,
    quiet: bool = False,
) -> ExportReport:
    """Write the selected rows of a release in the format of another project.

    Everything is written into a folder beside `out` that takes its name when all is done.

    Args:
        path: The release.
        out: A folder that does not exist yet, or is empty.
        format: Which format, a key of `EXPORTS`.
        split: Only this split.
        limit: Only the first so many rows.
        quiet: No progress.

    Raises:
        UnknownName: There is no such format or split.
        NotUsable: The format has no such hands, `out` holds something, or the release has objects
            without meshes or nothing to export.
    """
    from bidexdata.formats.exporters import EXPORTS
    from bidexdata.formats.release import Release
    from bidexdata.runs.trajectories import FORMATS

    start, out = time.monotonic(), Path(out)
    if format not in EXPORTS:
        raise UnknownName("export format", format, [*EXPORTS, *FORMATS])
    writer = import_module(EXPORTS[format])
    release = Release.open(path)
    writer.check_hands(release.hands)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise NotUsable(f"{out} is there already; export into another --out")
    partial = out.parent / f".{out.name}.partial"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        grasps, skipped, objects = _write(release, writer, partial, split, limit, quiet)
        if out.exists():
            out.rmdir()
        os.replace(partial, out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)  # gone already, but after a stop
    return ExportReport(
        out=out,
        grasps=grasps,
        skipped=skipped,
        objects=objects,
        hands=tuple(h.side for h in release.hands),
        seconds=time.monotonic() - start,
    )


def _write(
    release: Release, writer: Any, folder: Path, split: str | None, limit: int | None, quiet: bool
) -> tuple[int, dict[str, int], int]:
    """Write rows and, as they come up, their objects; give both counts and what was left out."""
    from bidexdata.formats.exporters.plain_pickle import save_dictionary

    written, skipped, objects = 0, {}, []
    most = min(release.figures["selected_rows"], limit or release.figures["selected_rows"])
    with Progress(most, "grasp written", quiet=quiet) as progress:
        for batch in release.batches(split=split):
            good, bad = _usable(batch)
            skipped = {k: skipped.get(k, 0) + bad.get(k, 0) for k in {*skipped, *bad}}
            good = good if limit is None else good.select(slice(0, limit - written))
            for object_id in dict.fromkeys(good["object_id"].tolist()):
                if object_id not in objects:
                    writer.write_object(
                        folder / writer.OBJECTS / object_id, _solid(release, object_id)
                    )
                    objects.append(object_id)
            for file in writer.grasp_files(good):
                place = folder / file.path
                place.parent.mkdir(parents=True, exist_ok=True)
                save_dictionary(place, file.content)
            written += len(good)
            progress.advance(len(good))
            if limit is not None and written >= limit:
                break
    if not written:
        raise NotUsable(f"{release.path} holds no row that could be exported")
    _write_index(release, folder / writer.OBJECTS / INDEX, objects)
    return written, dict(sorted(skipped.items())), len(objects)


def _usable(batch: GraspBatch) -> tuple[GraspBatch, dict[str, int]]:
    """Rows with a pose, and how many have none, per status."""
    status = batch["synth_status"]
    found, counts = np.unique(status[status != Status.OK], return_counts=True)
    bad = {Status(s).label: int(n) for s, n in zip(found, counts, strict=True)}
    return batch.select(status == Status.OK), bad


def _solid(release: Release, object_id: str) -> Any:
    from bidexdata.objects.library import object_folder

    if not (release.path / object_folder(object_id) / "mesh.glb").is_file():
        raise NotUsable(
            f"{release.path} has no meshes of {object_id} (it was packed with --licences ids-only, or "
            "its licence does not allow them), and the other project needs them"
        )
    return release.load_solid(object_id)


def _write_index(release: Release, path: Path, objects: list[str]) -> None:
    rows = {r["object_id"]: r for r in release.objects.to_pylist()}
    with open(path, "w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(("file", *_STATED))
        for object_id in objects:
            table.writerow((object_id, *(rows[object_id].get(n) or "" for n in _STATED)))
