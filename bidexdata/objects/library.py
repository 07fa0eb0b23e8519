"""Library: a folder of prepared objects and its index, one row per input."""

from __future__ import annotations

import hashlib
import os
import socket
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bidexdata.config import canonical_json, fingerprint
from bidexdata.errors import Contradiction, NotUsable, UnknownName
from bidexdata.kinds import INDEX, expect_kind
from bidexdata.record.status import Status

from .prepared import PreparedObject, Solid, TriangleMesh
from .storage import OBJECT_FILES, SCHEMA_VERSION, read_object, read_solid, read_union

if TYPE_CHECKING:
    import pyarrow as pa

COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("source_name", "string", "the input's own name"),
    ("object_id", "string", "identity of the object, also of one that failed"),
    ("status", "int8", "0 = prepared, else why not (record.Status)"),
    ("status_label", "string", "the same in a word"),
    ("reason", "string", "the same in a sentence with figures"),
    ("duplicate_of", "string", "object_id of the first input with the same bytes"),
    ("source", "string", "collection or address"),
    ("licence", "string", "licence of the source"),
    ("author", "string", "author of the source"),
    ("category", "string", "category"),
    ("source_sha256", "string", "sha256 of the source bytes"),
    ("source_bytes", "int64", "size of the source"),
    ("source_faces", "int64", "faces in the source"),
    ("source_diagonal", "float64", "box diagonal of the source in file units"),
    ("repair", "string", "how the mesh was closed"),
    ("repair_steps", "list<string>", "what was done for that, in order"),
    ("hausdorff", "float64", "repaired mesh to source, fraction of the diagonal"),
    (
        "piece_method",
        "string",
        "convex, coacd, coacd_turned, coacd_finer, coacd_second, hull or given (by the source)",
    ),
    ("pieces", "int64", "number of convex pieces"),
    ("volume", "float64", "volume of the solid at unit diagonal"),
    ("volume_ratio", "float64", "solid to repaired mesh"),
    ("solid_hausdorff", "float64", "solid to repaired mesh, fraction of the diagonal"),
    ("rest_poses", "int64", "number of rest poses"),
    ("aspect", "float64", "longest over shortest extent along the principal axes"),
    ("thickness", "float64", "mean thickness of the walls, fraction of the diagonal"),
    ("components", "int64", "bodies of the repaired mesh that do not touch"),
    ("genus", "int64", "handles and through holes of the repaired mesh"),
    ("mesh_hash", "string", "of the repaired mesh's corners, whatever file, place and size"),
    ("near_duplicate_of", "string", "object_id of the first input with nearly the same shape"),
    ("warnings", "list<string>", "what a person should know"),
    ("content_sha256", "string", "sha256 over the object's files"),
)
"""Columns of the index: name, type, meaning. A failed input has nulls where nothing is known."""


_NEEDED = ("source_name", "object_id", "status", "status_label", "reason", "content_sha256")
"""Columns without which an index says nothing; others are null where a version has none."""
_VERSION = "schema_version"
"""Key of the index's metadata: another major version cannot be read."""
ASKED = "asked"
"""Key of the index's metadata: the same inputs asked for so give the same failures again."""
SOLID_DOUBT = 0.04
"""A solid farther than this from its mesh is worth a look [diagonals]."""
LEFT_OUT = (Status.DUPLICATE, Status.NOT_SELECTED, Status.NEAR_DUPLICATE)
"""Statuses of inputs that nothing is wrong with."""


class Library:
    """A library on disk; objects are read when asked for.

    Attributes:
        path: Its folder.
        index: One row per input of `prepare`, failures included (a pyarrow Table).
        object_ids: The prepared objects, in the order of the index.
    """

    def __init__(self, path: Path, index: pa.Table):
        self.path, self.index = path, index
        good = [r for r in index.to_pylist() if r["status"] == Status.OK]
        self._rows = {r["object_id"]: r for r in good}
        self.object_ids: tuple[str, ...] = tuple(self._rows)

    @classmethod
    def open(cls, path: str | Path) -> Library:
        """Open a library.

        Raises:
            PathNotFound: There is no library at `path`.
            NotUsable: `prepare` has not finished it.
            Contradiction: Its index is damaged, or of another major version.
        """
        path = Path(path)
        expect_kind(path, "library")
        if not (path / INDEX).is_file():
            raise NotUsable(
                f"{path} has no {INDEX}: it is an unfinished library; "
                "run the same `bidexdata prepare` again, or the parts that are missing, to finish it"
            )
        return cls(path, _read_index(path / INDEX))

    @property
    def fingerprint(self) -> str:
        """Hash of every object's identity and contents; equal libraries have equal ones."""
        return library_fingerprint({i: r["content_sha256"] for i, r in self._rows.items()})

    def row(self, object_id: str) -> dict[str, Any]:
        """The index row of a prepared object.

        Raises:
            UnknownName: No prepared object is called so.
        """
        if object_id not in self._rows:
            raise UnknownName("object in this library", object_id, self.object_ids[:20])
        return self._rows[object_id]

    def folder(self, object_id: str) -> Path:
        """The folder of a prepared object."""
        self.row(object_id)
        return self.path / object_folder(object_id)

    def load(self, object_id: str) -> PreparedObject:
        """Read a prepared object.

        Raises:
            UnknownName: No prepared object is called so.
            Contradiction: Its files are missing, damaged or not those of the index.
        """
        return read_object(self._checked(object_id))

    def load_solid(self, object_id: str) -> Solid:
        """Read what simulation, pictures and metrics need of an object.

        Raises:
            UnknownName: No prepared object is called so.
            Contradiction: Its files are missing, damaged or not those of the index.
        """
        return read_solid(self._checked(object_id))

    def load_shape(self, object_id: str) -> tuple[Solid, TriangleMesh]:
        """Read what a release holds of an object: its solid, and the surface of its pieces' union.

        Raises:
            UnknownName: No prepared object is called so.
            Contradiction: Its files are missing, damaged or not those of the index.
        """
        folder = self._checked(object_id)
        return read_solid(folder), read_union(folder)

    def _checked(self, object_id: str) -> Path:
        folder = self.folder(object_id)
        if content_sha256(folder) != self._rows[object_id]["content_sha256"]:
            raise Contradiction(
                f"{folder} is not what {self.path / INDEX} says (its sha256 differs); "
                "delete the folder and run `bidexdata prepare` again"
            )
        return folder


