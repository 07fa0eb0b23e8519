"""BiDexStream: batches straight from the Parquet files that are there, in a shuffled order.

For a first look at a large release of which only some files are downloaded, and where there is no
room for the training form. The order is a function of (seed, epoch) and of which files there are:
row groups in random order are put together to windows of `buffer` rows or more, and the rows of a
window are shuffled. Any place of the order can be gone to, so a stream resumes without reading what
it has given.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bidexdata.errors import BadConfig, NotUsable, UnknownName
from bidexdata.formats import parquet
from bidexdata.formats.release import Release
from bidexdata.formats.tables import (
    ARM_COLUMNS,
    CONFIGURATIONS,
    arms_tables,
    column_field,
    folder_of,
)
from bidexdata.loaders.assembly import Assembly, Gathered, Selection, columns_needed
from bidexdata.loaders.filters import Where, columns_named, matching_rows
from bidexdata.loaders.options import DEFAULT_FIELDS, ItemOptions, names_of, require_torch
from bidexdata.loaders.permutation import permuted
from bidexdata.loaders.stored import refuse_arms, scalar_columns
from bidexdata.record.fields import columns_of_table
from bidexdata.wording import counted

if TYPE_CHECKING:
    import pyarrow as pa

require_torch()

from torch.utils.data import IterableDataset, get_worker_info  # noqa: E402

log = logging.getLogger(__name__)


class _Group(NamedTuple):
    """One row group that is there."""

    file: Path
    number: int
    kept: np.ndarray
    """Rows of it that `where` keeps, ascending."""
    first: int
    """Number of its first row among all rows of the files that are there."""


class _Window(NamedTuple):
    """Rows that are shuffled with each other."""

    first: int
    """Place of the first of them in the epoch's order."""
    rows: int
    groups: list[int]
    """Numbers of the row groups they are of."""


