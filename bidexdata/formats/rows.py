"""Rows of one object on their way into a release: joined over runs, checked, sorted, tabled."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bidexdata.errors import NotUsable
from bidexdata.formats.tables import (
    ARM_COLUMNS,
    CONTACT_COLUMNS,
    GRASP_COLUMNS,
    SORTED_BY,
    VERDICT_COLUMNS,
    arms_schema,
    contacts_schema,
    grasps_schema,
    of_first_test,
    verdicts_schema,
)
from bidexdata.record import GraspBatch, Header, Status
from bidexdata.record.batch import BadRecord, empty_columns
from bidexdata.record.fields import MEASURED, TESTS

if TYPE_CHECKING:
    import pyarrow as pa

TestKey = tuple[str, str]
"""(protocol, test), for example ("paper-1", "f")."""


@dataclass(frozen=True, slots=True)
class ReleaseRows:
    """Rows of one object from one run, with the verdicts that exist for them."""

    run: str
    """`RunInfo.name` of the run they come from."""
    batch: GraspBatch
    """Synth columns. `header.counts` holds the attempts of every scene that the rows stand for,
    scenes without stored rows included."""
    verdicts: Mapping[TestKey, Mapping[str, np.ndarray]] = field(default_factory=dict)
    """Columns written by validate, per (protocol, test), row by row; missing = not tested."""
    arms: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Columns written by the stage arms, row by row, of the release's rig; none = not asked for."""


@dataclass(frozen=True, slots=True)
class RunInfo:
    """What a release says of one run."""

    name: str
    fingerprint: str
    grasps: int | None
    """N kept per scene; None for imported rows, which have no unselected rate."""
    candidates: int | None = None
    seed: int = 0
    preset: str = ""
    setting: str = "floating"
    rig: str = ""
    """Name of the rig that its grasps were made for; empty for none."""
    library_fingerprint: str = ""
    version: str = ""
    config: Mapping[str, Any] = field(default_factory=dict)


class ObjectRows(NamedTuple):
    """All rows of one object, sorted; untested rows have `tested` False and fill values."""

    batch: GraspBatch
    run: np.ndarray
    verdicts: Mapping[TestKey, Mapping[str, np.ndarray]]
    tested: Mapping[TestKey, np.ndarray]
    arms: Mapping[str, np.ndarray]
    """Empty where the release has no rig."""

    def select(self, mask: np.ndarray) -> ObjectRows:
        """Keep rows."""
        verdicts = {k: {c: v[mask] for c, v in d.items()} for k, d in self.verdicts.items()}
        tested = {k: v[mask] for k, v in self.tested.items()}
        arms = {k: v[mask] for k, v in self.arms.items()}
        return ObjectRows(self.batch.select(mask), self.run[mask], verdicts, tested, arms)


def join_rows(
    object_id: str, parts: Iterable[ReleaseRows], header: Header, tests: Sequence[TestKey]
) -> ObjectRows:
    """Join the rows of one object over its runs and sort them.

    Raises:
        NotUsable: Rows of another hand, or the same grasp_id twice: these runs do not go together.
        BadRecord: Another object, or a verdict table that was not announced.
    """
    parts = [_checked(object_id, part, header, tests) for part in parts]
    columns = (
        {
            name: np.concatenate([p.batch.columns[name] for p in parts])
            for name in (*GRASP_COLUMNS, *CONTACT_COLUMNS)
        }
        if parts
        else empty_columns(header, (*GRASP_COLUMNS, *CONTACT_COLUMNS), 0)
    )
    run = (
        np.concatenate([np.full(len(p.batch), p.run) for p in parts])
        if parts
        else np.array([""])[:0]
    )
    verdicts: dict[TestKey, dict[str, np.ndarray]] = {}
    tested: dict[TestKey, np.ndarray] = {}
    for key in tests:
        got = [_verdict(p, key, header) for p in parts]
        verdicts[key] = {
            c: np.concatenate([g[c] for g in got]) if got else empty_columns(header, (c,), 0)[c]
            for c in VERDICT_COLUMNS
        }
        flags = [np.full(len(p.batch), key in p.verdicts) for p in parts]
        tested[key] = np.concatenate(flags) if flags else np.zeros(0, bool)
    rows = ObjectRows(
        GraspBatch(header, columns), run, verdicts, tested, _joined_arms(parts, header)
    )
    order = np.lexsort([columns[c] for c in reversed(SORTED_BY)])
    rows = rows.select(order)
    _refuse_duplicates(rows)
    return rows


def grasps_table(rows: ObjectRows, protocol: str) -> pa.Table:
    """Table of grasps with run, verdict booleans and metrics of the default protocol."""
    import pyarrow as pa

    schema = grasps_schema(rows.batch.header)
    arrays = {n: rows.batch.columns[n] for n in GRASP_COLUMNS}
    base = GraspBatch(rows.batch.header, arrays).to_arrow()
    columns = {n: base.column(n) for n in GRASP_COLUMNS}
    columns["run"] = pa.array(rows.run.tolist(), pa.string())
    n = len(rows.batch)
    for test in TESTS:
        key = (protocol, test)
        tested = rows.tested.get(key, np.zeros(n, bool))
        success = rows.verdicts[key]["success"] if key in rows.verdicts else np.zeros(n, bool)
        columns[f"suc_{test}"] = pa.array(success, pa.bool_(), mask=~tested)
    keys = [(protocol, test) for test in TESTS if (protocol, test) in rows.verdicts]
    tests = [(rows.verdicts[key], rows.tested[key]) for key in keys]
    for name in MEASURED:
        columns[name] = pa.array(of_first_test(name, n, tests))
    return pa.Table.from_arrays([_array(columns[f.name]) for f in schema], schema=schema)


