"""Write a release: objects, splits, rows, hands, figures, card, manifest; then one rename.

Everything goes to a hidden sibling of the target first, so that a killed `pack` leaves no release.
The same input gives the same bytes: no times, no host names, rows sorted, files cut by row number.
Nothing is held in memory but one object's rows and one row group per table.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from bidexdata.errors import BadValue, NotUsable, UnknownChoice
from bidexdata.formats import clouds, hdf5, parquet, tables
from bidexdata.formats.card import write_card
from bidexdata.formats.figures import Tally
from bidexdata.formats.hand_files import write_hand
from bidexdata.formats.manifest import write_manifest
from bidexdata.formats.object_table import (
    object_row,
    objects_table,
    runs_table,
    scene_rows,
    scenes_table,
    shape_hash,
)
from bidexdata.formats.rows import (
    ObjectRows,
    ReleaseRows,
    RunInfo,
    TestKey,
    contacts_table,
    grasps_table,
    join_rows,
    verdicts_table,
)
from bidexdata.formats.splits import SPLITS, split_objects
from bidexdata.formats.tables import CONFIGURATIONS, SORTED_BY
from bidexdata.objects.library import object_folder
from bidexdata.objects.prepared import PreparedObject
from bidexdata.objects.storage import write_solid
from bidexdata.record import Header
from bidexdata.record.fields import TESTS

if TYPE_CHECKING:
    from bidexdata.hands.model import Hand

Form = Literal["both", "parquet", "hdf5"]
_VERSION = re.compile(r"(0|[1-9]\d*)\.(0|[1-9]\d*)\.(0|[1-9]\d*)")
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
    load_object: Callable[[str], PreparedObject],
    hands: Sequence[Hand],
    runs: Sequence[RunInfo],
    tests: Sequence[TestKey],
    default_protocol: str = "paper-1",
    protocols: Mapping[str, Any] | None = None,
    seed: int = 0,
    test_fraction: float = 0.2,
    cloud_points: int = 2048,
    form: Form = "both",
    on_object: Callable[[str], None] | None = None,
) -> ReleaseSummary:
    """Write a release folder from batches and objects.

    Args:
        out: The release folder; must not exist or be empty.
        name: Name of the data set: letters, digits, `.`, `_`, `-`.
        version: The data set's version, X.Y.Z.
        object_ids: Every object that has rows or scenes, in any order.
        rows_of: Gives all rows of one object, run by run; called once per object.
        load_object: Gives the prepared object.
        hands: The H axis; must be the hands of every batch.
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

    Raises:
        BadValue: The name or version cannot be used.
        NotUsable: The target is not empty, rows are of another hand, or the same grasp is there
            twice.
        BadRecord: Rows are not those of their object, or of a test that was not announced.
    """
    out = Path(out)
    check_names(out, name, version, form)
    partial = out.parent / f".{out.name}.partial"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    ids = sorted(set(object_ids))
    header = Header(hands=tuple(h.header() for h in hands), version=_package_version())
    splits = _write_objects(partial, ids, load_object, seed, test_fraction, cloud_points)
    for hand in hands:
        write_hand(partial, hand)
    parquet.write_table(partial / "runs.parquet", runs_table(runs), ("run",))
    figures = _write_rows(
        partial, ids, rows_of, header, runs, tuple(tests), default_protocol, splits, on_object
    )
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
        "splits": [[s, sum(1 for v in splits.values() if v == s)] for s in SPLITS],
        "split": {"by": "object", "seed": seed, "test_fraction": test_fraction},
        "cloud_points": cloud_points,
        "form": form,
        "figures": figures.pop(default_protocol),
        "other_figures": figures,
    }
    _write_hdf5(partial, form, head, tests)
    write_card(partial, head)
    write_manifest(partial, head)
    _put_in_place(partial, out)
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
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise NotUsable(f"{out} exists already; a release is written once, choose another --out")


def _write_objects(
    root: Path,
    ids: Sequence[str],
    load_object: Callable[[str], PreparedObject],
    seed: int,
    test_fraction: float,
    cloud_points: int,
) -> dict[str, str]:
    """Write object files, clouds and the objects table; give object_id -> split."""
    (root / "clouds").mkdir()
    arrays = {
        kind: np.lib.format.open_memmap(
            root / "clouds" / f"{kind}.npy", "w+", np.float32, (len(ids), cloud_points, 3)
        )
        for kind in clouds.CLOUDS
    }
    rows: list[dict[str, Any]] = []
    for i, object_id in enumerate(ids):
        obj = load_object(object_id)
        rows.append(object_row(obj, shape_hash(obj)))
        write_solid(root / object_folder(object_id), obj)
        for kind, mesh in (("cloud_solid", obj.solid), ("cloud_mesh", obj.mesh)):
            key = f"{object_id}/{kind}"
            arrays[kind][i] = clouds.surface_cloud(mesh.vertices, mesh.faces, cloud_points, key)
    for array in arrays.values():
        array.flush()
    shapes = {row["object_id"]: row["shape_sha256"] for row in rows}
    splits = split_objects(shapes, test_fraction=test_fraction, seed=seed)
    parquet.write_table(root / "objects.parquet", objects_table(rows, splits), ("object_id",))
    return splits


def _write_rows(
    root: Path,
    ids: Sequence[str],
    rows_of: Callable[[str], Iterable[ReleaseRows]],
    header: Header,
    runs: Sequence[RunInfo],
    tests: tuple[TestKey, ...],
    protocol: str,
    splits: dict[str, str],
    on_object: Callable[[str], None] | None,
) -> dict[str, Any]:
    """Write grasps, contacts, verdicts and scenes; give the figures of every protocol."""
    wanted = {run.name: run.grasps for run in runs}
    tallies = {
        name: Tally(tuple(t for t in TESTS if (name, t) in tests) or ("f",))
        for name in sorted({protocol, *(p for p, _ in tests)})
    }
    writers = {
        (configuration, split): _ConfigurationWriter(root, configuration, split, header, tests)
        for configuration in CONFIGURATIONS
        for split in SPLITS
    }
    scenes: list[dict[str, Any]] = []
    for object_id in ids:
        parts = list(rows_of(object_id))
        unknown = sorted({part.run for part in parts} - set(wanted))
        if unknown:
            raise NotUsable(f"rows of run {unknown[0]!r}, which is not among the runs given")
        rows = join_rows(object_id, parts, header, tests)
        for part in parts:
            for name, tally in tallies.items():
                verdicts = {t: v for (p, t), v in part.verdicts.items() if p == name}
                tally.add(part.batch, verdicts, run=part.run, grasps=wanted[part.run])
        scenes += scene_rows(object_id, splits[object_id], parts, rows, wanted)
        for configuration in CONFIGURATIONS:
            writers[configuration, splits[object_id]].add(rows, protocol)
        if on_object is not None:
            on_object(object_id)
    for writer in writers.values():
        writer.close()
    table = scenes_table(scenes)
    parquet.write_table(root / "scenes.parquet", table, ("object_id", "size_mm", "scene_id"))
    return {name: tally.figures() for name, tally in tallies.items()}


class _ConfigurationWriter:
    """Writers of all row tables of one configuration and split; rows stay aligned."""

    def __init__(
        self, root: Path, configuration: str, split: str, header: Header, tests: Sequence[TestKey]
    ):
        self.configuration = configuration
        suffix = "" if configuration == "selected" else f"_{configuration}"
        self.grasps = parquet.TableWriter(
            root / f"grasps{suffix}", split, tables.grasps_schema(header), SORTED_BY
        )
        self.contacts = parquet.TableWriter(
            root / f"contacts{suffix}", split, tables.contacts_schema(header)
        )
        self.verdicts = {
            (protocol, test): parquet.TableWriter(
                root / f"verdicts{suffix}" / f"{protocol}-{test}",
                split,
                tables.verdicts_schema(header),
            )
            for protocol, test in tests
        }

    def add(self, rows: ObjectRows, protocol: str) -> None:
        mine = rows.select(rows.batch[self.configuration])
        self.grasps.add_object(grasps_table(mine, protocol))
        self.contacts.add_object(contacts_table(mine))
        for key, writer in self.verdicts.items():
            writer.add_object(verdicts_table(mine, key))

    def close(self) -> None:
        for writer in (self.grasps, self.contacts, *self.verdicts.values()):
            writer.close()


def _write_hdf5(root: Path, form: Form, head: Mapping[str, Any], tests: Sequence[TestKey]) -> None:
    """Derive `grasps.h5` from the Parquet tables; for the form `hdf5` drop these then."""
    if form == "parquet":
        return
    whole = sorted(tests) if form == "hdf5" else None
    hdf5.write_training_form(root, SPLITS, about=hdf5.about_release(head), whole_tests=whole)
    for configuration in CONFIGURATIONS if form == "hdf5" else ():
        suffix = "" if configuration == "selected" else f"_{configuration}"
        for table in ("grasps", "contacts", "verdicts"):
            shutil.rmtree(root / f"{table}{suffix}", ignore_errors=True)


def _put_in_place(partial: Path, out: Path) -> None:
    for path in partial.rglob("*"):
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())
    if out.exists():
        out.rmdir()  # empty: checked before
    partial.rename(out)


def _package_version() -> str:
    from bidexdata import __version__

    return __version__
