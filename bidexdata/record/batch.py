"""GraspBatch: N grasps as named arrays, with the header that gives their axes meaning.

Stages append columns with `with_columns`; nothing is changed in place. Which columns exist, with
which dtype and shape, is the field table's word alone.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.errors import BidexError, Contradiction
from bidexdata.record.fields import ADDED_IN, FIELDS, KEY_FRAMES, STAGES, Field

if TYPE_CHECKING:
    import pyarrow as pa

SCHEMA_VERSION = "1.4"
_HEADER_KEY = b"bidexdata"


class BadRecord(BidexError):
    """A batch does not agree with the field table, its header or another batch."""

    exit_code = 4


@dataclass(frozen=True, slots=True)
class HandHeader:
    """What a reader must know of one hand to use its poses."""

    name: str
    side: str
    spec_hash: str
    """sha256 of the hand's spec and of every file it names."""
    joint_names: tuple[str, ...]
    """The order of `joints`, for this hand's row of the H axis."""
    contact_names: tuple[str, ...]
    root_body: str


@dataclass(frozen=True, slots=True)
class ArmHeader:
    """What a reader must know of one arm to use its angles."""

    rig: str
    rig_hash: str
    """sha256 over the rig, its models and the hands that it carries."""
    side: str
    joint_names: tuple[str, ...]
    """Joints of the arm, then of the wrist: the order along A for this arm's row of the H axis."""
    wrist_joints: int
    """How many of them, the last ones, are the hand's."""
    knots: tuple[int, ...]
    """Knots of each phase, the first knot of all not counted: W = 1 + their sum."""


