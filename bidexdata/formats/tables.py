"""Columns that only a release has, and the tables that a release consists of.

The record's own columns are in `record.fields`; a release adds `run` and the verdict booleans to
the grasps table, and has the tables objects, scenes and runs. Documentation and file metadata are
generated from both lists.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.record import FIELDS, Field, Header
from bidexdata.record.batch import arrow_schema, field_metadata, fill_value, number_of
from bidexdata.record.fields import MEASURED, TESTS, columns_of_table, columns_written_by

if TYPE_CHECKING:
    import pyarrow as pa

CONFIGURATIONS = ("selected", "audit")
SORTED_BY = ("object_id", "size_mm", "scene_id", "grasp_id")
"""Order of the rows in the grasps, contacts and verdict tables."""


# fmt: off
GRASP_EXTRAS = (
    Field("run", "string", "", "", "", "pack", "grasps", "name of the run in runs.parquet"),
    Field("suc_f", "bool", "", "", "", "pack", "grasps", "passed test f (force closure) of the default protocol; null = not tested"),
    Field("suc_l", "bool", "", "", "", "pack", "grasps", "passed test l (lift) of the default protocol; null = not tested"),
    Field("suc_a", "bool", "", "", "", "pack", "grasps", "passed test a (lift with arms) of the default protocol; null = not tested"),
)

OBJECT_FIELDS = (
    Field("object_id", "string", "", "", "", "pack", "objects", "identity; folder objects/<first 2 of its hex digits>/<object_id>"),
    Field("cloud_index", "int32", "", "", "", "pack", "objects", "row of the object in clouds/*.npy; -1 = this release has no clouds"),
    Field("split", "string", "", "", "", "pack", "objects", "train or test; all = its sizes are in different splits"),
    Field("source", "string", "", "", "", "prepare", "objects", "collection that the mesh comes from; unknown = not stated"),
    Field("source_name", "string", "", "", "", "prepare", "objects", "name of the source file"),
    Field("source_sha256", "string", "", "", "", "prepare", "objects", "sha256 of the source file"),
    Field("shape_sha256", "string", "", "", "", "pack", "objects", "sha256 of the repaired mesh's and the pieces' arrays; no shape is in two splits, unless they are by size"),
    Field("licence", "string", "", "", "", "prepare", "objects", "SPDX identifier of the mesh's licence; unknown = the source states none that is known"),
    Field("uri", "string", "", "", "", "prepare", "objects", "web address of the source; empty = none stated, and source names the collection"),
    Field("author", "string", "", "", "", "prepare", "objects", "author of the mesh; unknown = the source names none"),
    Field("category", "string", "", "", "", "prepare", "objects", "category given by the source; unknown = none"),
    Field("pieces", "int32", "", "", "", "pack", "objects", "number of convex pieces"),
    Field("volume", "float32", "", "", "object", "pack", "objects", "volume of the solid at unit diagonal"),
    Field("nominal_volume", "float32", "", "", "object", "pack", "objects", "volume at unit diagonal that a protocol's fixed mass belongs to: the body weighs mass x volume / nominal_volume"),
    Field("rest_poses", "int32", "", "", "", "pack", "objects", "number of rest poses on a table"),
    Field("recipe", "string", "", "", "", "prepare", "objects", "JSON: how the solid was made of the source file (piece_method, repair_steps, origin_in_file, unit_in_file where known)"),
)

SCENE_FIELDS = (
    Field("scene_id", "string", "", "", "", "synth", "scenes", "<object_id>/<size_mm>/float or .../table<k>"),
    Field("object_id", "string", "", "", "", "synth", "scenes", "object of the scene"),
    Field("size_mm", "int32", "", "mm", "", "synth", "scenes", "bounding-box diagonal of the simulated solid"),
    Field("setting", "string", "", "", "", "synth", "scenes", "floating or tabletop"),
    Field("table", "bool", "", "", "", "synth", "scenes", "there is a table; its surface is z = 0"),
    Field("object_pos", "float32", "3", "m", "world", "synth", "scenes", "origin of the object frame; NaN = a scene on a table that no row is stored of, or whose rows differ"),
    Field("object_quat_wxyz", "float32", "4", "", "world", "synth", "scenes", "orientation of the object frame, unit, w >= 0; NaN as object_pos"),
    Field("mass", "float32", "", "kg", "", "pack", "scenes", "mass of the object under the default protocol; NaN = the release has no settings of it"),
    Field("friction", "float32", "", "", "", "pack", "scenes", "tangential friction of every surface under the default protocol; NaN as mass"),
    Field("split", "string", "", "", "", "pack", "scenes", "train or test"),
    Field("runs", "int32", "", "", "", "pack", "scenes", "number of runs that worked on the scene"),
    Field("grasps_wanted", "int32", "", "", "", "pack", "scenes", "grasps to keep (N), summed over the runs; 0 where none has such a number"),
    Field("selected_rows", "int32", "", "", "", "pack", "scenes", "rows in the configuration selected"),
    Field("audit_rows", "int32", "", "", "", "pack", "scenes", "rows in the configuration audit"),
    Field("attempts", "string", "", "", "", "synth", "scenes", "JSON: attempts per status label, rows that were not stored included"),
)

RUN_FIELDS = (
    Field("run", "string", "", "", "", "pack", "runs", "name of the run within the release"),
    Field("fingerprint", "string", "", "", "", "synth", "runs", "fingerprint of the run's configuration"),
    Field("library_fingerprint", "string", "", "", "", "prepare", "runs", "fingerprint of the object library"),
    Field("grasps", "int32", "", "", "", "synth", "runs", "grasps kept per scene (N); -1 = imported, or rows chosen one by one: no unselected rate"),
    Field("candidates", "int32", "", "", "", "synth", "runs", "attempts per scene (M); -1 = unknown"),
    Field("seed", "int64", "", "", "", "synth", "runs", "seed of the run"),
    Field("preset", "string", "", "", "", "synth", "runs", "preset (or, of a peer, method) that the configuration started from"),
    Field("setting", "string", "", "", "", "synth", "runs", "floating or tabletop"),
    Field("rig", "string", "", "", "", "synth", "runs", "rig that the run's grasps were made for (synth --rig); empty = for none"),
    Field("generator_version", "string", "", "", "", "synth", "runs", "version of bidexdata that made the run"),
    Field("config", "string", "", "", "", "synth", "runs", "canonical JSON of the whole configuration"),
)
# fmt: on

PLAIN_ADDED_IN = {
    **dict.fromkeys(("table", "object_pos", "object_quat_wxyz", "mass", "friction"), "1.3"),
    **dict.fromkeys(("uri", "nominal_volume", "recipe"), "1.3"),
    "rig": "1.4",
}
"""Schema version that brought a column of the objects, scenes or runs table."""
_EMPTY: dict[str, Any] = {"string": "", "bool": False, "float32": math.nan}

NULLABLE = tuple(f"suc_{test}" for test in TESTS)

GRASP_COLUMNS = columns_of_table("grasps")
CONTACT_COLUMNS = columns_of_table("contacts")
ARM_COLUMNS = columns_of_table("arms")
VERDICT_COLUMNS = columns_written_by("validate")


def grasps_schema(header: Header) -> pa.Schema:
    """Schema of the grasps table: the record's columns, the run, verdicts and metrics.

    The metrics are those of the default protocol, repeated from its verdict tables: each row's from
    the first test that was run on it.
    """
    import pyarrow as pa

    schema = arrow_schema(header, GRASP_COLUMNS)
    for extra in GRASP_EXTRAS:
        schema = schema.append(_arrow_field(extra))
    metrics = arrow_schema(header, MEASURED)
    return pa.schema([*schema, *metrics], metadata=schema.metadata)


def contacts_schema(header: Header) -> pa.Schema:
    """Schema of the contacts table: one row per row of the grasps table, same order."""
    return arrow_schema(header, ("grasp_id", *CONTACT_COLUMNS))


def arms_schema(header: Header) -> pa.Schema:
    """Schema of the table of arm solutions; rows as in the grasps table, status -1 = not asked for."""
    return arrow_schema(header, ("grasp_id", *ARM_COLUMNS))


def arms_tables(header: Header) -> tuple[str, ...]:
    """The tables of arm solutions of a release with this header: `arms/<rig>`, or none."""
    return tuple(dict.fromkeys(f"arms/{arm.rig}" for arm in header.arms))


def folder_of(table: str, configuration: str) -> str:
    """Folder of a row table's Parquet files in a release.

    >>> folder_of("grasps", "selected"), folder_of("verdicts/paper-1-f", "audit")
    ('grasps', 'verdicts_audit/paper-1-f')
    """
    first, slash, rest = table.partition("/")
    suffix = "" if configuration == "selected" else f"_{configuration}"
    return f"{first}{suffix}{slash}{rest}"


def row_schema(table: str, header: Header) -> pa.Schema:
    """Schema of a row table by its name."""
    make = {
        "grasps": grasps_schema,
        "contacts": contacts_schema,
        "arms": arms_schema,
        "verdicts": verdicts_schema,
    }[table.partition("/")[0]]
    return make(header)


def verdicts_schema(header: Header) -> pa.Schema:
    """Schema of one verdict table; rows as in the grasps table, `success` null = not tested."""
    schema = arrow_schema(header, ("grasp_id", *VERDICT_COLUMNS))
    at = schema.get_field_index("success")
    return schema.set(at, schema.field(at).with_nullable(True))


def plain_schema(fields: tuple[Field, ...]) -> pa.Schema:
    """Schema of the objects, scenes or runs table."""
    import pyarrow as pa

    return pa.schema([_arrow_field(f) for f in fields])


def plain_lacks(header: Header, name: str) -> bool:
    """Whether a release with this header was written before a column of a plain table existed."""
    version = PLAIN_ADDED_IN.get(name)
    return version is not None and number_of(header.schema_version) < number_of(version)


def completed(table: pa.Table, fields: tuple[Field, ...]) -> pa.Table:
    """A plain table with the columns that its schema lacks, which say nothing: NaN, empty, False."""
    import pyarrow as pa

    for field in plain_schema(fields):
        if field.name not in table.column_names:
            value = _EMPTY.get(next(f.dtype for f in fields if f.name == field.name), -1)
            if pa.types.is_fixed_size_list(field.type):
                value = [value] * field.type.list_size
            column = pa.array([value] * table.num_rows, field.type)
            table = table.append_column(field, column)
    return table


def with_fields(schema: pa.Schema, fields: Sequence[pa.Field]) -> pa.Schema:
    """A schema of other fields with the same metadata, the header."""
    import pyarrow as pa

    return pa.schema(fields, metadata=schema.metadata)


def value_type(kind: pa.DataType) -> pa.DataType:
    """Type of a column's numbers, whatever its shape."""
    import pyarrow as pa

    return kind.value_type if pa.types.is_fixed_size_list(kind) else kind


