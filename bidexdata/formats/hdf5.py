"""The training form: `grasps.h5`, contiguous datasets that `numpy` maps at their byte offset.

Derived from the Parquet tables, row for row, and rebuildable from them. Group
`/<configuration>/<split>` holds `values` (N, W) float32, one row per grasp, whose columns the
attribute `columns` names, and one dataset per integer or boolean column (`suc_*`: -1 = not
tested). Text columns stay in Parquet. Contiguous data carry no checksum of their own; the
manifest's sha256 does.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction
from bidexdata.formats import parquet
from bidexdata.formats.tables import CONFIGURATIONS, column_field
from bidexdata.record import FIELDS, Header
from bidexdata.record.batch import SCHEMA_VERSION, field_metadata

if TYPE_CHECKING:
    import h5py
    import pyarrow as pa

TRAINING_FILE = "grasps.h5"
INTEGER_LISTS = tuple(
    f.name
    for f in FIELDS.values()
    if f.table in ("grasps", "contacts") and f.axes and f.dtype.startswith("int")
)
"""Integer columns with more than one value per grasp."""


class MappedValues(NamedTuple):
    """Float columns of one configuration and split."""

    values: NDArray[np.float32]
    """(N, W), mapped from disk or in memory."""
    columns: dict[str, tuple[slice, tuple[int, ...]]]
    """Column name -> its slice of W and its shape after N."""


def write_training_form(root: Path, splits: tuple[str, ...]) -> None:
    """Write `grasps.h5` from the Parquet tables under `root`."""
    import h5py

    # Without track_times the same rows give the same bytes.
    with h5py.File(root / TRAINING_FILE, "w", libver=("v110", "v114"), track_order=True) as file:
        file.attrs["schema_version"] = SCHEMA_VERSION
        for configuration in CONFIGURATIONS:
            for split in splits:
                group = file.create_group(f"{configuration}/{split}", track_order=True)
                _write_group(root, group, configuration, split)


def map_values(root: Path, configuration: str, split: str) -> MappedValues | None:
    """Map the float columns from `grasps.h5`; None where the release has no training form.

    Raises:
        Contradiction: The file cannot be read as the training form.
    """
    import h5py

    path = root / TRAINING_FILE
    if not path.is_file():
        return None
    try:
        with h5py.File(path, "r") as file:
            dataset: Any = file[f"{configuration}/{split}/values"]
            layout = json.loads(dataset.attrs["columns"])
            shape, offset, dtype = dataset.shape, dataset.id.get_offset(), dataset.dtype
    except (OSError, KeyError, ValueError) as err:
        raise Contradiction(f"{path}: not a training form ({err})") from err
    columns = layout_slices(layout)
    if 0 in shape:
        return MappedValues(np.zeros(shape, np.float32), columns)
    if offset is None or dtype != np.dtype("<f4"):
        raise Contradiction(f"{path}: values are not contiguous little-endian float32")
    return MappedValues(np.memmap(path, "<f4", "r", offset, shape), columns)


def read_values(root: Path, configuration: str, split: str) -> MappedValues:
    """Read the same array from the Parquet tables into memory."""
    files = list(_pairs(root, configuration, split))
    layout = _layout(*(parquet.read_schema(path) for path in files[0]))
    rows = sum(sum(parquet.row_counts(grasps)) for grasps, _ in files)
    width = sum(entry["width"] for entry in layout)
    values = np.empty((rows, width), np.float32)
    at = 0
    for tables in _groups(files):
        n = tables[0].num_rows
        _fill(values[at : at + n], layout, tables)
        at += n
    return MappedValues(values, layout_slices(layout))


def read_integer_lists(
    root: Path, configuration: str, split: str, names: Sequence[str]
) -> dict[str, NDArray[np.integer]]:
    """Read integer list columns (`INTEGER_LISTS`) from the Parquet tables into memory."""
    if not names:
        return {}
    found: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for tables in _groups(list(_pairs(root, configuration, split))):
        header = _header(tables[0].schema)
        for name in names:
            column = column_field(name)
            values = _integer_values(_column(tables, name), np.dtype(column.dtype))
            found[name].append(values.reshape(-1, *header.shape(column)))
    return {name: np.concatenate(parts) for name, parts in found.items()}


def layout_slices(layout: list[dict[str, Any]]) -> dict[str, tuple[slice, tuple[int, ...]]]:
    """Turn the stored layout into slices of W."""
    out, at = {}, 0
    for entry in layout:
        out[entry["name"]] = (slice(at, at + entry["width"]), tuple(entry["shape"]))
        at += entry["width"]
    return out


def _write_group(root: Path, group: h5py.Group, configuration: str, split: str) -> None:
    files = list(_pairs(root, configuration, split))
    schemas = tuple(parquet.read_schema(path) for path in files[0])
    rows = sum(sum(parquet.row_counts(grasps)) for grasps, _ in files)
    layout = _layout(*schemas)
    width = sum(entry["width"] for entry in layout)
    values = group.create_dataset("values", (rows, width), "<f4")
    values.attrs["columns"] = json.dumps(layout, sort_keys=True)
    others = {name: _integer_dataset(group, schemas, name, rows) for name in _integers(*schemas)}
    at = 0
    for tables in _groups(files):
        n = tables[0].num_rows
        block = np.empty((n, width), np.float32)
        _fill(block, layout, tables)
        values[at : at + n] = block
        for name, dataset in others.items():
            block = _integer_values(_column(tables, name), dataset.dtype)
            dataset[at : at + n] = block.reshape(n, *dataset.shape[1:])
        at += n


def _pairs(root: Path, configuration: str, split: str) -> Iterator[tuple[Path, Path]]:
    suffix = "" if configuration == "selected" else f"_{configuration}"
    for grasps in sorted((root / f"grasps{suffix}").glob(f"{split}-*.parquet")):
        yield grasps, root / f"contacts{suffix}" / grasps.name


def _groups(files: list[tuple[Path, Path]]) -> Iterator[tuple[pa.Table, pa.Table]]:
    for grasps, contacts in files:
        yield from zip(parquet.read_groups(grasps), parquet.read_groups(contacts), strict=True)


def _layout(*schemas: pa.Schema) -> list[dict[str, Any]]:
    import pyarrow as pa

    header = _header(schemas[0])
    found = []
    for schema in schemas:
        for field in schema:
            kind = field.type.value_type if pa.types.is_fixed_size_list(field.type) else field.type
            if pa.types.is_float32(kind):
                column = column_field(field.name)
                shape = header.shape(column)
                width = int(np.prod(shape))
                entry = {"name": field.name, "shape": list(shape), "width": width}
                found.append(
                    {**entry, **{k: v for k, v in field_metadata(column).items() if k != "shape"}}
                )
    return found


def _header(schema: pa.Schema) -> Header:
    return Header.from_json((schema.metadata or {})[b"bidexdata"])


def _integers(*schemas: pa.Schema) -> list[str]:
    import pyarrow as pa

    found = []
    for schema in schemas:
        for field in schema:
            kind = field.type.value_type if pa.types.is_fixed_size_list(field.type) else field.type
            if pa.types.is_integer(kind) or pa.types.is_boolean(kind):
                found.append(field.name)
    return found


def _integer_dataset(
    group: h5py.Group, schemas: tuple[pa.Schema, ...], name: str, rows: int
) -> h5py.Dataset:
    column = column_field(name)
    shape = _header(schemas[0]).shape(column)
    dtype = "int8" if column.dtype == "bool" else column.dtype
    dataset = group.create_dataset(name, (rows, *shape), dtype)
    for key, text in field_metadata(column).items():
        dataset.attrs[key] = text
    return dataset


def _fill(out: np.ndarray, layout: list[dict[str, Any]], tables: tuple[pa.Table, ...]) -> None:
    at = 0
    for entry in layout:
        column = _column(tables, entry["name"]).combine_chunks()
        flat = column.flatten() if entry["shape"] else column
        values = flat.to_numpy(zero_copy_only=False)
        out[:, at : at + entry["width"]] = values.reshape(len(out), entry["width"])
        at += entry["width"]


def _integer_values(column: pa.ChunkedArray, dtype: np.dtype) -> np.ndarray:
    import pyarrow as pa

    array = column.combine_chunks()
    if pa.types.is_fixed_size_list(array.type):
        width = array.type.list_size
        return array.flatten().to_numpy(zero_copy_only=False).reshape(-1, width).astype(dtype)
    if pa.types.is_boolean(array.type):
        array = array.cast(pa.int8()).fill_null(-1)
    return array.to_numpy(zero_copy_only=False).astype(dtype)


def _column(tables: tuple[pa.Table, ...], name: str) -> pa.ChunkedArray:
    return next(t.column(name) for t in tables if name in t.column_names)