@dataclass(frozen=True, slots=True)
class Header:
    """What holds for all rows of a batch."""

    hands: tuple[HandHeader, ...]
    fingerprints: Mapping[str, str] = field(default_factory=dict)
    """Configuration fingerprint per stage, and that of the library."""
    version: str = ""
    """Version of the package that wrote the rows."""
    counts: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Attempts per status label for each scene_id, rows that were not stored included."""
    schema_version: str = SCHEMA_VERSION
    extra: Mapping[str, Any] = field(default_factory=dict)
    """Keys of newer minor versions, kept as read."""
    arms: tuple[ArmHeader, ...] = ()
    """Of rows with arm columns, in the order of the H axis."""

    def lacks(self, name: str) -> bool:
        """Whether data with this header was written before the column `name` existed."""
        return name in ADDED_IN and number_of(self.schema_version) < number_of(ADDED_IN[name])

    def axis(self, letter: str) -> int:
        """Length of the axis H, S, J, C, A, K or W, or the number that `letter` spells.

        J, C, A and W are at least 1, so that hands without contact points have a padded column:
        Parquet has no lists of length zero.
        """
        if letter == "H":
            return len(self.hands)
        if letter == "S":
            return len(STAGES)
        if letter == "J":
            return max([1, *(len(h.joint_names) for h in self.hands)])
        if letter == "C":
            return max([1, *(len(h.contact_names) for h in self.hands)])
        if letter == "A":
            return max([1, *(len(a.joint_names) for a in self.arms)])
        if letter == "K":
            return len(KEY_FRAMES)
        if letter == "W":
            return 1 + max([0, *(sum(a.knots) for a in self.arms)])
        return int(letter)

    def shape(self, column: Field) -> tuple[int, ...]:
        """The shape after N that a column has under this header."""
        return tuple(self.axis(a) for a in column.axes)

    def to_json(self) -> str:
        """Canonical JSON of the header; without the key `arms` where there are none."""
        data = asdict(self)
        extra = data.pop("extra")
        if not self.arms:
            del data["arms"]
        return json.dumps({**extra, **data}, sort_keys=True, separators=(",", ":"))

    @classmethod
    def from_json(cls, text: str | bytes) -> Header:
        """Read a header; keys of newer minor versions are kept in `extra`.

        Raises:
            Contradiction: The text is not a header, or its major version is not ours.
        """
        try:
            data = json.loads(text)
            version = str(data["schema_version"])
            if version.split(".", maxsplit=1)[0] != SCHEMA_VERSION.split(".", maxsplit=1)[0]:
                raise Contradiction(
                    f"this data has schema {version}, and this version of bidexdata reads "
                    f"{SCHEMA_VERSION}; upgrade it with `pip install -U bidexdata`"
                )
            names = ("fingerprints", "version", "counts", "schema_version")
            known = {k: data[k] for k in names if k in data}
            hands = tuple(
                HandHeader(
                    name=h["name"],
                    side=h["side"],
                    spec_hash=h["spec_hash"],
                    joint_names=tuple(h["joint_names"]),
                    contact_names=tuple(h["contact_names"]),
                    root_body=h["root_body"],
                )
                for h in data["hands"]
            )
            arms = tuple(
                ArmHeader(
                    rig=a["rig"],
                    rig_hash=a["rig_hash"],
                    side=a["side"],
                    joint_names=tuple(a["joint_names"]),
                    wrist_joints=a["wrist_joints"],
                    knots=tuple(a["knots"]),
                )
                for a in data.get("arms", ())
            )
        except (ValueError, KeyError, TypeError) as err:
            raise Contradiction(f"unreadable bidexdata header ({err})") from err
        extra = {k: v for k, v in data.items() if k not in (*names, "hands", "arms")}
        return cls(hands=hands, extra=extra, arms=arms, **known)


@dataclass(frozen=True, slots=True, eq=False)
class GraspBatch:
    """N grasps: a header and columns of the field table, each with leading axis N.

    Columns read as attributes (`batch.hand_pos`) or items (`batch["hand_pos"]`). Rows without the
    column `size`, as older versions wrote them, have size_mm / 1000.
    """

    header: Header
    columns: Mapping[str, np.ndarray]

    def __post_init__(self) -> None:
        checked = {name: _check(self.header, name, value) for name, value in self.columns.items()}
        lengths = {name: len(value) for name, value in checked.items()}
        if len(set(lengths.values())) > 1:
            raise BadRecord(f"columns differ in length: {lengths}")
        object.__setattr__(self, "columns", checked)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def __getitem__(self, name: str) -> np.ndarray:
        try:
            return self.columns[name]
        except KeyError:
            if name == "size" and "size_mm" in self.columns:
                return _size_of(self.columns["size_mm"])
            have = ", ".join(self.columns)
            raise KeyError(f"this batch has no column {name!r}; it has {have}") from None

    def __getattr__(self, name: str) -> np.ndarray:
        if name in FIELDS:
            try:
                return self[name]
            except KeyError as err:
                raise AttributeError(str(err)) from None
        raise AttributeError(name)

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def select(self, mask: np.ndarray | slice) -> GraspBatch:
        """Keep the rows that a boolean mask, an index array or a slice names."""
        return replace(self, columns={k: v[mask] for k, v in self.columns.items()})

    def with_columns(self, **columns: np.ndarray) -> GraspBatch:
        """Append columns.

        Raises:
            BadRecord: A column exists already, is unknown, or has the wrong dtype or shape.
        """
        again = sorted(set(columns) & set(self.columns))
        if again:
            raise BadRecord(f"columns are appended, never recomputed; already there: {again}")
        return replace(self, columns={**self.columns, **columns})

    @classmethod
    def concat(cls, batches: Sequence[GraspBatch]) -> GraspBatch:
        """Join batches of the same hands and columns, in order; counts are merged.

        Raises:
            BadRecord: Hands, configurations or columns differ, or there is nothing to join.
        """
        if not batches:
            raise BadRecord("nothing to concatenate")
        first = batches[0]
        for other in batches[1:]:
            if other.header.hands != first.header.hands:
                raise BadRecord("batches of different hands cannot be joined")
            if other.header.arms != first.header.arms:
                raise BadRecord("batches of different arms cannot be joined")
            if set(other.columns) != set(first.columns):
                odd = sorted(set(other.columns) ^ set(first.columns))
                raise BadRecord(f"batches have different columns: {odd}")
        counts = {scene: c for b in batches for scene, c in b.header.counts.items()}
        shared = {
            k: v
            for k, v in first.header.fingerprints.items()
            if all(b.header.fingerprints.get(k) == v for b in batches)
        }
        header = replace(first.header, counts=counts, fingerprints=shared)
        columns = {k: np.concatenate([b.columns[k] for b in batches]) for k in first.columns}
        return cls(header, columns)

    def to_arrow(self) -> pa.Table:
        """Give an Arrow table: fixed-size lists, field metadata and the header in the schema."""
        import pyarrow as pa

        schema = arrow_schema(self.header, tuple(self.columns))
        arrays = [_to_arrow_array(self.columns[f.name], f.type) for f in schema]
        return pa.Table.from_arrays(arrays, schema=schema)

    @classmethod
    def from_arrow(cls, table: pa.Table) -> GraspBatch:
        """Read what `to_arrow` wrote, bit for bit; an older version's rows get their `size`.

        Raises:
            Contradiction: The table has no header of ours.
        """
        text = (table.schema.metadata or {}).get(_HEADER_KEY)
        if text is None:
            raise Contradiction("this table has no bidexdata header")
        header = Header.from_json(text)
        names = [n for n in table.column_names if n in FIELDS]
        columns = {n: _from_arrow_array(table.column(n), header, FIELDS[n]) for n in names}
        if header.lacks("size") and "size_mm" in columns:
            columns.setdefault("size", _size_of(columns["size_mm"]))
        return cls(header, columns)


def arrow_schema(header: Header, names: Sequence[str]) -> pa.Schema:
    """Arrow schema of columns in the order given, with unit, frame, shape and text per field."""
    return _schema_of(_Same(header), tuple(names))


class _Same:
    """A header as a key that only itself is equal to: headers hold dicts and are never changed."""

    def __init__(self, header: Header):
        self.header = header

    def __hash__(self) -> int:
        return id(self.header)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.header is other.header


@lru_cache(maxsize=64)
def _schema_of(same: _Same, names: tuple[str, ...]) -> pa.Schema:
    import pyarrow as pa

    header = same.header

    out = []
    for name in names:
        column = FIELDS[name]
        kind = pa.string() if column.dtype == "string" else pa.type_for_alias(column.dtype)
        size = int(np.prod(header.shape(column))) if column.axes else 1
        if size == 0:
            raise BadRecord(f"column {name!r} has no values: the header names no hand")
        if column.axes:
            kind = pa.list_(pa.field("element", kind, nullable=False), size)
        out.append(pa.field(name, kind, nullable=False, metadata=field_metadata(column)))
    return pa.schema(out, metadata={_HEADER_KEY: header.to_json().encode()})


def field_metadata(column: Field) -> dict[str, str]:
    """Metadata of one column for Arrow, Parquet and HDF5 files."""
    return {
        "shape": column.shape,
        "unit": column.unit,
        "frame": column.frame,
        "written_by": column.written_by,
        "description": column.description,
    }


def fill_value(column: Field) -> Any:
    """What stands for "no value": NaN, -1, False or the empty string."""
    if column.dtype == "string":
        return ""
    if column.dtype == "bool":
        return False
    return np.nan if column.dtype == "float32" else -1


def empty_columns(header: Header, names: Sequence[str], n: int) -> dict[str, np.ndarray]:
    """Columns of n rows filled with `fill_value`, to be filled in by a stage."""
    made = {}
    for name in names:
        column = FIELDS[name]
        dtype = "<U1" if column.dtype == "string" else column.dtype
        made[name] = np.full((n, *header.shape(column)), fill_value(column), dtype=dtype)
    return made


def in_metres(size: np.float32) -> float:
    """Give a stored `size` in float64, as the shortest decimal that float32 rounds to it.

    A size of whole millimetres comes back exactly, so that simulating it repeats.

    Example:
        >>> in_metres(np.float32(0.3)), float(np.float32(0.3))
        (0.3, 0.30000001192092896)
    """
    return float(str(np.float32(size)))


def _size_of(size_mm: np.ndarray) -> np.ndarray:
    return (size_mm / 1000).astype(np.float32)


def number_of(version: str) -> tuple[int, ...]:
    """A version as numbers, which compare as versions do."""
    return tuple(int(part) if part.isdecimal() else 0 for part in version.split("."))


def _check(header: Header, name: str, value: np.ndarray) -> np.ndarray:
    if name not in FIELDS:
        raise BadRecord(f"{name!r} is not in the field table")
    column = FIELDS[name]
    value = np.asarray(value)
    if column.dtype == "string":
        fits = value.dtype.kind in "UO" or value.size == 0
        value = value.astype(np.str_) if fits else value
    else:
        fits = value.dtype == np.dtype(column.dtype)
    if not fits:
        raise BadRecord(f"column {name!r} must be {column.dtype}, not {value.dtype}")
    if value.shape[1:] != header.shape(column):
        expected = f"(N, {', '.join(map(str, header.shape(column)))})"
        raise BadRecord(f"column {name!r} must have shape {expected}, not {value.shape}")
    return value


def _to_arrow_array(value: np.ndarray, kind: pa.DataType) -> pa.Array:
    import pyarrow as pa

    if pa.types.is_fixed_size_list(kind):
        flat = pa.array(np.ascontiguousarray(value).reshape(-1), type=kind.value_type)
        return pa.FixedSizeListArray.from_arrays(flat, type=kind)
    if pa.types.is_string(kind):
        return pa.array(value.tolist(), type=kind)
    return pa.array(np.ascontiguousarray(value), type=kind)


def _from_arrow_array(chunked: pa.ChunkedArray, header: Header, column: Field) -> np.ndarray:
    array = chunked.combine_chunks()
    if column.dtype == "string":
        return np.array(array.to_pylist(), dtype=np.str_)
    if not column.axes:
        return array.to_numpy(zero_copy_only=False)
    flat = array.flatten().to_numpy(zero_copy_only=False)
    return flat.reshape(len(array), *header.shape(column))
