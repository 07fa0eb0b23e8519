"""The laws of the training form: datasets that can be mapped, and values that are the tables'.

Written apart from `formats.hdf5`, from what the file says of itself: float columns stand side by
side in a dataset whose attribute `columns` names them, every other dataset is a column.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bidexdata.errors import Contradiction
from bidexdata.formats.hdf5 import TRAINING_FILE
from bidexdata.formats.row_groups import aligned
from bidexdata.formats.row_index import RowIndex
from bidexdata.wording import counted

if TYPE_CHECKING:
    from pathlib import Path

    import pyarrow as pa

    from bidexdata.formats.release import Release

_NONE = "there is no training form"


class _Slice(NamedTuple):
    """Where the training form holds one column."""

    dataset: str
    low: int
    width: int
    """Numbers per row."""


def training_layout(release: Release) -> str:
    """Check that every dataset is contiguous, little-endian, inside the file and of all rows."""
    path = release.path / TRAINING_FILE
    if not path.is_file():
        return _NONE
    spans: list[tuple[int, int, str]] = []
    with _opened(path) as file:
        for configuration in release.configurations:
            for split in release.split_names:
                rows = len(RowIndex(release, configuration, split))
                for name, dataset in _datasets(file, configuration, split):
                    spans += _span(path, name, dataset, rows)
    end = path.stat().st_size
    spans.sort()
    for (_, high, name), (low, _, other) in pairwise(spans):
        if low < high:
            raise Contradiction(f"{path}: {name} and {other} overlap")
    if spans and spans[-1][1] > end:
        raise Contradiction(f"{path}: {spans[-1][2]} ends behind the file")
    return f"{counted(len(spans), 'dataset')} contiguous, little-endian, inside the file"


def training_values(release: Release) -> str:
    """Compare every number of the training form with the tables, bit for bit."""
    path = release.path / TRAINING_FILE
    if not path.is_file():
        return _NONE
    if release.form == "hdf5":
        return "there are no tables to compare with: the rows stand in the training form alone"
    count, tables = 0, {"grasps": None, "contacts": None}
    with _opened(path) as file:
        for configuration in release.configurations:
            for split in release.split_names:
                where = f"{configuration}/{split}"
                datasets = dict(_datasets(file, configuration, split))
                slices = _slices(path, datasets)
                at = 0
                for parts in aligned(release, tables, configuration, split):
                    n = parts[0].num_rows
                    if n:
                        blocks = {k: d[at : at + n].reshape(n, -1) for k, d in datasets.items()}
                        _compare(f"{path}: {where}", at, blocks, slices, parts)
                    at += n
                count += at
    return f"{counted(count, 'row')} equal those of the tables bit by bit"


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, KeyError, ValueError, TypeError, AttributeError) as err:
        raise Contradiction(f"{path}: not a training form ({err})") from err


def _datasets(file: Any, configuration: str, split: str) -> Iterator[tuple[str, Any]]:
    import h5py

    inside = [f"{configuration}/{split}"]
    while inside:
        group = inside.pop()
        for name, found in file[group].items():
            if isinstance(found, h5py.Group):
                inside.append(f"{group}/{name}")
            else:
                yield f"{group}/{name}", found


def _span(path: Path, name: str, dataset: Any, rows: int) -> list[tuple[int, int, str]]:
    if dataset.shape[0] != rows:
        raise Contradiction(f"{path}: {name} has {dataset.shape[0]} rows, not {rows}")
    if dataset.dtype.newbyteorder("<") != dataset.dtype:
        raise Contradiction(f"{path}: {name} is not little-endian")
    if 0 in dataset.shape:
        return []
    offset = dataset.id.get_offset()
    if dataset.chunks is not None or offset is None:
        raise Contradiction(f"{path}: {name} is not contiguous")
    return [(offset, offset + dataset.size * dataset.dtype.itemsize, name)]


def _slices(path: Path, datasets: dict[str, Any]) -> dict[str, _Slice]:
    found: dict[str, _Slice] = {}
    for name, dataset in datasets.items():
        if "columns" not in dataset.attrs:
            width = int(np.prod(dataset.shape[1:]))
            found[name.rsplit("/", 1)[-1]] = _Slice(name, 0, width)
            continue
        at = 0
        for entry in json.loads(dataset.attrs["columns"]):
            found[entry["name"]] = _Slice(name, at, entry["width"])
            at += entry["width"]
        if at != dataset.shape[1]:
            raise Contradiction(f"{path}: {name} is {dataset.shape[1]} wide, its columns {at}")
    return found


def _compare(
    where: str,
    at: int,
    blocks: dict[str, np.ndarray],
    slices: dict[str, _Slice],
    tables: tuple[pa.Table, ...],
) -> None:
    import pyarrow as pa

    for table in tables:
        for field in table.schema:
            if pa.types.is_string(field.type):
                continue
            if field.name not in slices:
                raise Contradiction(f"{where}: column {field.name} is missing")
            name, low, width = slices[field.name]
            found = blocks[name][:, low : low + width]
            expected = _numbers(table.column(field.name)).reshape(table.num_rows, -1)
            if found.shape != expected.shape:
                raise Contradiction(f"{where}: {field.name} has another width than in the tables")
            wrong = _bits(found.astype(expected.dtype)) != _bits(expected)
            if wrong.any():
                row = at + int(np.flatnonzero(wrong.any(axis=1))[0])
                raise Contradiction(f"{where}: {field.name} of row {row} is not that of the tables")


def _numbers(column: pa.ChunkedArray) -> np.ndarray:
    import pyarrow as pa

    array: Any = column.combine_chunks()
    if pa.types.is_fixed_size_list(array.type):
        array = array.flatten()
    if pa.types.is_boolean(array.type):
        array = array.cast(pa.int8()).fill_null(-1)
    return array.to_numpy(zero_copy_only=False)


def _bits(values: np.ndarray) -> np.ndarray:
    # NaN equals itself here, and no two bit patterns of it are the same.
    return np.ascontiguousarray(values).view(f"u{values.dtype.itemsize}")
