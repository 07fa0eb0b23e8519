"""Release: read a release folder as batches, tables, solids and clouds.

Opening reads the manifest only. Rows are read row group by row group, from Parquet with page
checksums verified, or from `grasps.h5` where they stand in it alone; `verify.verify_release` is
what checks every byte.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction, NotUsable, UnknownName
from bidexdata.formats import hdf5, parquet, tables
from bidexdata.formats.clouds import CLOUDS, open_cloud
from bidexdata.formats.licences import IDS_ONLY
from bidexdata.formats.manifest import MANIFEST, read_manifest
from bidexdata.formats.rows import ReleaseRows as ReleaseRows
from bidexdata.formats.rows import RunInfo as RunInfo
from bidexdata.formats.rows import TestKey
from bidexdata.formats.splits import ALL
from bidexdata.formats.tables import CONFIGURATIONS, GRASP_COLUMNS, VERDICT_COLUMNS
from bidexdata.formats.writer import ReleaseSummary as ReleaseSummary
from bidexdata.formats.writer import write_release as write_release
from bidexdata.kinds import expect_kind
from bidexdata.objects.library import object_folder
from bidexdata.objects.storage import read_solid
from bidexdata.record import GraspBatch, HandHeader, Header
from bidexdata.record.batch import empty_columns
from bidexdata.record.fields import columns_of_table

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.formats.row_index import RowIndex
    from bidexdata.objects.prepared import Solid


class ShapesLeftOut(NotUsable):
    """A release names its objects, but their meshes and clouds are not in it."""

    def __init__(self, path: Path):
        self.path = path
        super().__init__(
            f"{path} has no meshes and no clouds (it was packed with --licences ids-only): prepare "
            "the source files that its objects.parquet names, then use the run or library"
        )


_KEYS = {
    *("name", "version", "schema_version", "figures", "default_protocol", "tests"),
    *("configurations", "splits"),
}


@dataclass(frozen=True)
class Release:
    """A release folder, opened; make it with `Release.open`."""

    path: Path
    manifest: Mapping[str, Any]
    header: Header
    """Hands and versions, the same for all rows."""

    @classmethod
    def open(cls, path: str | Path) -> Release:
        """Open a release after checking its manifest and schema version.

        Raises:
            PathNotFound: There is no release at `path`.
            Contradiction: The manifest is damaged, or the schema is newer than this package.
        """
        path = Path(path)
        expect_kind(path, "release")
        manifest = read_manifest(path)
        try:
            header = Header.from_json(manifest["header"])
            missing = sorted(_KEYS - set(manifest))
        except (KeyError, TypeError) as err:
            raise Contradiction(f"{path / MANIFEST}: incomplete manifest ({err!r})") from err
        if missing:
            raise Contradiction(f"{path / MANIFEST}: incomplete manifest, {missing[0]} is missing")
        stated = manifest["schema_version"]
        if stated != header.schema_version:
            raise Contradiction(
                f"{path / MANIFEST}: schema_version is {stated!r} and that of its header "
                f"{header.schema_version!r}; they must be the same"
            )
        return cls(path, manifest, header)

    @property
    def name(self) -> str:
        """Name of the data set."""
        return self.manifest["name"]

    @property
    def version(self) -> str:
        """The data set's own version, X.Y.Z."""
        return self.manifest["version"]

    @property
    def hands(self) -> tuple[HandHeader, ...]:
        """The H axis."""
        return self.header.hands

    @property
    def default_protocol(self) -> str:
        """Protocol of `suc_f`, `suc_l`, `suc_a` and of the metrics."""
        return self.manifest["default_protocol"]

    @property
    def protocols(self) -> tuple[TestKey, ...]:
        """The (protocol, test) pairs that have a verdict table."""
        return tuple((p, t) for p, t in self.manifest["tests"])

    @property
    def rig(self) -> str:
        """Name of the rig that the rows have arm solutions of; empty where they have none."""
        return self.header.arms[0].rig if self.header.arms else ""

    @property
    def protocol_settings(self) -> dict[str, Any]:
        """Settings of every protocol that has verdicts, plain data by name."""
        return self.manifest.get("protocols", {})

    @property
    def figures(self) -> dict[str, Any]:
        """Counts, rates and means of the default protocol, as the card states them."""
        return self.manifest["figures"]

    @property
    def other_figures(self) -> dict[str, Any]:
        """The same of every other protocol, by name; a release of an older version has none."""
        return self.manifest.get("other_figures", {})

    @property
    def form(self) -> str:
        """Where the rows stand: `parquet`, `hdf5`, or `both` (Parquet and the training form)."""
        trained = hdf5.TRAINING_FILE in self.manifest["files"]
        return self.manifest.get("form", "both" if trained else "parquet")

    @property
    def configurations(self) -> tuple[str, ...]:
        """`selected` (default) and `audit`."""
        return tuple(self.manifest["configurations"])

    @property
    def split_names(self) -> tuple[str, ...]:
        """Splits in reading order."""
        return tuple(name for name, _ in self.manifest["splits"])

    @cached_property
    def objects(self) -> pa.Table:
        """The objects table; columns that an older schema lacks say nothing."""
        table = parquet.read_table(self.path / "objects.parquet")
        return tables.completed(table, tables.OBJECT_FIELDS)

    @cached_property
    def scenes(self) -> pa.Table:
        """The scenes table; columns that an older schema lacks say nothing."""
        table = parquet.read_table(self.path / "scenes.parquet")
        return tables.completed(table, tables.SCENE_FIELDS)

    @cached_property
    def runs(self) -> pa.Table:
        """The runs table."""
        return parquet.read_table(self.path / "runs.parquet")

    @cached_property
    def object_ids(self) -> tuple[str, ...]:
        """All objects, sorted; their order is that of the clouds."""
        return tuple(self.objects.column("object_id").to_pylist())

    @cached_property
    def splits(self) -> dict[str, tuple[str, ...]]:
        """Objects of each split; under a split by size an object is in every split it has sizes in."""
        found: dict[str, list[str]] = {name: [] for name in self.split_names}
        names = self.objects.column("split").to_pylist()
        places = self._scene_splits if ALL in names else {}
        for object_id, split in zip(self.object_ids, names, strict=True):
            for name in places.get(object_id, ()) if split == ALL else (split,):
                found[name].append(object_id)
        return {k: tuple(v) for k, v in found.items()}

    @cached_property
    def _scene_splits(self) -> dict[str, list[str]]:
        columns = (self.scenes.column(n).to_pylist() for n in ("object_id", "split"))
        pairs = set(zip(*columns, strict=True))
        found: dict[str, list[str]] = {}
        for object_id, split in sorted(pairs):
            found.setdefault(object_id, []).append(split)
        return found

    @property
    def policy(self) -> str:
        """Licence policy that chose the objects; empty where none was asked for."""
        return self.manifest.get("licences", "")

    @property
    def has_shapes(self) -> bool:
        """Whether meshes, pieces and clouds are in it: not under the policy `ids-only`."""
        return self.policy != IDS_ONLY

    def require_shapes(self) -> None:
        """Refuse what needs meshes where there are none.

        Raises:
            ShapesLeftOut: The release was packed with `--licences ids-only`.
        """
        if not self.has_shapes:
            raise ShapesLeftOut(self.path)

    def load_solid(self, object_id: str) -> Solid:
        """Read the solid of one object.

        Raises:
            UnknownName: The release has no such object.
            ShapesLeftOut: The release was packed with `--licences ids-only`.
        """
        self._check_object(object_id)
        self.require_shapes()
        return read_solid(self.path / object_folder(object_id))

    def cloud(self, kind: str = "cloud_solid", object_id: str | None = None) -> NDArray[np.float32]:
        """Point clouds at unit diagonal: all (K, P, 3), mapped, or one object's (P, 3).

        Raises:
            UnknownName: No such kind or object.
            ShapesLeftOut: The release was packed with `--licences ids-only`.
        """
        if kind not in CLOUDS:
            raise UnknownName("cloud", kind, CLOUDS)
        self.require_shapes()
        every = open_cloud(self.path / "clouds" / f"{kind}.npy")
        if object_id is None:
            return every
        self._check_object(object_id)
        return np.asarray(every[self.object_ids.index(object_id)])

    def table_files(self, table: str, configuration: str, split: str | None = None) -> list[Path]:
        """Parquet files of a row table in reading order: splits as in the manifest, then parts.

        None where the rows stand in `grasps.h5` alone; `row_groups` reads either form.

        Args:
            table: `grasps`, `contacts` or `verdicts/<protocol>-<test>`.
            configuration: `selected` or `audit`.
            split: One split; all when omitted.
        """
        self._check_place(configuration, split)
        return [
            path
            for name in self._chosen(split)
            for path in hdf5.split_files(self.path, table, configuration, name)
        ]

    def table_schema(self, table: str, configuration: str = "selected") -> pa.Schema:
        """Arrow schema of a row table, whatever the form.

        Raises:
            Contradiction: The file is damaged.
        """
        files = self.table_files(table, configuration)
        return parquet.read_schema(files[0]) if files else self._own_schema(table)

    def row_groups(
        self,
        table: str,
        configuration: str = "selected",
        split: str | None = None,
        columns: Sequence[str] | None = None,
    ) -> Iterator[pa.Table]:
        """Yield the rows of a row table a row group at a time, in order, whatever the form.

        All row tables of a configuration come in equal groups. There is at least one, which may be
        empty.

        Args:
            table: `grasps`, `contacts` or `verdicts/<protocol>-<test>`.
            configuration: `selected` or `audit`.
            split: One split; all when omitted.
            columns: Which; all when omitted.

        Raises:
            UnknownName: No such split or configuration.
            Contradiction: A file is damaged.
        """
        files = self.table_files(table, configuration, split)
        for file in files:
            yield from parquet.read_groups(file, columns)
        for name in () if files else self._chosen(split):
            rows = hdf5.count_rows(self.path, configuration, name)
            for low in range(0, max(rows, 1), parquet.ROW_GROUP):
                high = min(low + parquet.ROW_GROUP, rows)
                yield self.hdf5_rows(table, configuration, name, low, high, columns)

    def hdf5_rows(
        self,
        table: str,
        configuration: str,
        split: str,
        low: int,
        high: int,
        columns: Sequence[str] | None = None,
    ) -> pa.Table:
        """Read rows [low, high) of one split of a row table from `grasps.h5`, form `hdf5` only."""
        schema = self._own_schema(table)
        if columns is not None:
            fields = [schema.field(name) for name in columns]
            schema = tables.with_fields(schema, fields)
        return hdf5.read_rows(self.path, table, configuration, split, schema, low, high)

    def _own_schema(self, table: str) -> pa.Schema:
        schema = tables.row_schema(table, self.header)
        return tables.with_fields(schema, [f for f in schema if not self.header.lacks(f.name)])

    def _chosen(self, split: str | None) -> tuple[str, ...]:
        return (split,) if split is not None else self.split_names

    def _check_place(self, configuration: str, split: str | None) -> None:
        if configuration not in CONFIGURATIONS:
            raise UnknownName("configuration", configuration, CONFIGURATIONS)
        if split is not None and split not in self.split_names:
            raise UnknownName("split", split, self.split_names)

    def row_index(self, configuration: str = "selected", split: str | None = None) -> RowIndex:
        """Which rows belong to which scene and object; made once per configuration and split."""
        from bidexdata.formats.row_index import RowIndex

        self._check_place(configuration, split)
        place = (configuration, split)
        if place not in self._row_indexes:
            self._row_indexes[place] = RowIndex(self, *place)
        return self._row_indexes[place]

    @cached_property
    def _row_indexes(self) -> dict[tuple[str, str | None], RowIndex]:
        return {}

    def index(
        self,
        configuration: str = "selected",
        split: str | None = None,
        columns: Sequence[str] | None = None,
    ) -> pa.Table:
        """Scalar columns of the grasps table: ids, sizes, flags, energies, `suc_*`, metrics."""
        import pyarrow as pa

        self._check_place(configuration, split)
        schema = self.table_schema("grasps", configuration)
        scalar = [f.name for f in schema if not pa.types.is_fixed_size_list(f.type)]
        for name in columns or ():
            if name not in scalar:
                raise UnknownName("scalar column", name, scalar)
        names = list(columns) if columns is not None else scalar
        return pa.concat_tables(self.row_groups("grasps", configuration, split, names))

    def grasps(
        self,
        object_id: str | None = None,
        *,
        size_mm: int | None = None,
        split: str | None = None,
        configuration: str = "selected",
        protocol: str | None = None,
        test: str = "f",
    ) -> GraspBatch:
        """Read grasps with their contacts and, where there are some, the verdicts of one test.

        Args:
            object_id: One object; all when omitted.
            size_mm: One size; all when omitted.
            split: One split; all when omitted.
            configuration: `selected` or `audit`.
            protocol: Protocol of the verdict columns; the release's default when omitted.
            test: `f`, `l` or `a`.

        Returns:
            Rows in stored order. Rows that were not tested have `verdict_status` NOT_RUN.
        """
        if object_id is not None:
            self._check_object(object_id)
        parts = [
            batch
            for batch in self.batches(configuration, split, protocol, test, object_id=object_id)
            if len(batch)
        ]
        if size_mm is not None:
            parts = [b.select(b["size_mm"] == size_mm) for b in parts]
        if parts:
            return GraspBatch.concat(parts)
        empty = next(self.batches(configuration, split, protocol, test))
        return empty.select(slice(0, 0))

    def with_arms(self, batch: GraspBatch) -> GraspBatch:
        """Join rows of this release with their arm solutions.

        Args:
            batch: Rows of one object, in any order.

        Raises:
            NotUsable: The release has no arm solutions.
            Contradiction: It has none of a row.
        """
        import pyarrow as pa

        if not self.rig:
            raise NotUsable(
                f"{self.path} has no arm solutions; pack runs that `bidexdata arms` solved"
            )
        table, parts = tables.arms_tables(self.header)[0], []
        for object_id in np.unique(batch["object_id"]).tolist():
            for configuration in self.configurations:
                rows = self.row_index(configuration)
                ranges = rows.object_ranges(object_id)
                parts += [rows.read(low, high, table, None) for low, high in ranges]
        found = pa.concat_tables(parts).to_batches() if parts else []
        solved = GraspBatch.from_arrow(pa.Table.from_batches(found, self._own_schema(table)))
        ids, first = np.unique(solved["grasp_id"], return_index=True)
        at = np.minimum(np.searchsorted(ids, batch["grasp_id"]), max(len(ids) - 1, 0))
        if len(batch) and (not len(ids) or np.any(ids[at] != batch["grasp_id"])):
            raise Contradiction(f"{self.path}: {table} lacks rows of the grasps")
        chosen = solved.select(first[at] if len(batch) else slice(0, 0))
        more = {n: chosen[n] for n in tables.ARM_COLUMNS}
        return GraspBatch(self.header, {**batch.columns, **more})

    def stored(
        self, object_id: str | None = None, *, protocol: str | None = None, test: str = "f"
    ) -> GraspBatch:
        """Read every stored row once: selected rows, then audit rows that are not selected too.

        Args:
            object_id: One object; all when omitted.
            protocol: Protocol of the verdict columns; the release's default when omitted.
            test: `f`, `l` or `a`.
        """
        parts = []
        for configuration in self.configurations:
            rows = self.grasps(object_id, configuration=configuration, protocol=protocol, test=test)
            parts.append(rows.select(~rows["selected"]) if configuration == "audit" else rows)
        return GraspBatch.concat(parts)

    def batches(
        self,
        configuration: str = "selected",
        split: str | None = None,
        protocol: str | None = None,
        test: str = "f",
        *,
        object_id: str | None = None,
    ) -> Iterator[GraspBatch]:
        """Yield what `grasps` gives, one row group at a time; at least one batch."""
        self._check_place(configuration, split)
        key = (protocol or self.default_protocol, test)
        names = ["grasps", "contacts"]
        if key in self.protocols:
            names.append("verdicts/" + "-".join(key))
        columns = [[n for n in GRASP_COLUMNS if not self.header.lacks(n)], None, None]
        wanted = list(zip(names, columns, strict=False))
        if object_id is not None:
            yield from self._object_batches(object_id, configuration, split, wanted)
            return
        streams = [self.row_groups(t, configuration, split, c) for t, c in wanted]
        for parts in zip(*streams, strict=True):
            yield self.join([self.path / n for n in names], parts)

    def _object_batches(
        self,
        object_id: str,
        configuration: str,
        split: str | None,
        wanted: Sequence[tuple[str, Sequence[str] | None]],
    ) -> Iterator[GraspBatch]:
        rows = self.row_index(configuration, split)
        for low, high in rows.object_ranges(object_id) or [(0, 0)]:
            parts = [rows.read(low, high, table, columns) for table, columns in wanted]
            batch = self.join([self.path / table for table, _ in wanted], parts)
            if np.any(batch["object_id"] != object_id):
                raise Contradiction(
                    f"{self.path}: the rows of {object_id} are not where scenes.parquet says"
                )
            yield batch

    def join(self, files: Sequence[Path], parts: Sequence[pa.Table]) -> GraspBatch:
        """Make a batch of the same rows of the tables grasps, contacts and, maybe, verdicts.

        Args:
            files: Where they come from, for messages.
            parts: The rows, in that order of tables.

        Raises:
            Contradiction: They are not the same rows.
        """
        import pyarrow as pa

        batch = GraspBatch.from_arrow(parts[0])
        ids = parts[0].column("grasp_id")
        for file, part in zip(files[1:], parts[1:], strict=True):
            if not part.column("grasp_id").equals(ids):
                raise Contradiction(f"{file}: rows are not those of {files[0]}")
        contacts = GraspBatch.from_arrow(parts[1])
        more = {n: contacts[n] for n in columns_of_table("contacts")}
        if len(parts) > 2:
            at = parts[2].schema.get_field_index("success")
            success = parts[2].column("success").fill_null(False)
            verdict = parts[2].set_column(at, pa.field("success", pa.bool_()), success)
            judged = GraspBatch.from_arrow(verdict)
            late = [n for n in VERDICT_COLUMNS if self.header.lacks(n)]
            more |= empty_columns(batch.header, late, len(batch))
            more |= {n: judged[n] for n in VERDICT_COLUMNS if n not in late}
        return batch.with_columns(**more)

    def _check_object(self, object_id: str) -> None:
        if object_id not in self.object_ids:
            raise UnknownName("object", object_id, self.object_ids)
