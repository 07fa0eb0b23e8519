"""Apply a selection to the rows of an index: bounds on traits first, then near duplicates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bidexdata.objects.config import SelectConfig
from bidexdata.objects.selection import near_duplicates, outside
from bidexdata.objects.storage import read_document
from bidexdata.record.status import Status
from bidexdata.runs.prepare_parts import Row


def reason_row(status: Status, reason: str, sentence: str = "") -> Row:
    """The columns of the index that say what became of an input.

    Args:
        status: What.
        reason: Why, with figures.
        sentence: What in a sentence, where that of the status does not fit.
    """
    text = reason and f"{sentence or status.sentence}: {reason}"
    return {"status": int(status), "status_label": status.label, "reason": text}


def leave_out(rows: Sequence[Row], folders: Mapping[int, Path], config: SelectConfig) -> list[Row]:
    """Mark in the rows of an index what the selection leaves out and what is like an earlier input.

    Args:
        rows: Of the index, one per input; only prepared ones are looked at.
        folders: Of the prepared objects, by number of the input.
        config: The selection.
    """
    marked = list(rows)
    for number in folders:
        reason = outside(rows[number], config)
        if reason:
            marked[number] = rows[number] | reason_row(Status.NOT_SELECTED, reason)
    left = [n for n in sorted(folders) if marked[n]["status"] == Status.OK]
    shapes = [read_document(folders[n])["provenance"] for n in left]
    for later, first in near_duplicates(shapes, config).items():
        row, name = rows[left[later]], str(rows[left[first]]["object_id"])
        alike = {} if config.near_duplicates else reason_row(Status.NEAR_DUPLICATE, f"like {name}")
        marked[left[later]] = row | {"near_duplicate_of": name} | alike
    return marked