def of_first_test(
    name: str, n: int, tests: Iterable[tuple[Mapping[str, np.ndarray], np.ndarray]]
) -> np.ndarray:
    """Give a verdict column as the first test says that was run on each row.

    Args:
        name: A column of one number per row that does not depend on the test.
        n: Number of rows; those that no test was run on have the value for "no value".
        tests: In order of preference, columns by name and the rows that the test was run on, (N,).
    """
    values = np.full(n, fill_value(FIELDS[name]), FIELDS[name].dtype)
    left = np.ones(n, bool)
    for columns, tested in tests:
        if name in columns:
            values[left & tested] = columns[name][left & tested]
            left &= ~tested
    return values


def column_field(name: str) -> Field:
    """The field-table row of a column of the grasps table."""
    extras = {f.name: f for f in GRASP_EXTRAS}
    return extras[name] if name in extras else FIELDS[name]


def _arrow_field(column: Field) -> pa.Field:
    import pyarrow as pa

    kind = pa.string() if column.dtype == "string" else pa.type_for_alias(column.dtype)
    if column.axes:  # of plain tables: numbers alone, for they know no hands
        size = math.prod(int(axis) for axis in column.axes)
        kind = pa.list_(pa.field("element", kind, nullable=False), size)
    nullable = column.name in NULLABLE
    return pa.field(column.name, kind, nullable=nullable, metadata=field_metadata(column))
