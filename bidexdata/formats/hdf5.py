"""The training form: `grasps.h5`, contiguous datasets that `numpy` maps at their byte offset.

Derived from the Parquet tables, row for row, and rebuildable from them; a release of the form
`hdf5` has its rows here alone. `hdf5_layout` says what stands where. Up to schema 1.2 `values` held
the float columns of contacts too.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction, NotUsable, UnknownName
from bidexdata.formats import parquet
from bidexdata.formats.hdf5_layout import ARMS as ARMS
from bidexdata.formats.hdf5_layout import CONTACTS as CONTACTS
from bidexdata.formats.hdf5_layout import INTEGER_LISTS as INTEGER_LISTS
from bidexdata.formats.hdf5_layout import TRAINING_FILE as TRAINING_FILE
from bidexdata.formats.hdf5_layout import VALUES as VALUES
from bidexdata.formats.hdf5_layout import MappedValues as MappedValues
from bidexdata.formats.hdf5_layout import (
    fill_floats,
    float_layout,
    group_name,
    header_of_schema,
    integer_values,
    layout_slices,
    split_files,
    text_columns,
)
from bidexdata.formats.hdf5_writer import about_release as about_release
from bidexdata.formats.hdf5_writer import rebuild_training_form as rebuild_training_form
from bidexdata.formats.hdf5_writer import write_training_form as write_training_form
from bidexdata.formats.manifest import read_manifest
from bidexdata.formats.tables import column_field, folder_of

if TYPE_CHECKING:
    import h5py
    import pyarrow as pa

_FLOAT = np.dtype("<f4")


def map_values(
    root: Path, configuration: str, split: str, part: str = VALUES
) -> MappedValues | None:
    """Map float columns from `grasps.h5`; None where the release has no training form.

    Args:
        root: Release folder.
        configuration: `selected` or `audit`.
        split: One split.
        part: `values` (columns of grasps), `contacts`, or a table of arms, which only a file that
            holds the rows alone has; a file of schema 1.2 or before gives grasps and contacts for
            either.

    Raises:
        Contradiction: The file cannot be read as the training form.
    """
    path = root / TRAINING_FILE
    if not path.is_file():
        return None
    with _opened(path) as file:
        if part.startswith(f"{ARMS}/"):
            inner: Any = file.get(group_name(configuration, split, part))
            return None if inner is None else _mapped_floats(path, inner[VALUES])
        group: Any = file[group_name(configuration, split)]
        return _mapped_floats(path, group[part if part in group else VALUES])


def map_columns(
    root: Path, configuration: str, split: str, names: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Give float and integer columns of grasps and contacts by name, (N, ...) each.

    Mapped from the training form; read from Parquet into memory where there is none. Booleans are
    int8, and -1 where the table has null.

    Raises:
        UnknownName: No float or integer column is called so.
        NotUsable: There is no training form, and a Parquet file is not there.
        Contradiction: The file cannot be read as the training form.
    """
    path = root / TRAINING_FILE
    if not path.is_file():
        return _read_columns(root, configuration, split, names)
    with _opened(path) as file:
        group: Any = file[group_name(configuration, split)]
        parts = [_mapped_floats(path, group[p]) for p in (VALUES, CONTACTS) if p in group]
        floats = {n: (part.values, *part.columns[n]) for part in parts for n in part.columns}
        others = [n for n in group if n not in (VALUES, CONTACTS) and _is_integer(group[n])]
        found = {}
        for name in names:
            if name in floats:
                values, place, shape = floats[name]
                found[name] = values[:, place].reshape(len(values), *shape)
            elif name in others:
                found[name] = _mapped(path, group[name])
            else:
                raise UnknownName("column", name, sorted([*floats, *others]))
    return found


def read_values(
    root: Path,
    configuration: str,
    split: str,
    part: str = VALUES,
    columns: Sequence[str] | None = None,
) -> MappedValues:
    """Read what `map_values` maps, or some columns of it, from the Parquet tables into memory.

    Raises:
        NotUsable: A file is not there.
    """
    table = {CONTACTS: "contacts", VALUES: "grasps"}.get(part, part)
    files = _all_files(root, table, configuration, split)
    layout = float_layout(parquet.read_schema(files[0]))
    if columns is not None:
        layout = [entry for entry in layout if entry["name"] in columns]
    names = [entry["name"] for entry in layout]
    rows = sum(sum(parquet.row_counts(file)) for file in files)
    values = np.empty((rows, sum(entry["width"] for entry in layout)), np.float32)
    at = 0
    for file in files:
        for group in parquet.read_groups(file, names):
            fill_floats(values[at : at + group.num_rows], layout, group)
            at += group.num_rows
    return MappedValues(values, layout_slices(layout))


def count_rows(root: Path, configuration: str, split: str) -> int:
    """Rows of one split, from the training form.

    Raises:
        Contradiction: The file cannot be read as the training form.
    """
    with _opened(root / TRAINING_FILE) as file:
        dataset: Any = file[f"{group_name(configuration, split)}/{VALUES}"]
        return len(dataset)


