"""What stands where in `grasps.h5`; writing and reading both go by this.

Group `/<configuration>/<split>` holds `values` and `contacts`, the float columns of the grasps and
of the contacts table, (N, W) float32 each, one row per grasp; the attribute `columns` names their
columns. Every integer or boolean column is a dataset of its own (booleans int8; -1 = null).
Where the rows stand in this file alone, text columns are datasets of UTF-8 bytes of one width,
padded with zeros, and `verdicts/<protocol>-<test>` and `arms/<rig>` are groups of the same kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction
from bidexdata.formats.tables import column_field, folder_of, value_type
from bidexdata.record import FIELDS, Header
from bidexdata.record.batch import field_metadata

if TYPE_CHECKING:
    import pyarrow as pa

TRAINING_FILE = "grasps.h5"
VALUES, CONTACTS, VERDICTS, ARMS = "values", "contacts", "verdicts", "arms"
INTEGER_LISTS = tuple(
    f.name
    for f in FIELDS.values()
    if f.table in ("grasps", "contacts") and f.axes and f.dtype.startswith("int")
)
"""Integer columns with more than one value per grasp."""

Columns = dict[str, tuple[slice, tuple[int, ...]]]
"""Column name -> its slice of W and its shape after N."""


class MappedValues(NamedTuple):
    """Float columns of one configuration and split."""

    values: NDArray[np.float32]
    """(N, W), mapped from disk or in memory."""
    columns: Columns


def group_name(configuration: str, split: str, table: str = "grasps") -> str:
    """Group of a row table; grasps and contacts share one."""
    inner = f"/{table}" if table.startswith((f"{VERDICTS}/", f"{ARMS}/")) else ""
    return f"{configuration}/{split}{inner}"


def float_layout(schema: pa.Schema) -> list[dict[str, Any]]:
    """Say which float columns of a table follow each other along W."""
    import pyarrow as pa

    header = header_of_schema(schema)
    found = []
    for field in schema:
        if pa.types.is_float32(value_type(field.type)):
            column = column_field(field.name)
            shape = header.shape(column)
            metadata = {k: v for k, v in field_metadata(column).items() if k != "shape"}
            width = int(np.prod(shape))
            found.append({"name": field.name, "shape": list(shape), "width": width, **metadata})
    return found


def layout_slices(layout: Sequence[dict[str, Any]]) -> Columns:
    """Turn the stored layout into slices of W."""
    out: Columns = {}
    at = 0
    for entry in layout:
        out[entry["name"]] = (slice(at, at + entry["width"]), tuple(entry["shape"]))
        at += entry["width"]
    return out


def fill_floats(out: np.ndarray, layout: Sequence[dict[str, Any]], table: pa.Table) -> None:
    """Write the float columns of a table side by side into `out`, (N, W)."""
    at = 0
    for entry in layout:
        column = table.column(entry["name"]).combine_chunks()
        flat = column.flatten() if entry["shape"] else column
        values = flat.to_numpy(zero_copy_only=False)
        out[:, at : at + entry["width"]] = values.reshape(len(out), entry["width"])
        at += entry["width"]


def integer_columns(schema: pa.Schema) -> list[str]:
    """Integer and boolean columns of a table."""
    import pyarrow as pa

    kinds = [(field.name, value_type(field.type)) for field in schema]
    return [n for n, kind in kinds if pa.types.is_integer(kind) or pa.types.is_boolean(kind)]


def text_columns(schema: pa.Schema) -> list[str]:
    """Text columns of a table."""
    import pyarrow as pa

    return [field.name for field in schema if pa.types.is_string(field.type)]


def integer_values(column: pa.ChunkedArray, dtype: np.dtype) -> np.ndarray:
    """An integer or boolean column as stored, (N,) or (N, K); null booleans are -1."""
    import pyarrow as pa

    array = column.combine_chunks()
    if pa.types.is_fixed_size_list(array.type):
        width = array.type.list_size
        return array.flatten().to_numpy(zero_copy_only=False).reshape(-1, width).astype(dtype)
    if pa.types.is_boolean(array.type):
        array = array.cast(pa.int8()).fill_null(-1)
    return array.to_numpy(zero_copy_only=False).astype(dtype)


def header_of_schema(schema: pa.Schema) -> Header:
    """The header in the metadata of a row table.

    Raises:
        Contradiction: There is none.
    """
    text = (schema.metadata or {}).get(b"bidexdata")
    if text is None:
        raise Contradiction("a row table has no bidexdata header")
    return Header.from_json(text)


def split_files(root: Path, table: str, configuration: str, split: str) -> list[Path]:
    """Parquet files of a row table in reading order.

    Args:
        root: Release folder.
        table: `grasps`, `contacts`, `arms/<rig>` or `verdicts/<protocol>-<test>`.
        configuration: `selected` or `audit`.
        split: One split.
    """
    return sorted((root / folder_of(table, configuration)).glob(f"{split}-*.parquet"))
