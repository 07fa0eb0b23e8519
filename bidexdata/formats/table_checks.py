"""Laws between the tables of a release: schemas, row counts, splits, hands, rates, shapes.

Each function returns what it counted, or raises `Contradiction` with what is wrong.
"""

from __future__ import annotations

import json
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from bidexdata.errors import Contradiction
from bidexdata.formats import parquet, tables
from bidexdata.formats.clouds import CLOUDS
from bidexdata.formats.hand_files import hand_folder, header_of
from bidexdata.formats.hdf5 import count_rows
from bidexdata.formats.object_pass import NO_CLOUD
from bidexdata.formats.object_table import shape_hash
from bidexdata.formats.row_groups import aligned
from bidexdata.formats.verdict_rows import verdict_rows
from bidexdata.objects.library import object_folder
from bidexdata.objects.sources.item import UNKNOWN
from bidexdata.record import Header
from bidexdata.wording import counted

if TYPE_CHECKING:
    import pyarrow as pa

    from bidexdata.formats.release import Release


def row_tables(release: Release) -> str:
    """Check schemas, the alignment of the row tables, and the row counts of manifest and scenes."""
    header = release.header
    expected = {
        "grasps": tables.grasps_schema(header),
        "contacts": tables.contacts_schema(header),
        **{name: tables.arms_schema(header) for name in tables.arms_tables(header)},
        **{f"verdicts/{p}-{t}": tables.verdicts_schema(header) for p, t in release.protocols},
    }
    counts = {}
    for configuration in release.configurations:
        if release.form == "hdf5":
            per_split = [count_rows(release.path, configuration, s) for s in release.split_names]
            counts[configuration] = sum(per_split)
        else:
            counts[configuration] = _table_rows(release, configuration, expected)
        stated = release.figures[f"{configuration}_rows"]
        column = release.scenes.column(f"{configuration}_rows").to_numpy()
        if not counts[configuration] == stated == column.sum():
            raise Contradiction(
                f"configuration {configuration}: {counts[configuration]} rows in files, {stated} "
                f"in the manifest, {column.sum()} in scenes.parquet"
            )
    for name, fields in (
        ("objects", tables.OBJECT_FIELDS),
        ("scenes", tables.SCENE_FIELDS),
        ("runs", tables.RUN_FIELDS),
    ):
        file = release.path / f"{name}.parquet"
        known = tuple(f for f in fields if not tables.plain_lacks(header, f.name))
        _same_schema(parquet.read_schema(file), tables.plain_schema(known), str(file), header)
    _check_clouds(release)
    return ", ".join(counted(n, f"{c} row") for c, n in counts.items())


def _check_clouds(release: Release) -> None:
    numbers = release.objects.column("cloud_index").to_pylist()
    if numbers and all(n == NO_CLOUD for n in numbers):
        return  # a licence policy may leave them out
    if numbers != list(range(len(numbers))):
        raise Contradiction("objects.parquet: cloud_index does not count the objects")
    for kind in CLOUDS:
        if len(release.cloud(kind)) != len(numbers):
            raise Contradiction(f"{kind}.npy has another number of objects than objects.parquet")


def _table_rows(release: Release, configuration: str, expected: dict[str, pa.Schema]) -> int:
    """Check that the Parquet files of all row tables have their schemas and equal rows; count them."""
    aligned = None
    for table, schema in expected.items():
        files = release.table_files(table, configuration)
        for file in files:
            _same_schema(parquet.read_schema(file), schema, str(file), release.header)
        groups = [(file.name, parquet.row_counts(file)) for file in files]
        if aligned not in (None, groups):
            raise Contradiction(f"{table} ({configuration}) has other rows than grasps")
        aligned = groups
    return sum(sum(rows) for _, rows in aligned or [])


def splits(release: Release) -> str:
    """Check that what the release splits by lies in one split, and that rows are where they say.

    By object and by category no object, no shape and no category may be in two splits; by size no
    scene and no size may.
    """
    by = release.manifest.get("split", {}).get("by", "object")
    objects = release.objects.select(["object_id", "split", "shape_sha256", "category"])
    rows = objects.to_pylist()
    if len({r["object_id"] for r in rows}) != len(rows):
        raise Contradiction("objects.parquet names an object twice")
    scenes = release.scenes.select(["scene_id", "object_id", "size_mm", "split"]).to_pylist()
    _check_scene_order(release, scenes)
    if by == "size":
        _refuse_shared(scenes, "size_mm", "size")
    else:
        _refuse_shared(rows, "shape_sha256", "shape")
        _refuse_shared(scenes, "object_id", "object")
        where = {r["object_id"]: r["split"] for r in rows}
        strangers = [s for s in scenes if where.get(s["object_id"]) != s["split"]]
        if strangers:
            first = strangers[0]
            raise Contradiction(f"split {first['split']} holds scene {first['scene_id']}")
    if by == "category":
        _refuse_shared([r for r in rows if r["category"] != UNKNOWN], "category", "category")
    counts = [(split, [s for s in scenes if s["split"] == split]) for split in release.split_names]
    found = [
        f"{counted(len({s['object_id'] for s in mine}), 'object')} in {split}"
        for split, mine in counts
    ]
    return ", ".join(found)


