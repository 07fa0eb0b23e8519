"""Rows of the objects, scenes and runs tables."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.config import canonical_json
from bidexdata.formats.licences import normal_licence
from bidexdata.formats.rows import ObjectRows, ReleaseRows, RunInfo
from bidexdata.formats.scene_facts import ScenePhysics, scene_facts
from bidexdata.formats.splits import Splitting
from bidexdata.formats.tables import OBJECT_FIELDS, RUN_FIELDS, SCENE_FIELDS, plain_schema
from bidexdata.objects.prepared import Solid
from bidexdata.objects.sources.item import UNKNOWN
from bidexdata.record import GraspBatch
from bidexdata.record.scene import scene_parts

if TYPE_CHECKING:
    import pyarrow as pa


_POSED = ("size", "object_pos", "object_quat_wxyz")
_RECIPE = ("piece_method", "repair_steps", "origin_in_file", "unit_in_file")


def shape_hash(solid: Solid) -> str:
    """Hash the geometry of an object: its mesh and its pieces, names and provenance left out."""
    digest = hashlib.sha256()
    for mesh in (solid.mesh, *solid.pieces):
        # float32: meshes are stored so, and a solid read back must hash the same.
        digest.update(np.ascontiguousarray(mesh.vertices, "<f4").tobytes())
        digest.update(np.ascontiguousarray(mesh.faces, "<i4").tobytes())
        digest.update(b"|")
    return digest.hexdigest()


def object_row(solid: Solid, shape: str) -> dict[str, Any]:
    """Row of the objects table, without `cloud_index` and `split`."""
    known = solid.provenance
    text = {key: str(known.get(key) or "") for key in ("source_name", "source_sha256")}
    text["uri"] = _address(known)
    text |= {key: str(known.get(key) or UNKNOWN) for key in ("source", "author", "category")}
    text["licence"] = normal_licence(known.get("licence"))
    return {
        "object_id": solid.object_id,
        **text,
        "shape_sha256": shape,
        "pieces": len(solid.pieces),
        "volume": solid.volume,
        "nominal_volume": solid.nominal_volume,
        "rest_poses": len(solid.rest_quats_wxyz),
        "recipe": canonical_json({key: known[key] for key in _RECIPE if key in known}),
    }


def _address(known: Mapping[str, Any]) -> str:
    """Address that the object is from: where it has none of its own, its source may be one."""
    source = str(known.get("source") or "")
    named = source if source.startswith(("https://", "http://")) else ""
    return str(known.get("uri") or "") or named


def objects_table(rows: Sequence[Mapping[str, Any]], splits: Mapping[str, str]) -> pa.Table:
    """The objects table, one row per object in the order of `rows`, which is that of the clouds."""
    full = [
        {"cloud_index": i, **row, "split": splits[row["object_id"]]} for i, row in enumerate(rows)
    ]
    return _table(full, OBJECT_FIELDS)


def scene_rows(
    object_id: str,
    split: Splitting,
    parts: Iterable[ReleaseRows],
    rows: ObjectRows,
    wanted: Mapping[str, int | None],
    physics: ScenePhysics | None = None,
) -> list[dict[str, Any]]:
    """Rows of the scenes table of one object, sorted by size and scene.

    Args:
        object_id: The object.
        split: Where its scenes go.
        parts: Rows per run as they were given, with the counts of their headers.
        rows: The joined rows.
        wanted: Grasps to keep per scene for each run name; None for imported runs.
        physics: Mass and friction of the object's scenes; NaN when omitted.
    """
    scenes: dict[str, dict[str, Any]] = {}
    for part in parts:
        ids = {*part.batch.header.counts, *np.unique(part.batch["scene_id"]).tolist()}
        for scene in ids:
            row = scenes.setdefault(scene, {"runs": set(), "counts": Counter()})
            row["runs"].add(part.run)
            row["counts"].update(part.batch.header.counts.get(scene, {}))
    out = []
    posed = GraspBatch(rows.batch.header, {n: rows.batch.columns[n] for n in _POSED})
    for scene, row in scenes.items():
        named = scene_parts(scene)
        mine = rows.batch["scene_id"] == scene
        out.append(
            {
                "scene_id": scene,
                "object_id": object_id,
                "size_mm": named.size_mm,
                "setting": named.setting,
                **scene_facts(named, posed.select(mine), physics),
                "split": split.of(object_id, named.size_mm),
                "runs": len(row["runs"]),
                "grasps_wanted": sum(wanted[run] or 0 for run in row["runs"]),
                "selected_rows": int((mine & rows.batch["selected"]).sum()),
                "audit_rows": int((mine & rows.batch["audit"]).sum()),
                "attempts": json.dumps(dict(row["counts"]), sort_keys=True),
            }
        )
    return sorted(out, key=lambda r: (r["size_mm"], r["scene_id"]))


def scenes_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """The scenes table."""
    return _table(rows, SCENE_FIELDS)


def runs_table(runs: Sequence[RunInfo]) -> pa.Table:
    """The runs table, sorted by name."""
    rows = [
        {
            "run": r.name,
            "fingerprint": r.fingerprint,
            "library_fingerprint": r.library_fingerprint,
            "grasps": -1 if r.grasps is None else r.grasps,
            "candidates": -1 if r.candidates is None else r.candidates,
            "seed": r.seed,
            "preset": r.preset,
            "setting": r.setting,
            "rig": r.rig,
            "generator_version": r.version,
            "config": canonical_json(r.config),
        }
        for r in sorted(runs, key=lambda r: r.name)
    ]
    return _table(rows, RUN_FIELDS)


def _table(rows: Sequence[Mapping[str, Any]], fields: Any) -> pa.Table:
    import pyarrow as pa

    schema = plain_schema(fields)
    arrays = [pa.array([row[f.name] for row in rows], f.type) for f in schema]
    return pa.Table.from_arrays(arrays, schema=schema)
