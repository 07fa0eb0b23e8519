"""Row groups of a release as numbers, for laws and sums over all rows.

Text is read into Arrow and stays there: turning the five text columns of ten million rows into
Python strings takes longer than everything else.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import Contradiction
from bidexdata.record import FIELDS, GraspBatch, Status

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.formats.release import Release

NAMES = ("grasp_id", "scene_id", "object_id", "setting")
"""Text columns of the grasps table that a message or a law may need."""
ID_DIGITS = 16
"""Hexadecimal digits of a grasp_id."""
_HEX = np.full(256, 255, np.uint8)
_HEX[np.frombuffer(b"0123456789abcdef", np.uint8)] = np.arange(16, dtype=np.uint8)


class RowGroup(NamedTuple):
    """The rows of one row group of the grasps table, with their contacts where asked for."""

    names: pa.Table
    """The columns `NAMES`."""
    batch: GraspBatch
    """The columns that were asked for, none of them text."""

    def with_grasp(self) -> RowGroup:
        """Keep the rows that hold a grasp."""
        import pyarrow as pa

        ok = self.batch["synth_status"] == Status.OK
        return RowGroup(self.names.filter(pa.array(ok)), self.batch.select(ok))

    def name_of(self, row: int) -> str:
        """Name a row for a message."""
        grasp, scene = (self.names.column(n)[row].as_py() for n in ("grasp_id", "scene_id"))
        return f"grasp {grasp} of {scene}"

    def refuse(self, bad: Any, text: str) -> None:
        """Raise where a row is marked.

        Raises:
            Contradiction: The first of them, and how many there are.
        """
        if np.any(bad):
            first = self.name_of(int(np.flatnonzero(bad)[0]))
            raise Contradiction(f"{first}: {text} ({int(np.sum(bad))} such rows)")


def aligned(
    release: Release, tables: Mapping[str, Sequence[str] | None], configuration: str, split: str
) -> Iterator[tuple[pa.Table, ...]]:
    """Yield the row groups of several row tables side by side, rows matched by their ids.

    Args:
        release: Where.
        tables: Columns by table, `grasp_id` among them; None takes all.
        configuration: `selected` or `audit`.
        split: One split.

    Raises:
        Contradiction: A file is damaged, or a table has other rows than the first.
    """
    first, *others = tables
    streams = [
        release.row_groups(name, configuration, split, columns) for name, columns in tables.items()
    ]
    for parts in zip(*streams, strict=True):
        ids = parts[0].column("grasp_id")
        for name, part in zip(others, parts[1:], strict=True):
            if not part.column("grasp_id").equals(ids):
                raise Contradiction(
                    f"{name} ({configuration}, {split}): rows are not those of {first}"
                )
        yield parts


def row_groups(
    release: Release, configuration: str, split: str, columns: Sequence[str]
) -> Iterator[RowGroup]:
    """Yield the row groups of one configuration and split that have rows.

    Args:
        release: Where.
        configuration: `selected` or `audit`.
        split: One split.
        columns: Of the tables grasps and contacts, none of them text; `synth_status` comes with
            them, and one that the release's schema has not is left out.

    Raises:
        Contradiction: A file is damaged, or the contacts table has other rows.
    """
    wanted = dict.fromkeys(n for n in ("synth_status", *columns) if not release.header.lacks(n))
    of_contacts = [n for n in wanted if FIELDS[n].table == "contacts"]
    tables = {"grasps": [*NAMES, *(n for n in wanted if FIELDS[n].table == "grasps")]}
    if of_contacts:
        tables["contacts"] = ["grasp_id", *of_contacts]
    for parts in aligned(release, tables, configuration, split):
        if not parts[0].num_rows:
            continue
        batch = GraspBatch.from_arrow(parts[0].drop_columns(list(NAMES)))
        if of_contacts:
            found = GraspBatch.from_arrow(parts[1].drop_columns(["grasp_id"]))
            batch = batch.with_columns(**{n: found[n] for n in of_contacts})
        yield RowGroup(parts[0].select(list(NAMES)), batch)


def grasps_of(release: Release, columns: Sequence[str]) -> Iterator[RowGroup]:
    """Yield the rows that hold a grasp, selected rows first."""
    for configuration in release.configurations:
        for split in release.split_names:
            for group in row_groups(release, configuration, split, columns):
                kept = group.with_grasp()
                if len(kept.batch):
                    yield kept


def id_numbers(ids: pa.ChunkedArray) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    """Read ids of 16 hexadecimal digits as numbers, and say which are such."""
    import pyarrow as pa
    import pyarrow.compute as pc

    compute: Any = pc
    texts: Any = ids.combine_chunks()
    good = compute.binary_length(texts).to_numpy(zero_copy_only=False) == ID_DIGITS
    if not good.all():
        texts = compute.if_else(pa.array(good), texts, "0" * ID_DIGITS)
    offsets, data = texts.buffers()[1:]
    start = int(np.frombuffer(offsets, np.int32)[texts.offset]) if len(texts) else 0
    letters = np.frombuffer(data or b"", np.uint8)[start : start + ID_DIGITS * len(texts)]
    digits = _HEX[letters].reshape(-1, ID_DIGITS)
    good = good & (digits < 16).all(axis=1)
    pairs = (digits[:, 0::2] << 4) | (digits[:, 1::2] & 15)
    return np.ascontiguousarray(pairs).view(">u8")[:, 0].astype(np.uint64), good
