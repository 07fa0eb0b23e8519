"""Write `grasps.h5` from the Parquet tables, row for row; see `hdf5_layout` for what stands where.

The same tables give the same bytes, so the file can be made again at any time. Datasets are
contiguous, without filters: `numpy` maps them at their byte offset. They carry no checksum of their
own; the manifest's sha256 does.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bidexdata.formats import parquet
from bidexdata.formats.hdf5_layout import (
    CONTACTS,
    TRAINING_FILE,
    VALUES,
    VERDICTS,
    fill_floats,
    float_layout,
    header_of_schema,
    integer_columns,
    integer_values,
    split_files,
    text_columns,
)
from bidexdata.formats.tables import CONFIGURATIONS, arms_tables, column_field
from bidexdata.record.batch import SCHEMA_VERSION, field_metadata

if TYPE_CHECKING:
    import h5py
    import pyarrow as pa


LIBRARY_VERSIONS = ("v110", "v114")
"""Oldest and newest version of HDF5 whose file format is used, as h5py's `libver`."""
ALIGNMENT = 64
"""Datasets begin at multiples of this [bytes]: `np.take` copies the whole of an array that does not
begin at a multiple of its numbers' size."""


def write_training_form(
    root: Path,
    splits: Sequence[str],
    *,
    about: Mapping[str, str] | None = None,
    whole_tests: Sequence[tuple[str, str]] | None = None,
) -> None:
    """Write `grasps.h5` from the Parquet tables under `root`.

    Args:
        root: Release folder.
        splits: Its splits.
        about: Attributes of the file: names and versions, see `about_release`.
        whole_tests: Where given, the file also gets the text columns, the arm solutions and the
            verdicts of these tests, so that it holds the rows alone.
    """
    import h5py

    path, bounds = root / TRAINING_FILE, LIBRARY_VERSIONS
    aligned = {"alignment_threshold": 1, "alignment_interval": ALIGNMENT}
    # Without track_times the same rows give the same bytes.
    with h5py.File(path, "w", libver=bounds, track_order=True, **aligned) as file:  # pyright: ignore[reportArgumentType]
        for key, text in (about or {"schema_version": SCHEMA_VERSION}).items():
            file.attrs[key] = text
        for configuration in CONFIGURATIONS:
            for split in splits:
                group = file.create_group(f"{configuration}/{split}", track_order=True)
                _write_group(root, group, configuration, split, whole_tests)


def about_release(head: Mapping[str, Any]) -> dict[str, str]:
    """Attributes of the file: versions, names and the header, from a manifest or its head."""
    return {
        "schema_version": head["schema_version"],
        "dataset": head["name"],
        "dataset_version": head["version"],
        "generator": head["generator"]["name"],
        "generator_version": head["generator"]["version"],
        "header": head["header"],
    }


def rebuild_training_form(root: Path) -> None:
    """Make `grasps.h5` of a release with Parquet tables again, byte for byte.

    Raises:
        Contradiction: The manifest or a table is damaged.
    """
    from bidexdata.formats.manifest import read_manifest

    manifest = read_manifest(root)
    splits = [name for name, _ in manifest["splits"]]
    write_training_form(root, splits, about=about_release(manifest))


class _Target(NamedTuple):
    """Datasets that the rows of one Parquet table go to."""

    files: list[Path]
    layout: list[dict[str, Any]]
    values: h5py.Dataset
    others: dict[str, h5py.Dataset]
    """Integers and text."""


def _write_group(
    root: Path,
    group: h5py.Group,
    configuration: str,
    split: str,
    whole_tests: Sequence[tuple[str, str]] | None,
) -> None:
    place = (configuration, split)
    whole = whole_tests is not None
    _copy(_target(group, VALUES, split_files(root, "grasps", *place), texts=whole))
    _copy(_target(group, CONTACTS, split_files(root, "contacts", *place)))
    names = [f"{VERDICTS}/{protocol}-{test}" for protocol, test in whole_tests or ()]
    schema = parquet.read_schema(split_files(root, "grasps", *place)[0])
    names += arms_tables(header_of_schema(schema)) if whole else ()
    for name in names:
        inner = group.create_group(name, track_order=True)
        _copy(_target(inner, VALUES, split_files(root, name, *place)))


def _target(group: h5py.Group, values: str, files: list[Path], *, texts: bool = False) -> _Target:
    import h5py

    schema = parquet.read_schema(files[0])
    rows = sum(sum(parquet.row_counts(file)) for file in files)
    layout = float_layout(schema)
    width = sum(entry["width"] for entry in layout)
    floats = group.create_dataset(values, (rows, width), "<f4")
    floats.attrs["columns"] = json.dumps(layout, sort_keys=True)
    others = {n: _integer_dataset(group, schema, n, rows) for n in integer_columns(schema)}
    if texts:
        for name, longest in _longest(files, text_columns(schema)).items():
            kind = h5py.string_dtype("utf-8", longest)
            others[name] = _described(group.create_dataset(name, (rows,), kind), name)
    return _Target(files, layout, floats, others)


def _integer_dataset(group: h5py.Group, schema: pa.Schema, name: str, rows: int) -> h5py.Dataset:
    column = column_field(name)
    shape = header_of_schema(schema).shape(column)
    dtype = np.dtype("int8" if column.dtype == "bool" else column.dtype).newbyteorder("<")
    return _described(group.create_dataset(name, (rows, *shape), dtype), name)


def _described(dataset: h5py.Dataset, name: str) -> h5py.Dataset:
    for key, text in field_metadata(column_field(name)).items():
        dataset.attrs[key] = text
    return dataset


def _longest(files: list[Path], names: list[str]) -> dict[str, int]:
    """Bytes of the longest text of each column; 1 at least."""
    import pyarrow.compute as pc

    found = dict.fromkeys(names, 1)
    for file in files:
        for table in parquet.read_groups(file, names):
            for name in names:
                length = pc.max(pc.binary_length(table.column(name))).as_py()  # pyright: ignore[reportAttributeAccessIssue]
                found[name] = max(found[name], length or 0)
    return found


def _copy(target: _Target) -> None:
    at = 0
    for file in target.files:
        for table in parquet.read_groups(file):
            n = table.num_rows
            block = np.empty((n, target.values.shape[1]), np.float32)
            fill_floats(block, target.layout, table)
            target.values[at : at + n] = block
            for name, dataset in target.others.items():
                dataset[at : at + n] = _plain(table.column(name), dataset)
            at += n


def _plain(column: pa.ChunkedArray, dataset: h5py.Dataset) -> np.ndarray:
    import pyarrow as pa

    if pa.types.is_string(column.type):
        return np.array(column.cast(pa.binary()).to_pylist(), dataset.dtype)
    return integer_values(column, dataset.dtype).reshape(-1, *dataset.shape[1:])
