"""Rows of the row tables of a release become a batch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.errors import Contradiction
from bidexdata.formats.tables import VERDICT_COLUMNS
from bidexdata.record import GraspBatch, Header
from bidexdata.record.batch import empty_columns
from bidexdata.record.fields import columns_of_table

if TYPE_CHECKING:
    import pyarrow as pa


def join_tables(header: Header, files: Sequence[Path], parts: Sequence[pa.Table]) -> GraspBatch:
    """Make a batch of the same rows of the tables grasps, contacts and, maybe, verdicts.

    Args:
        header: The release's.
        files: Where they come from, for messages.
        parts: The rows, in that order of tables.

    Raises:
        Contradiction: They are not the same rows.
    """
    import pyarrow as pa

    batch = GraspBatch.from_arrow(parts[0])
    ids = parts[0].column("grasp_id")
    for file, part in zip(files[1:], parts[1:], strict=True):
        if not part.column("grasp_id").equals(ids):
            raise Contradiction(f"{file}: rows are not those of {files[0]}")
    contacts = GraspBatch.from_arrow(parts[1])
    more = {n: contacts[n] for n in columns_of_table("contacts")}
    if len(parts) > 2:
        at = parts[2].schema.get_field_index("success")
        success = parts[2].column("success").fill_null(False)
        verdict = parts[2].set_column(at, pa.field("success", pa.bool_()), success)
        judged = GraspBatch.from_arrow(verdict)
        late = [n for n in VERDICT_COLUMNS if header.lacks(n)]
        more |= empty_columns(batch.header, late, len(batch))
        more |= {n: judged[n] for n in VERDICT_COLUMNS if n not in late}
    return batch.with_columns(**more)