class BiDexStream(IterableDataset[dict[str, Any]]):
    """Batches of grasps of the Parquet files that are there.

    Use `DataLoader(stream, batch_size=None)`: batches come ready. Every worker and every rank takes
    its share of the same order, so their number changes nothing but speed; each reads all files, so
    one worker, or `Prefetch`, is as good as many.
    """

    def __init__(
        self,
        root: str | Path,
        *,
        batch_size: int = 256,
        buffer: int = 65_536,
        split: str | None = "train",
        where: Where = None,
        fields: Sequence[str] | None = None,
        configuration: str = "selected",
        shuffle: bool = True,
        seed: int = 0,
        rank: int = 0,
        world_size: int = 1,
        **options: Any,
    ):
        """Find the files and choose rows.

        Args:
            root: Release folder; `manifest.json`, `objects.parquet`, `scenes.parquet`, the cloud
                asked for and at least one file of grasps must be there.
            batch_size: Grasps of a batch; the last batch of an epoch may have fewer.
            buffer: Rows that are shuffled with each other and held in memory, at least.
            split: `train`, `test`, or None for all.
            where: An expression or a dictionary, as for `BiDexDataset`.
            fields: Columns of an item; those of contacts and of arms need the files of these tables.
            configuration: `selected` or `audit`.
            shuffle: False gives the stored order.
            seed: Seed of the order and of the augmentation.
            rank: Number of this process.
            world_size: Number of processes.
            options: `frame`, `cloud`, `points`, `normals`, `clouds`, `quat_order`, `rotation`, `augment`, as
                for `BiDexDataset`.

        Raises:
            NotUsable: No file of the split is there, or there are no arms that have a column.
            UnknownName: No such split, field, cloud, configuration or option.
            BadConfig: `where` cannot be read, or options exclude each other.
        """
        super().__init__()
        self.release = Release.open(root)
        if configuration not in CONFIGURATIONS:
            raise UnknownName("configuration", configuration, CONFIGURATIONS)
        if not 0 <= rank < world_size:
            raise ValueError(f"rank must lie in [0, {world_size}), not {rank}")
        self.batch_size, self.buffer, self.shuffle, self.seed = batch_size, buffer, shuffle, seed
        self.rank, self.world_size = rank, world_size
        self.split, self.configuration, self.epoch = split, configuration, 0
        options["fields"] = names_of("fields", DEFAULT_FIELDS if fields is None else fields)
        options["augment"] = names_of("augment", options.get("augment", ()))
        self.options = ItemOptions(seed=seed, **options)
        self._start = 0
        files = self._files_there()
        stored = parquet.read_schema(files[0])
        schema = {f.name for f in stored}
        self._on_table = "tabletop" in self.release.scenes.column("setting").to_pylist()
        self._columns = self._where_from(schema)
        scalar = scalar_columns(stored)
        if arms_tables(self.release.header):
            scalar += [name for name in ARM_COLUMNS if not column_field(name).shape]
        self._groups = self._row_groups(files, where, scalar)
        self._assembly: Assembly | None = None
        self._window: tuple[tuple[int, int, int], pa.Table, np.ndarray] | None = None
        self._plan: tuple[tuple[int, int], list[_Window]] | None = None
        self._numbers: dict[str, int] | None = None

    def __len__(self) -> int:
        """Batches that this rank still gets in this epoch, of all its workers together.

        All ranks get as many; what does not divide is dropped.
        """
        left = max(self.rows - self._start, 0)
        return (left + self.batch_size - 1) // self.batch_size // self.world_size

    @property
    def rows(self) -> int:
        """Rows of the files that are there, `where` applied."""
        return sum(len(group.kept) for group in self._groups)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """Give this process's batches of the rest of the epoch."""
        worker = get_worker_info()
        workers, mine = (worker.num_workers, worker.id) if worker else (1, 0)
        share = self.world_size * workers
        place = mine * self.world_size + self.rank
        for number in range(place, len(self) * self.world_size, share):
            low = self._start + number * self.batch_size
            yield self._batch(low, min(low + self.batch_size, self.rows))

    def set_epoch(self, epoch: int) -> None:
        """Start a given epoch from its beginning."""
        self.epoch, self._start = epoch, 0

    def state_dict(self, batches: int) -> dict[str, int]:
        """What is needed to go on, on any number of ranks and workers.

        Args:
            batches: Batches that each rank's trainer has had since this stream began or resumed.
        """
        given = self._start + batches * self.world_size * self.batch_size
        return {"seed": self.seed, "epoch": self.epoch, "emitted": min(given, self.rows)}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Go on where `state_dict` was taken, with the same files."""
        self.seed, self.epoch, self._start = state["seed"], state["epoch"], state["emitted"]

    def __getstate__(self) -> dict[str, Any]:
        # Workers read for themselves.
        made = dict.fromkeys(("_assembly", "_window", "_plan", "_numbers"))
        return {**self.__dict__, "release": self.release.path, **made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.release = Release.open(state["release"])

    def _files_there(self) -> list[Path]:
        """Files of grasps that are there; says how many of those in the manifest are not."""
        release = self.release
        files = release.table_files("grasps", self.configuration, self.split)
        splits = release.split_names if self.split is None else (self.split,)
        folder = folder_of("grasps", self.configuration)
        heads = tuple(f"{folder}/{split}-" for split in splits)
        named = [n for n in release.manifest["files"] if n.startswith(heads)]
        if not files and release.form == "hdf5":
            raise NotUsable(
                f"{release.path} has its rows in grasps.h5, of which no part can be streamed; "
                "load it with BiDexDataset"
            )
        if not files:
            raise NotUsable(
                f"{release.path}: none of {counted(len(named), 'file')} of grasps is there; "
                f"download some, for example {sorted(named)[0] if named else 'grasps'}"
            )
        missing = len(named) - len(files)
        if missing > 0:
            log.warning(
                "%s: %d of %d files of grasps are not there; their rows are left out",
                *(release.path, missing, len(named)),
            )
        return files

    def _where_from(self, grasps: set[str]) -> dict[str, list[str]]:
        """Columns to read from each table; grasps come first."""
        names = columns_needed(self.options, on_table=self._on_table)
        refuse_arms(self.release, names)
        others = {"contacts": columns_of_table("contacts")}
        others |= dict.fromkeys(arms_tables(self.release.header), ARM_COLUMNS)
        known = grasps.union(*others.values())
        for name in names:
            if name not in known | {"size"}:
                raise UnknownName("field", name, sorted(known))
        mine = [n for n in names if n in grasps]
        if "size" in names and "size" not in grasps:
            mine.append("size_mm")
        mine.append("object_id")
        more = {table: [n for n in names if n in columns] for table, columns in others.items()}
        return {"grasps": list(dict.fromkeys(mine)), **more}

    def _row_groups(
        self, files: Sequence[Path], where: Where, scalar: Sequence[str]
    ) -> list[_Group]:
        named = columns_named(where)
        if named is None:
            raise BadConfig("a stream takes an expression or a dictionary as where, no function")
        refuse_arms(self.release, named)
        for name in named:
            if name not in scalar:
                raise UnknownName("column", name, scalar, "in where")
        if where is not None and not named:
            named = ["size_mm"]  # without a column there is no length; any will do
        of_arms = [n for n in named if n in ARM_COLUMNS]
        columns = {"grasps": [n for n in named if n not in of_arms]}
        columns |= dict.fromkeys(arms_tables(self.release.header), of_arms)
        found, first = [], 0
        for file in files:
            counts = parquet.row_counts(file)
            tables: Any = [None] * len(counts)
            if named:
                tables = (_read(file, columns, number) for number in range(len(counts)))
            for number, (count, table) in enumerate(zip(counts, tables, strict=True)):
                kept = np.arange(count) if table is None else matching_rows(where, table)
                found.append(_Group(file, number, kept, first))
                first += count
        return found

    def _batch(self, low: int, high: int) -> dict[str, Any]:
        """Rows at the places [low, high) of the order, which may lie in two windows or more."""
        if self._assembly is None:
            self._assembly = Assembly(self.release, self.options, on_table=self._on_table)
        parts: list[tuple[pa.Table, np.ndarray]] = []
        for number, window in enumerate(self._windows()):
            a, b = max(low - window.first, 0), min(high - window.first, window.rows)
            if a >= b:
                continue
            table, rows = self._load(number, window)
            places = np.arange(a, b)
            if self.shuffle:
                places = permuted(places, window.rows, self.seed, self.epoch, number)
            parts.append((table.take(places), rows[places]))
        import pyarrow as pa

        table = pa.concat_tables([part for part, _ in parts])
        rows = np.concatenate([rows for _, rows in parts])
        if self._numbers is None:
            self._numbers = {object_id: k for k, object_id in enumerate(self.release.object_ids)}
        ids = table.column("object_id").to_pylist()
        objects = np.array([self._numbers[i] for i in ids], np.int64)
        found, text = self._arrays(table)
        return self._assembly.batch(Gathered(found, text, Selection(rows, objects)), self.epoch)

    def _windows(self) -> list[_Window]:
        """The windows of this epoch, found once."""
        key = (self.seed, self.epoch)
        if self._plan is None or self._plan[0] != key:
            found, first, count, groups = [], 0, 0, []
            for k in self._order():
                count += len(self._groups[k].kept)
                groups.append(k)
                if count >= self.buffer:
                    found.append(_Window(first, count, groups))
                    first, count, groups = first + count, 0, []
            self._plan = (key, [*found, _Window(first, count, groups)] if count else found)
        return self._plan[1]

    def _order(self) -> list[int]:
        numbers = np.arange(len(self._groups))
        if self.shuffle:
            numbers = permuted(numbers, len(numbers), self.seed, self.epoch)
        return numbers.tolist()

    def _load(self, number: int, window: _Window) -> tuple[pa.Table, np.ndarray]:
        """The chosen rows of a window, and their numbers; the last one is kept in memory."""
        import pyarrow as pa

        key = (number, self.seed, self.epoch)
        if self._window is None or self._window[0] != key:
            self._window = None  # before the next is read: two would be held
            groups = [self._groups[k] for k in window.groups]
            tables = [
                _read(group.file, self._columns, group.number).take(group.kept)
                for group in groups
                if len(group.kept)
            ]
            rows = [group.first + group.kept for group in groups]
            self._window = (key, pa.concat_tables(tables).combine_chunks(), np.concatenate(rows))
        return self._window[1], self._window[2]

    def _arrays(self, table: pa.Table) -> tuple[dict[str, np.ndarray], dict[str, list[str]]]:
        import pyarrow as pa

        found, text = {}, {}
        for name in table.column_names:
            column = table.column(name).combine_chunks()
            if pa.types.is_string(column.type):
                text[name] = column.to_pylist()
                continue
            if pa.types.is_boolean(column.type):
                column = column.fill_null(False)
            flat = column
            if pa.types.is_fixed_size_list(column.type):
                flat = column.flatten()
            shape = self.release.header.shape(column_field(name))
            values = flat.to_numpy(zero_copy_only=False).reshape(table.num_rows, *shape)
            found[name] = values if values.flags.writeable else values.copy()
        if "size" not in found and "size_mm" in found:
            found["size"] = (found["size_mm"] / 1000).astype(np.float32)
        return found, text


def _read(file: Path, columns: Mapping[str, Sequence[str]], number: int) -> pa.Table:
    """Columns of a row group side by side: of a file of grasps, and of its mates of other tables.

    Raises:
        NotUsable: A mate is not there.
    """
    parts: list[pa.Table] = []
    for table, names in columns.items():
        if not names:
            continue
        head, _, rest = table.partition("/")
        folder = file.parent.name.replace("grasps", head, 1)
        mate = file.parents[1] / folder / rest / file.name
        if not mate.is_file():
            raise NotUsable(f"{mate}: not there, and columns of it are asked for; download it")
        parts += parquet.read_groups(mate, names, [number])
    found, *others = parts  # somebody asked for a column
    for part in others:
        for name in part.column_names:
            found = found.append_column(part.schema.field(name), part.column(name))
    return found