def arms_table(rows: ObjectRows) -> pa.Table:
    """Table of arm solutions, same rows and order as the grasps table."""
    columns = {"grasp_id": rows.batch["grasp_id"], **rows.arms}
    return GraspBatch(rows.batch.header, columns).to_arrow().cast(arms_schema(rows.batch.header))


def contacts_table(rows: ObjectRows) -> pa.Table:
    """Table of contacts, same rows and order as the grasps table."""
    names = ("grasp_id", *CONTACT_COLUMNS)
    batch = GraspBatch(rows.batch.header, {n: rows.batch.columns[n] for n in names})
    return batch.to_arrow().cast(contacts_schema(rows.batch.header))


def verdicts_table(rows: ObjectRows, key: TestKey) -> pa.Table:
    """Table of one test, same rows and order as the grasps table; `success` null = not tested."""
    import pyarrow as pa

    schema = verdicts_schema(rows.batch.header)
    columns = {"grasp_id": rows.batch["grasp_id"], **rows.verdicts[key]}
    table = GraspBatch(rows.batch.header, columns).to_arrow()
    arrays = [table.column(f.name) for f in schema]
    at = schema.get_field_index("success")
    arrays[at] = pa.chunked_array([pa.array(columns["success"], mask=~rows.tested[key])])
    return pa.Table.from_arrays([_array(a) for a in arrays], schema=schema)


def _checked(
    object_id: str, part: ReleaseRows, header: Header, tests: Sequence[TestKey]
) -> ReleaseRows:
    batch = part.batch
    if batch.header.hands != header.hands:
        theirs = ", ".join(f"{h.name} {h.side} {h.spec_hash[:8]}" for h in batch.header.hands)
        raise NotUsable(f"run {part.run}: its hands ({theirs}) are not those of the release")
    other = sorted(set(batch["object_id"].tolist()) - {object_id})
    if other:
        raise BadRecord(f"run {part.run}: rows of {other[0]} were given as rows of {object_id}")
    unknown = sorted(set(part.verdicts) - set(tests))
    if unknown:
        raise BadRecord(f"run {part.run}: verdicts of {unknown[0]} were not announced")
    for key, columns in part.verdicts.items():
        lengths = {len(v) for v in columns.values()}
        if lengths != {len(batch)}:
            raise BadRecord(
                f"run {part.run}: verdicts of {key} have {lengths} rows, not {len(batch)}"
            )
    lengths = {len(v) for v in part.arms.values()} - {len(batch)}
    if lengths or (part.arms and batch.header.arms != header.arms):
        raise BadRecord(f"run {part.run}: its arm solutions are of other rows or another rig")
    n = len(batch)
    full = empty_columns(header, (*GRASP_COLUMNS, *CONTACT_COLUMNS), n)
    full["selected"] = np.ones(n, bool)  # imported rows without flags are the data set itself
    full |= {k: v for k, v in batch.columns.items() if k in full}
    full["size"] = batch["size"]  # rows of older versions have none
    batch = GraspBatch(header, full)
    # Rows without a flag belong to no configuration.
    keep = batch["selected"] | batch["audit"]
    verdicts = {k: {c: v[keep] for c, v in d.items()} for k, d in part.verdicts.items()}
    arms = {c: v[keep] for c, v in part.arms.items()}
    return ReleaseRows(part.run, batch.select(keep), verdicts, arms)


def _joined_arms(parts: Sequence[ReleaseRows], header: Header) -> dict[str, np.ndarray]:
    """Columns of the arms of all parts; those that were not asked for have fill values."""
    if not header.arms:
        return {}
    none = empty_columns(header, ARM_COLUMNS, 0)
    made = [{**empty_columns(header, ARM_COLUMNS, len(p.batch)), **p.arms} for p in parts]
    return {c: np.concatenate([none[c], *(one[c] for one in made)]) for c in ARM_COLUMNS}


def _verdict(part: ReleaseRows, key: TestKey, header: Header) -> dict[str, np.ndarray]:
    columns = empty_columns(header, VERDICT_COLUMNS, len(part.batch))
    columns["verdict_status"][:] = Status.NOT_RUN
    return columns | {k: v for k, v in part.verdicts.get(key, {}).items() if k in columns}


def _refuse_duplicates(rows: ObjectRows) -> None:
    ids, first, counts = np.unique(rows.batch["grasp_id"], return_index=True, return_counts=True)
    if np.any(counts > 1):
        twice = ids[counts > 1][0]
        runs = sorted(set(rows.run[rows.batch["grasp_id"] == twice].tolist()))
        raise NotUsable(
            f"grasp {twice} of {rows.batch['object_id'][first[0]]} is there twice "
            f"(in {', '.join(runs)}); give every run or release once"
        )


def _array(column: Any) -> Any:
    import pyarrow as pa

    return column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