def library_fingerprint(contents: Mapping[str, str]) -> str:
    """Hash the prepared objects of a library: object_id -> `content_sha256`."""
    return fingerprint([[i, contents[i]] for i in sorted(contents)])


def warnings_of(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, str]]:
    """What a person should know of prepared inputs: source_name and warning, one per warning."""
    return [
        {"source_name": str(r["source_name"]), "warning": str(text)}
        for r in rows
        if r["status"] == Status.OK
        for text in (*(r.get("warnings") or ()), *_of_distance(r.get("solid_hausdorff")))
    ]


def _of_distance(share: float | None) -> tuple[str, ...]:
    """Warn of a solid that is not the mesh, which pictures of grasps show: parts lost or filled."""
    if share is None or not share > SOLID_DOUBT:
        return ()
    return (
        f"the simulated solid is up to {100 * share:.1f} % of the diagonal away from the mesh "
        f"({500 * share:.0f} mm at 0.5 m): parts are missing or filled; `bidexdata render` of the "
        "library shows both",
    )


def failures_of(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, str]]:
    """What `--json` says of index rows without an object: `source_name`, `status`, `reason`.

    Duplicates and what a selection leaves out are no failures.
    """
    return [_with_reason(r) for r in rows if r["status"] not in (Status.OK, *LEFT_OUT)]


def left_out_of(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, str]]:
    """The same of duplicates and of what a selection leaves out."""
    return [_with_reason(r) for r in rows if r["status"] in LEFT_OUT]


def _with_reason(row: Mapping[str, Any]) -> dict[str, str]:
    named = {"source_name": "source_name", "status": "status_label", "reason": "reason"}
    return {name: row[column] for name, column in named.items()}


def object_folder(object_id: str) -> Path:
    """Folder of an object relative to its library or release: `objects/<2 hex>/<object_id>`.

    The two hex digits are the first of its hash.
    """
    return Path("objects") / object_id.rpartition("-")[2][:2] / object_id


def content_sha256(folder: Path) -> str:
    """Hash the names and contents of an object's files.

    Raises:
        Contradiction: One of them is missing.
    """
    digest = hashlib.sha256()
    for name in OBJECT_FILES:
        try:
            data = (folder / name).read_bytes()
        except OSError as err:
            raise Contradiction(f"{folder / name} is missing or cannot be read") from err
        digest.update(f"{name} {len(data)}\n".encode())
        digest.update(data)
    return digest.hexdigest()


def write_index(
    library: Path, rows: Sequence[Mapping[str, Any]], config: Any, asked: Any = None
) -> None:
    """Write the index of a library, atomically and without anything that changes by itself.

    Args:
        library: Its folder.
        rows: One per input.
        config: What decided the bytes of the objects.
        asked: What decided which inputs gave none; the same as `config` when omitted.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    metadata = {
        _VERSION: SCHEMA_VERSION,
        "prepare_config": canonical_json(config),
        ASKED: canonical_json(config if asked is None else asked),
    }
    schema = _schema().with_metadata(metadata)
    plain = [{name: row.get(name) for name, _, _ in COLUMNS} for row in rows]
    library.mkdir(parents=True, exist_ok=True)
    partial = library / f".{INDEX}.{socket.gethostname()}.{os.getpid()}.partial"
    pq.write_table(pa.Table.from_pylist(plain, schema=schema), partial, compression="zstd")
    partial.replace(library / INDEX)


def _schema() -> pa.Schema:
    """Columns of the index with their meanings."""
    import pyarrow as pa

    types = {
        "string": pa.string(),
        "int8": pa.int8(),
        "int64": pa.int64(),
        "float64": pa.float64(),
        "list<string>": pa.list_(pa.string()),
    }
    return pa.schema(
        pa.field(name, types[kind], metadata={"description": text}) for name, kind, text in COLUMNS
    )


def _read_index(path: Path) -> pa.Table:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
        version = ((table.schema.metadata or {}).get(_VERSION.encode()) or b"").decode()
    except (pa.ArrowException, OSError, UnicodeDecodeError) as err:
        raise Contradiction(f"{path} is damaged ({type(err).__name__})") from err
    major, ours = version.partition(".")[0], SCHEMA_VERSION.partition(".")[0]
    if major != ours:
        newer = major.isdecimal() and int(major) > int(ours)
        raise Contradiction(
            f"{path} has schema version {version or 'none'}, this version reads {SCHEMA_VERSION}; "
            + ("upgrade bidexdata to read it" if newer else "prepare the library again")
        )
    lost = next((name for name in _NEEDED if name not in table.column_names), None)
    if lost is not None:
        raise Contradiction(f"{path} has no column {lost!r}")
    # Another minor version has columns less, which nobody knows, or more, which stay.
    schema = _schema()
    for field in schema:
        if field.name not in table.column_names:
            table = table.append_column(field, pa.nulls(table.num_rows, field.type))
    more = [name for name in table.column_names if name not in schema.names]
    return table.select([*schema.names, *more])