def _check_scene_order(release: Release, scenes: list[dict[str, Any]]) -> None:
    keys = [(s["object_id"], s["size_mm"], s["scene_id"]) for s in scenes]
    for last, key in pairwise(keys):
        if key <= last:
            raise Contradiction(f"scenes.parquet: {key[2]} is out of order or there twice")
    known = {*release.object_ids}
    unknown = [s["scene_id"] for s in scenes if s["object_id"] not in known]
    if unknown:
        raise Contradiction(f"scenes.parquet: objects.parquet has no object of {unknown[0]}")


def _refuse_shared(rows: list[dict[str, Any]], key: str, noun: str) -> None:
    where: dict[Any, set[str]] = {}
    for row in rows:
        where.setdefault(row[key], set()).add(row["split"])
    shared = [value for value, found in where.items() if len(found) > 1]
    if shared:
        more = f", and {len(shared) - 1} more" if len(shared) > 1 else ""
        raise Contradiction(f"{noun} {str(shared[0])[:64]} is in two splits{more}")


def hands(release: Release) -> str:
    """Check that the kinematic trees are those of the header."""
    for hand in release.hands:
        tree = read_tree(release, hand.name, hand.side)
        if header_of(tree) != hand:
            raise Contradiction(f"hands/{hand.name}/{hand.side}/tree.json is another hand")
    return ", ".join(f"{h.name} {h.side}" for h in release.hands)


def rates(release: Release) -> str:
    """Count successes again and compare them with the manifest's figures."""
    runs = release.runs.select(["run", "grasps"]).to_pylist()
    # Imported runs have no number of grasps to keep, and so no unselected rate.
    of_runs = {
        "selected": [r["run"] for r in runs],
        "unselected": [r["run"] for r in runs if r["grasps"] >= 0],
    }
    for test, stated in release.figures["tests"].items():
        if (release.default_protocol, test) not in release.protocols:
            continue
        for configuration, kind in (("selected", "selected"), ("audit", "unselected")):
            k = _passed(release, configuration, test, of_runs[kind])
            if k != stated[kind]["k"]:
                raise Contradiction(
                    f"{k} {configuration} rows pass test {test}, the manifest says "
                    f"{stated[kind]['k']}"
                )
    for protocol, figures in release.other_figures.items():
        for test, stated in figures["tests"].items():
            if (protocol, test) not in release.protocols:
                continue
            k = sum(int(rows.passed.sum()) for rows in verdict_rows(release, protocol, test))
            if k != stated["selected"]["k"]:
                raise Contradiction(
                    f"{k} selected rows pass test {test} of {protocol}, the manifest says "
                    f"{stated['selected']['k']}"
                )
    return "successes per configuration are those of the manifest"


def _passed(release: Release, configuration: str, test: str, runs: list[str]) -> int:
    """Rows of some runs that pass a test of the default protocol."""
    import pyarrow as pa
    import pyarrow.compute as pc

    compute: Any = pc
    count, tables = 0, {"grasps": ["grasp_id", f"suc_{test}", "run"]}
    for split in release.split_names:
        for (table,) in aligned(release, tables, configuration, split):
            mine = compute.is_in(table.column("run"), value_set=pa.array(runs, pa.string()))
            passed = compute.and_kleene(table.column(f"suc_{test}"), mine)
            count += compute.sum(passed).as_py() or 0
    return count


def shapes(release: Release) -> str:
    """Hash the geometry of every object again; objects whose files were left out are counted."""
    stated = zip(
        release.object_ids, release.objects.column("shape_sha256").to_pylist(), strict=True
    )
    count = 0
    for object_id, shape in stated:
        if not has_shape(release, object_id):
            continue
        if shape_hash(release.load_solid(object_id)) != shape:
            raise Contradiction(f"the geometry of {object_id} does not have its stated hash")
        count += 1
    left_out = len(release.object_ids) - count
    rest = f", {counted(left_out, 'object')} without files by the licence policy" * bool(left_out)
    return f"geometry of {counted(count, 'object')} hashed again{rest}"


def has_shape(release: Release, object_id: str) -> bool:
    """Whether the release holds the files of an object, which a licence policy may leave out."""
    return (release.path / object_folder(object_id)).is_dir()


def read_tree(release: Release, name: str, side: str) -> dict[str, Any]:
    """Read `tree.json` of one hand.

    Raises:
        Contradiction: The file is missing or unreadable.
    """
    path = release.path / hand_folder(name, side) / "tree.json"
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as err:
        raise Contradiction(f"{path}: unreadable hand ({err})") from err


def _same_schema(found: pa.Schema, expected: pa.Schema, where: str, header: Header) -> None:
    # A newer minor version may append columns, an older one lacks those that came later; what the
    # file's version knows must be there as we know it.
    for field in expected:
        if header.lacks(field.name):
            continue
        at = found.get_field_index(field.name)
        if at < 0:
            raise Contradiction(f"{where}: column {field.name} is missing")
        if found.field(at).type != field.type:
            raise Contradiction(
                f"{where}: {field.name} is {found.field(at).type}, not {field.type}"
            )
