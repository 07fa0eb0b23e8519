"""Columns of a release as arrays: mapped from the training form, or read from Parquet.

Splits are files of their own; here they follow each other in one numbering of rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from bidexdata.errors import NotUsable
from bidexdata.formats import hdf5
from bidexdata.formats.hdf5_layout import integer_values
from bidexdata.formats.row_index import RowIndex
from bidexdata.formats.tables import ARM_COLUMNS, arms_tables, column_field

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.formats.hdf5 import MappedValues
    from bidexdata.formats.release import Release

OF_SCENE = ("object_id", "scene_id", "setting", "size_mm")
"""Columns that the scenes table knows."""


_MOST_OF_A_ROW = 0.85
"""Measured: whole rows are gathered about a tenth faster per byte than parts of rows."""
_SHORT_ROW = 64
"""Bytes of a cache line: a shorter row comes with its first byte."""


class Rows:
    """Arrays of equal shape behind N, one after the other."""

    def __init__(self, arrays: Sequence[np.ndarray]):
        self.arrays = list(arrays)
        self.ends = np.cumsum([len(a) for a in self.arrays])
        # np.take is the faster, and copies the whole of an array that is not contiguous or aligned.
        flags = self.arrays[0].flags
        plain = len(self.arrays) == 1 and flags.c_contiguous and flags.aligned
        self._plain = np.asarray(self.arrays[0]) if plain else None
        self._first = None if self._plain is None else _first_bytes(self._plain)

    def __len__(self) -> int:
        return int(self.ends[-1]) if len(self.ends) else 0

    def take(self, rows: Int[np.ndarray, " n"]) -> np.ndarray:
        """Copy some rows, (n, ...)."""
        if self._plain is not None:
            if self._first is not None:
                # The processor fetches these all at once, the rows below one after the other:
                # a tenth off a batch of rows that lie in no cache.
                self._first[rows]
            return self._plain.take(rows, 0)
        if len(self.arrays) == 1:
            return self.arrays[0][rows]
        first = self.arrays[0]
        out = np.empty((len(rows), *first.shape[1:]), first.dtype)
        part = np.searchsorted(self.ends, rows, side="right")
        for k, array in enumerate(self.arrays):
            mine = part == k
            out[mine] = array[rows[mine] - (self.ends[k] - len(array))]
        return out


class FloatRows:
    """Some float columns that lie side by side in rows of W numbers.

    Whole rows are gathered where most of a row is asked for, else records of bytes that span the
    columns: one copy either way.
    """

    def __init__(self, parts: Sequence[MappedValues], names: Sequence[str]):
        layout = parts[0].columns  # the same in all splits
        spans = [layout[name][0] for name in names]
        low, high = min(s.start for s in spans), max(s.stop for s in spans)
        if high - low > _MOST_OF_A_ROW * parts[0].values.shape[1]:
            low, high = 0, parts[0].values.shape[1]
        self.width = high - low
        """Numbers of a row that are copied."""
        self.names = tuple(names)
        self.parts = [part.values for part in parts]
        """All float columns of each split."""
        # One view as records gives every column in its shape, without a slice and a reshape each.
        self._record = np.dtype(
            {
                "names": list(names),
                "formats": [("<f4", layout[name][1]) for name in names],
                "offsets": [4 * (span.start - low) for span in spans],
                "itemsize": 4 * self.width,
            }
        )
        self._rows = Rows([_records(part.values, low, high) for part in parts])

    def take(self, rows: Int[np.ndarray, " n"]) -> dict[str, np.ndarray]:
        """Copy some rows; columns are views of the copy."""
        block = self._rows.take(rows).view(self._record)
        return {name: block[name] for name in self.names}


def integer_rows(
    release: Release, configuration: str, splits: Sequence[str], names: Sequence[str]
) -> dict[str, Rows]:
    """Open integer and boolean columns; booleans are int8, -1 where a test was not run."""
    if not names:
        return {}
    parts = [hdf5.map_columns(release.path, configuration, split, names) for split in splits]
    return {name: Rows([part[name] for part in parts]) for name in names}


def arms_table(release: Release, name: str) -> str:
    """The release's table of arms, for the column `name` of it.

    Raises:
        NotUsable: It has none.
    """
    tables = arms_tables(release.header)
    if not tables:
        raise NotUsable(
            f"{release.path} has no arm solutions, so no {name}: pack runs that `bidexdata arms` solved"
        )
    return tables[0]


def refuse_arms(release: Release, names: Iterable[str]) -> None:
    """Refuse to go on where columns of arms are asked for and there are none.

    Raises:
        NotUsable: So it is.
    """
    for name in names:
        if name in ARM_COLUMNS:
            arms_table(release, name)


def arm_integers(
    release: Release, configuration: str, splits: Sequence[str], names: Sequence[str]
) -> dict[str, Rows]:
    """Read integer columns of arms, whatever the form of the release."""
    parts: dict[str, list[np.ndarray]] = {name: [] for name in names}
    table = arms_table(release, names[0]) if names else ""
    for split in splits if names else ():
        for group in release.row_groups(table, configuration, split, names):
            for name in names:
                column = column_field(name)
                values = integer_values(group.column(name), np.dtype(column.dtype))
                parts[name].append(values.reshape(-1, *release.header.shape(column)))
    return {name: Rows([np.concatenate(found)]) for name, found in parts.items()}


def arm_floats(
    release: Release, configuration: str, split: str, names: Sequence[str]
) -> MappedValues:
    """Map the float columns of arms, or read those that are asked for."""
    place = (release.path, configuration, split, arms_table(release, names[0]))
    return hdf5.map_values(*place) or hdf5.read_values(*place, names)


class ScalarColumns(Mapping[str, np.ndarray]):
    """The scalar columns of grasps and of arms, each read when it is asked for.

    Ids, sizes and settings come from the scenes table, integers and verdicts from the training form,
    the rest from Parquet. Nulls of `suc_*` read as False here and stay nulls in `table`.
    """

    def __init__(self, release: Release, configuration: str, split: str | None, index: RowIndex):
        self.release, self.configuration, self.index = release, configuration, index
        self._split = split
        self.splits = release.split_names if split is None else (split,)
        self._types = _scalar_types(release.table_schema("grasps", configuration))
        self._of_arms: dict[str, str] = {}
        for table in arms_tables(release.header):
            types = _scalar_types(release.table_schema(table, configuration))
            self._of_arms = {name: table for name in types if name in ARM_COLUMNS}
            self._types |= {name: types[name] for name in self._of_arms}

    def __iter__(self) -> Iterator[str]:
        return iter(self._types)

    def __len__(self) -> int:
        return len(self._types)

    def __getitem__(self, name: str) -> np.ndarray:
        from bidexdata.loaders.filters import scalar_values

        return scalar_values(self.arrow(name))

    def is_text(self, name: str) -> bool:
        """Whether a column holds text."""
        return self._types[name] == "text"

    def is_float(self, name: str) -> bool:
        """Whether a column holds floats."""
        return self._types[name] == "float"

    def is_integer(self, name: str) -> bool:
        """Whether a column holds integers or booleans."""
        return self._types[name] in ("integer", "boolean")

    def is_boolean(self, name: str) -> bool:
        """Whether a column holds booleans."""
        return self._types[name] == "boolean"

    def table(self, names: Sequence[str]) -> pa.Table:
        """Some columns of all rows."""
        import pyarrow as pa

        return pa.table({name: self.arrow(name) for name in names})

    def arrow(self, name: str) -> pa.ChunkedArray:
        """One column of all rows."""
        import pyarrow as pa

        if name in OF_SCENE:
            return pa.chunked_array([self._of_scene(name)])
        if name in self._of_arms:
            place = (self._of_arms[name], self.configuration, self._split, [name])
            return pa.concat_tables(self.release.row_groups(*place)).column(name)
        if self.is_integer(name):
            rows = integer_rows(self.release, self.configuration, self.splits, [name])[name]
            arrays = [_masked(a, boolean=self.is_boolean(name)) for a in rows.arrays]
            return pa.chunked_array(arrays)
        return self.release.index(self.configuration, self._split, [name]).column(name)

    def _of_scene(self, name: str) -> pa.Array:
        import pyarrow as pa

        index = self.index
        if name == "size_mm":
            return pa.array(index.size_mm)
        words, of = {
            "object_id": lambda: (self.release.object_ids, index.object_index),
            "scene_id": lambda: (index.scene_ids, index.scene_index),
            "setting": lambda: (("floating", "tabletop"), index.tabletop.astype(np.int32)),
        }[name]()
        # Plain text, not a dictionary: `where` compares it with text.
        return pa.DictionaryArray.from_arrays(
            pa.array(of), pa.array(list(words))
        ).dictionary_decode()


def _first_bytes(array: np.ndarray) -> np.ndarray | None:
    """The first byte of each row, (N,); None where rows are no longer than it or there are none."""
    if array.size == 0 or array.strides[0] <= _SHORT_ROW:
        return None
    return np.ndarray((len(array),), np.uint8, array, 0, (array.strides[0],))


def _records(values: np.ndarray, low: int, high: int) -> np.ndarray:
    """Columns [low, high) of rows of floats as one record of bytes per row, (N,)."""
    kind = f"V{values.dtype.itemsize * (high - low)}"
    if not len(values):
        return np.empty(0, kind)
    start = values.dtype.itemsize * low
    return np.ndarray((len(values),), kind, values, start, (values.strides[0],))


def float_values(release: Release, configuration: str, split: str, part: str) -> MappedValues:
    """Map the float columns of the grasps (`values`) or contacts table, or read them."""
    place = (release.path, configuration, split, part)
    return hdf5.map_values(*place) or hdf5.read_values(*place)


def _masked(values: np.ndarray, *, boolean: bool) -> pa.Array:
    import pyarrow as pa

    if boolean:
        return pa.array(values > 0, mask=np.asarray(values) < 0)
    return pa.array(np.asarray(values))


def scalar_columns(schema: pa.Schema) -> list[str]:
    """Columns of one value per row, in order: those that `where` may name."""
    return list(_scalar_types(schema))


def _scalar_types(schema: pa.Schema) -> dict[str, str]:
    import pyarrow as pa

    kinds = (
        ("text", pa.types.is_string),
        ("boolean", pa.types.is_boolean),
        ("integer", pa.types.is_integer),
        ("float", pa.types.is_floating),
    )
    return {f.name: word for f in schema for word, is_kind in kinds if is_kind(f.type)}
