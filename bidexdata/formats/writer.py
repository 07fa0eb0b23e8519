"""Write a release: objects, splits, rows, hands, figures, card, manifest; then one rename.

Everything goes to a hidden sibling of the target first, so that a killed `pack` leaves no release.
The same input gives the same bytes: no times, no host names, rows sorted, files cut by row number.
Nothing is held in memory but one object's rows and a few row groups per table.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

from bidexdata.errors import BadValue, NotUsable, UnknownChoice
from bidexdata.formats import hdf5, parquet
from bidexdata.formats.citation import About
from bidexdata.formats.content_hash import ContentTally
from bidexdata.formats.figures import Tally
from bidexdata.formats.licences import IDS_ONLY
from bidexdata.formats.manifest import write_manifest
from bidexdata.formats.new_folder import new_folder, refuse_taken
from bidexdata.formats.object_pass import EachObject, ObjectPass, one_by_one
from bidexdata.formats.object_table import objects_table, runs_table, scene_rows, scenes_table
from bidexdata.formats.pages import Picture, write_pages, write_pictures
from bidexdata.formats.parts import PreparedParts, StoredParts
from bidexdata.formats.rig_files import ReleaseRig, write_rig
from bidexdata.formats.row_writer import RowWriters
from bidexdata.formats.rows import ReleaseRows, RunInfo, TestKey, join_rows
from bidexdata.formats.scene_facts import ScenePhysics
from bidexdata.formats.splits import SPLITS, Splitting, split_rows
from bidexdata.formats.statistics import write_statistics
from bidexdata.formats.tables import CONFIGURATIONS, folder_of
from bidexdata.objects.prepared import PreparedObject
from bidexdata.record import Header
from bidexdata.record.fields import TESTS

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.hands.model import Hand

Form = Literal["both", "parquet", "hdf5"]
_VERSION = re.compile(r"(0|[1-9]\d*)\.(0|[1-9]\d*)\.(0|[1-9]\d*)")
_SMALL_SORTED_BY = {
    "objects": ("object_id",),
    "scenes": ("object_id", "size_mm", "scene_id"),
    "runs": ("run",),
}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,95}")


@dataclass(frozen=True, slots=True)
class ReleaseSummary:
    """What was written."""

    path: Path
    figures: dict[str, Any]
    """Counts, rates and means of the default protocol, as in the manifest and the card."""


def write_release(
    out: Path,
    *,
    name: str,
    version: str,
    object_ids: Sequence[str],
    rows_of: Callable[[str], Iterable[ReleaseRows]],
    load_object: Callable[[str], PreparedObject] | None = None,
    hands: Sequence[Hand] = (),
    runs: Sequence[RunInfo],
    tests: Sequence[TestKey],
    default_protocol: str = "paper-1",
    protocols: Mapping[str, Any] | None = None,
    seed: int = 0,
    test_fraction: float = 0.2,
    cloud_points: int = 2048,
    form: Form = "both",
    on_object: Callable[[str], None] | None = None,
    each_object: EachObject | None = None,
    split_by: str = "object",
    sizes_mm: Collection[int] = (),
    splitting: Splitting | None = None,
    licences: str = "",
    about: About | None = None,
    pictures: Callable[[Path, Mapping[str, Any]], Sequence[Picture]] | None = None,
    stored: StoredParts | None = None,
    derived: Mapping[str, Any] | None = None,
    rig: ReleaseRig | None = None,
) -> ReleaseSummary:
    """Write a release folder from batches and objects.

    Args:
        out: The release folder; must not exist or be empty.
        name: Name of the data set: letters, digits, `.`, `_`, `-`.
        version: The data set's version, X.Y.Z.
        object_ids: Every object that has rows or scenes, in any order.
        rows_of: Gives all rows of one object, run by run; called once per object.
        load_object: Gives the prepared object; may be missing where something else writes them.
        hands: The H axis; must be the hands of every batch. May be missing where `stored` is given.
        runs: The runs that the rows come from.
        tests: The (protocol, test) verdict tables to write.
        default_protocol: Whose verdicts become `suc_f`, `suc_l`, `suc_a` and the metrics.
        protocols: Settings of every protocol of `tests`, plain data by name.
        seed: Seed of the split.
        test_fraction: Share of objects in the split `test` [-].
        cloud_points: Points per object and cloud.
        form: `both` adds the training form `grasps.h5` to the Parquet tables, `parquet` leaves it
            out, and with `hdf5` the rows stand in `grasps.h5` alone.
        on_object: Called after each object's rows, for progress.
        each_object: Writes the objects in place of `load_object`, for example in several
            processes; see `object_pass`.
        split_by: `object`, `category` or `size` (`splits.split_rows`).
        sizes_mm: Every `size_mm` that rows or scenes have; read for a split by size only.
        splitting: A split that is known already; `split_by`, `seed` and `test_fraction` are not
            read then.
        licences: The policy that chose the objects; `ids-only` leaves out shapes and clouds.
        about: Authors, date and address.
        pictures: Draws the card's pictures from the folder, its tables complete, and the head of
            the manifest.
        stored: Writes objects and hands that are stored already, in place of `load_object` and
            `hands`.
        derived: What the manifest says of the releases that this one is made of.
        rig: Whose arm solutions rows bring; none where they bring none.

    Raises:
        UnknownChoice: No such rule of splitting or policy.
        BadValue: The name or version cannot be used.
        NotUsable: The target is not empty, rows are of another hand, or the same grasp is there
            twice.
        BadRecord: Rows are not those of their object, or of a test that was not announced.
    """
    out = Path(out)
    check_names(out, name, version, form)
    ids = sorted(set(object_ids))
    about = about or About()
    parts = stored or PreparedParts(hands, each_object or one_by_one(load_object), cloud_points)
    arms = rig.arms if rig is not None else ()
    header = Header(hands=parts.hands, version=_package_version(), arms=arms)
    content = ContentTally()
    with new_folder(out) as partial:
        one = ObjectPass(partial, parts.cloud_points, shapes=licences != IDS_ONLY)
        one.begin(len(ids))
        found = dict(parts.each_object(one, ids))
        objects = [found[object_id] for object_id in ids]
        shares = {"test_fraction": test_fraction, "seed": seed}
        split = splitting or split_rows(split_by, objects, sizes_mm, **shares)
        parts.write_hands(partial)
        if rig is not None:
            write_rig(partial, rig)
        settings = (protocols or {}).get(default_protocol)
        written = _write_rows(
            partial,
            {row["object_id"]: ScenePhysics.of(row, settings) for row in objects},
            rows_of,
            header,
            runs,
            tuple(tests),
            default_protocol,
            split,
            content,
            on_object,
        )
        small = {
            "objects": objects_table(objects, split.objects),
            "scenes": written.scenes,
            "runs": runs_table(runs),
        }
        for table, rows in small.items():
            parquet.write_table(partial / f"{table}.parquet", rows, _SMALL_SORTED_BY[table])
            content.add(table, rows)
        head = {
            "name": name,
            "version": version,
            "schema_version": header.schema_version,
            "generator": {"name": "bidexdata", "version": header.version},
            "header": header.to_json(),
            "default_protocol": default_protocol,
            "protocols": dict(protocols or {}),
            "tests": [list(key) for key in sorted(tests)],
            "configurations": list(CONFIGURATIONS),
            "splits": split.counts(_sizes_of(written.scenes)),
            "split": split.manifest(),
            "licences": licences,
            "about": about.manifest(),
            "cloud_points": parts.cloud_points,
            "form": form,
            "content_hash": content.digest(),
            "figures": written.figures.pop(default_protocol),
            "other_figures": written.figures,
            **({"derived": dict(derived)} if derived else {}),
            **({"rigs": [rig.name]} if rig is not None else {}),
        }
        _write_hdf5(partial, form, head, tests)
        head["pictures"] = write_pictures(partial, pictures(partial, head) if pictures else ())
        write_pages(partial, head, about)
        write_manifest(partial, head, {} if form == "hdf5" else written.file_rows)
    return ReleaseSummary(out, head["figures"])


def check_names(out: Path, name: str, version: str, form: str) -> None:
    """Refuse what a release cannot be called or where it cannot be written.

    Raises:
        BadValue: The version is not X.Y.Z, or the name has other characters.
        NotUsable: No form is called so, or `out` holds something.
    """
    if not _VERSION.fullmatch(version):
        raise BadValue(f"version {version!r} cannot be used; write X.Y.Z, for example 1.0.0")
    if not _NAME.fullmatch(name):
        raise BadValue(f"name {name!r} cannot be used; use letters, digits, '.', '_' and '-'")
    if form not in get_args(Form):
        raise UnknownChoice("--form", form, get_args(Form))
    refuse_taken(out)


def _sizes_of(scenes: pa.Table) -> list[tuple[str, int]]:
    """object_id and size_mm of every scene."""
    columns = (scenes.column(name).to_pylist() for name in ("object_id", "size_mm"))
    return list(zip(*columns, strict=True))


class _Written(NamedTuple):
    """What is known once all rows are written."""

    figures: dict[str, Any]
    """Of every protocol."""
    scenes: pa.Table
    file_rows: dict[str, int]


def _write_rows(
    root: Path,
    physics: Mapping[str, ScenePhysics],
    rows_of: Callable[[str], Iterable[ReleaseRows]],
    header: Header,
    runs: Sequence[RunInfo],
    tests: tuple[TestKey, ...],
    protocol: str,
    split: Splitting,
    content: ContentTally,
    on_object: Callable[[str], None] | None,
) -> _Written:
    """Write grasps, contacts, verdicts and statistics, and collect scenes and figures."""
    wanted = {run.name: run.grasps for run in runs}
    tallies = {
        name: Tally(tuple(t for t in TESTS if (name, t) in tests) or ("f",))
        for name in sorted({protocol, *(p for p, _ in tests)})
    }
    writers = RowWriters(root, header, tests, SPLITS, content)
    scenes: list[dict[str, Any]] = []
    try:
        for object_id in sorted(physics):
            parts = list(rows_of(object_id))
            unknown = sorted({part.run for part in parts} - set(wanted))
            if unknown:
                raise NotUsable(f"rows of run {unknown[0]!r}, which is not among the runs given")
            rows = join_rows(object_id, parts, header, tests)
            for part in parts:
                for name, tally in tallies.items():
                    verdicts = {t: v for (p, t), v in part.verdicts.items() if p == name}
                    tally.add(part.batch, verdicts, run=part.run, grasps=wanted[part.run])
            known = (split, parts, rows, wanted, physics[object_id])
            scenes += scene_rows(object_id, *known)
            for name, mask in split.masks(object_id, rows.batch["size_mm"]).items():
                writers.add(rows if mask.all() else rows.select(mask), name, protocol)
            if on_object is not None:
                on_object(object_id)
        writers.close()
    finally:
        writers.stop()
    write_statistics(root, writers.statistics)
    figures = {name: tally.figures() for name, tally in tallies.items()}
    return _Written(figures, scenes_table(scenes), writers.file_rows)


def _write_hdf5(root: Path, form: Form, head: Mapping[str, Any], tests: Sequence[TestKey]) -> None:
    """Derive `grasps.h5` from the Parquet tables; for the form `hdf5` drop these then."""
    if form == "parquet":
        return
    whole = sorted(tests) if form == "hdf5" else None
    hdf5.write_training_form(root, SPLITS, about=hdf5.about_release(head), whole_tests=whole)
    for configuration in CONFIGURATIONS if form == "hdf5" else ():
        for table in ("grasps", "contacts", "arms", "verdicts"):
            shutil.rmtree(root / folder_of(table, configuration), ignore_errors=True)


def _package_version() -> str:
    from bidexdata import __version__

    return __version__