def read_rows(
    root: Path,
    table: str,
    configuration: str,
    split: str,
    schema: pa.Schema,
    low: int,
    high: int,
) -> pa.Table:
    """Read rows [low, high) of a row table from a file that holds the rows alone.

    Args:
        root: Release folder.
        table: `grasps`, `contacts` or `verdicts/<protocol>-<test>`.
        configuration: `selected` or `audit`.
        split: One split.
        schema: Columns to read, as the Parquet table has them.
        low: First row.
        high: Row behind the last.

    Raises:
        Contradiction: The file is damaged, or holds no rows of its own.
    """
    import pyarrow as pa

    path = root / TRAINING_FILE
    with _opened(path) as file:
        main: Any = file[group_name(configuration, split)]
        group: Any = file[group_name(configuration, split, table)]
        floats = _mapped_floats(path, group[CONTACTS if table == "contacts" else VALUES])
        arrays = []
        for field in schema:
            if field.name in floats.columns:
                place, _ = floats.columns[field.name]
                values = floats.values[low:high, place]
            elif pa.types.is_string(field.type):
                values = main[field.name][low:high]  # grasp_id stands with the grasps alone
            else:
                values = group[field.name][low:high]
            arrays.append(_arrow_array(np.asarray(values), field))
    if len({len(array) for array in arrays}) > 1:
        raise Contradiction(f"{path}: columns of {table} differ in length")
    return pa.Table.from_arrays(arrays, schema=schema)


def _arrow_array(values: np.ndarray, field: pa.Field) -> pa.Array:
    import pyarrow as pa

    kind = field.type
    if pa.types.is_string(kind):
        return pa.array([v.decode() for v in values.tolist()], kind)
    if pa.types.is_boolean(kind):
        return pa.array(values == 1, kind, mask=values < 0 if field.nullable else None)
    flat = np.ascontiguousarray(values).reshape(-1)
    if pa.types.is_fixed_size_list(kind):
        return pa.FixedSizeListArray.from_arrays(pa.array(flat, kind.value_type), type=kind)
    return pa.array(flat, kind)


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, KeyError, ValueError, RuntimeError) as err:
        raise Contradiction(f"{path}: not a training form ({err})") from err


def _mapped_floats(path: Path, dataset: h5py.Dataset) -> MappedValues:
    columns = layout_slices(json.loads(dataset.attrs["columns"]))  # pyright: ignore[reportArgumentType]
    if dataset.dtype != _FLOAT:
        raise Contradiction(f"{path}: {dataset.name} is not little-endian float32")
    return MappedValues(_mapped(path, dataset), columns)


def _mapped(path: Path, dataset: h5py.Dataset) -> NDArray[Any]:
    shape, dtype, offset = dataset.shape, dataset.dtype, dataset.id.get_offset()
    if 0 in shape:
        return np.zeros(shape, dtype)
    if offset is None or dtype.byteorder == ">":
        raise Contradiction(f"{path}: {dataset.name} is not contiguous and little-endian")
    return np.memmap(path, dtype, "r", offset, shape)


def _is_integer(dataset: Any) -> bool:
    dtype = getattr(dataset, "dtype", None)  # groups have none
    return dtype is not None and dtype.kind == "i"


def _read_columns(
    root: Path, configuration: str, split: str, names: Sequence[str]
) -> dict[str, NDArray[Any]]:
    parts: dict[str, list[np.ndarray]] = {name: [] for name in names}
    known: list[str] = []
    for table in ("grasps", "contacts"):
        files = _all_files(root, table, configuration, split)
        schema = parquet.read_schema(files[0])
        header, texts = header_of_schema(schema), text_columns(schema)
        here = [n for n in schema.names if n not in texts]
        known += here
        mine = [n for n in names if n in here]
        for file in files if mine else ():
            for group in parquet.read_groups(file, mine):
                for name in mine:
                    column = column_field(name)
                    values = _numbers(group.column(name), column.dtype)
                    parts[name].append(values.reshape(-1, *header.shape(column)))
    for name in names:
        if name not in known:
            raise UnknownName("column", name, sorted(known))
    return {name: np.concatenate(found) for name, found in parts.items()}


def _all_files(root: Path, table: str, configuration: str, split: str) -> list[Path]:
    """Parquet files of a split of a row table: all that the manifest names.

    Raises:
        NotUsable: One of them is not there, as after a partial download.
    """
    head = f"{folder_of(table, configuration)}/{split}-"
    named = sorted(n for n in read_manifest(root)["files"] if n.startswith(head))
    for name in named or [TRAINING_FILE]:
        if not (root / name).is_file():
            raise NotUsable(
                f"{root / name} is not there, though the manifest names it: download it"
                + (", or read the files that are there with BiDexStream" if named else "")
            )
    return split_files(root, table, configuration, split)


def _numbers(column: pa.ChunkedArray, dtype: str) -> np.ndarray:
    import pyarrow as pa

    if dtype != "float32":
        return integer_values(column, np.dtype("int8" if dtype == "bool" else dtype))
    array = column.combine_chunks()
    flat = array.flatten() if pa.types.is_fixed_size_list(array.type) else array
    return flat.to_numpy(zero_copy_only=False)
