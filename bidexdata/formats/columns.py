"""Every column of the tables of a release, for the card and for Croissant.

Made from the field tables by way of the Arrow schemas, so that what a page says of a column is
what its file says.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

from bidexdata.formats import tables
from bidexdata.formats.rows import TestKey
from bidexdata.record import Header

if TYPE_CHECKING:
    import pyarrow as pa


class Column(NamedTuple):
    """One column."""

    name: str
    dtype: str
    """`string`, `bool`, or a numpy name of a number."""
    width: int
    """Values per row; 0 for a scalar."""
    shape: str
    """Axes after the rows, as letters: H sides, S stages, J joints, C contacts."""
    unit: str
    frame: str
    description: str

    def words(self) -> str:
        """Unit, frame and meaning in one line.

        >>> Column("pd", "float32", 0, "", "m", "", "penetration").words()
        'penetration [m]'
        """
        unit = f" [{self.unit}]" if self.unit else ""
        frame = f", frame {self.frame}" if self.frame else ""
        shape = f"; {self.shape}, row-major" if self.width else ""
        return f"{self.description}{unit}{frame}{shape}"


def release_columns(header: Header, tests: Iterable[TestKey]) -> dict[str, list[Column]]:
    """Columns of every table, by its name: grasps, contacts, verdicts/<protocol>-<test>, objects ...

    Args:
        header: Of the release.
        tests: The verdict tables that it has.
    """
    schemas: Mapping[str, pa.Schema] = {
        "grasps": tables.grasps_schema(header),
        "contacts": tables.contacts_schema(header),
        **{name: tables.arms_schema(header) for name in tables.arms_tables(header)},
        **{f"verdicts/{p}-{t}": tables.verdicts_schema(header) for p, t in sorted(tests)},
        "objects": tables.plain_schema(tables.OBJECT_FIELDS),
        "scenes": tables.plain_schema(tables.SCENE_FIELDS),
        "runs": tables.plain_schema(tables.RUN_FIELDS),
    }
    return {table: [_column(field) for field in schema] for table, schema in schemas.items()}


def _column(field: pa.Field) -> Column:
    import pyarrow as pa

    said = {k.decode(): v.decode() for k, v in (field.metadata or {}).items()}
    listed = pa.types.is_fixed_size_list(field.type)
    kind = field.type.value_type if listed else field.type
    dtype = {"double": "float64", "float": "float32"}.get(str(kind), str(kind))
    width = field.type.list_size if listed else 0
    about = (said.get(k, "") for k in ("shape", "unit", "frame", "description"))
    return Column(field.name, dtype, width, *about)
