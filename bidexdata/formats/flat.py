"""The flat table: one row per grasp, scalars only, for spreadsheets and other programs.

Its columns follow from the field table: every scalar column of a grasp, then for each test of one
protocol every scalar verdict column with the test's letter behind it (`suc_f`, `drift_pos_f`),
then the metrics, the rig and every scalar column of its arms. Empty means that nothing is known: not tested, not measured, not imported.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bidexdata.formats.tables import of_first_test
from bidexdata.record import FIELDS, Field, Status
from bidexdata.record.batch import fill_value
from bidexdata.record.fields import ANALYTIC, MEASURED, TESTS, columns_of_table, columns_written_by

if TYPE_CHECKING:
    import pyarrow as pa

OF_GRASP = (*MEASURED, *ANALYTIC)
"""Verdict columns that do not depend on the test; a row's are from the first test that was run on
it."""
GRASP = tuple(n for n in columns_of_table("grasps") if not FIELDS[n].axes)
ARMS = tuple(n for n in columns_of_table("arms") if not FIELDS[n].axes)
PER_TEST = tuple(
    n for n in columns_written_by("validate") if not FIELDS[n].axes and n not in OF_GRASP
)


class Verdicts(NamedTuple):
    """Verdict columns of one test for some rows."""

    columns: Mapping[str, np.ndarray]
    tested: np.ndarray
    """Rows that the test was run on, (N,)."""


class FlatColumn(NamedTuple):
    """One column of the flat table."""

    name: str
    field: Field
    test: str = ""
    """The test whose verdict it is; empty for a column of the grasp or a metric."""

    @property
    def is_label(self) -> bool:
        """Whether a status stands in words."""
        return self.field.name.endswith("_status")


def flat_columns() -> list[FlatColumn]:
    """All columns in order but two: `protocol`, before the first verdict, and `rig`, before the arms."""
    tests = [
        FlatColumn(f"suc_{test}" if name == "success" else f"{name}_{test}", FIELDS[name], test)
        for test in TESTS
        for name in PER_TEST
    ]
    measured = [FlatColumn(name, FIELDS[name]) for name in OF_GRASP if name in FIELDS]
    arms = [FlatColumn(name, FIELDS[name]) for name in ARMS]
    return [*(FlatColumn(name, FIELDS[name]) for name in GRASP), *tests, *measured, *arms]


def flat_schema() -> pa.Schema:
    """Arrow schema of the flat table; every column may be empty."""
    import pyarrow as pa

    fields = [pa.field(c.name, _kind(c)) for c in flat_columns()]
    fields.insert(len(GRASP), pa.field("protocol", pa.string()))
    fields.insert(len(fields) - len(ARMS), pa.field("rig", pa.string()))
    return pa.schema(fields)


def flat_rows(
    columns: Mapping[str, np.ndarray],
    verdicts: Mapping[str, Verdicts],
    protocol: str,
    rig: str = "",
) -> pa.Table:
    """Make rows of the flat table.

    Args:
        columns: Columns of grasps and arms by name; those that are missing stay empty.
        verdicts: Per test; missing ones stay empty.
        protocol: Whose verdicts they are; empty where there are none.
        rig: Whose arms they are; likewise.
    """
    import pyarrow as pa

    n = len(columns["grasp_id"])
    tests = [verdicts[test] for test in TESTS if test in verdicts]
    words = {"protocol": protocol, "rig": rig}
    arrays: dict[str, Any] = {k: pa.array([w or None] * n, pa.string()) for k, w in words.items()}
    for column in flat_columns():
        name = column.field.name
        if name in GRASP or name in ARMS:
            values, known = columns.get(name), np.ones(n, bool)
        elif not column.test:
            values, known = of_first_test(name, n, tests), np.ones(n, bool)
        elif column.test in verdicts:
            values, known = verdicts[column.test].columns.get(name), verdicts[column.test].tested
        else:
            values, known = None, np.zeros(n, bool)
        arrays[column.name] = _array(column, values, known, n)
    schema = flat_schema()
    return pa.Table.from_arrays([arrays[name] for name in schema.names], schema=schema)


def _array(column: FlatColumn, values: np.ndarray | None, known: np.ndarray, n: int) -> pa.Array:
    import pyarrow as pa

    if values is None:
        return pa.nulls(n, _kind(column))
    empty = ~known | _is_fill(column.field, values)
    if column.is_label:
        values = np.array([Status(int(v)).label if v >= 0 else "" for v in values], np.str_)
    if values.dtype.kind == "U":
        pairs = zip(values.tolist(), empty.tolist(), strict=True)
        return pa.array([None if e else v for v, e in pairs], pa.string())
    return pa.array(np.ascontiguousarray(values), _kind(column), mask=empty)


def _is_fill(field: Field, values: np.ndarray) -> np.ndarray:
    """Rows that hold the value for "no value"; False is a value."""
    if field.dtype == "bool":
        return np.zeros(len(values), bool)
    if field.dtype == "float32":
        return np.isnan(values)
    return values == fill_value(field)


def _kind(column: FlatColumn) -> pa.DataType:
    import pyarrow as pa

    if column.is_label or column.field.dtype == "string":
        return pa.string()
    return pa.type_for_alias(column.field.dtype)
