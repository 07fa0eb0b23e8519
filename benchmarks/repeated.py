"""A large release for timing: the rows of a small one, repeated for many objects.

Row r of an object is a stored row, so figures of speed hold and figures of success mean nothing.
Only what a loader opens is written: it is no release that `verify` passes.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa

from bidexdata.formats import parquet
from bidexdata.formats.hdf5 import TRAINING_FILE
from bidexdata.formats.manifest import write_manifest
from bidexdata.formats.release import Release

SPLIT = "train"


def repeat_release(source: Path, out: Path, objects: int, rows: int) -> Path:
    """Write a release of `objects` objects with about `rows` selected rows, in the training form.

    Args:
        source: A release with the training form and a selected row in the split `train`.
        out: Folder to write.
        objects: Number of objects; their clouds are the source's, turned so that no two are equal.
        rows: Selected rows, split `train`.
    """
    release = Release.open(source)
    out.mkdir(parents=True)
    shutil.copytree(source / "hands", out / "hands")
    ids = [f"made-{k:08x}" for k in range(objects)]
    table = _repeated(release.objects, objects)
    table = _with(table, object_id=ids, split=[SPLIT] * objects, cloud_index=np.arange(objects))
    parquet.write_table(out / "objects.parquet", table)
    each = -(-rows // objects)
    scenes = _with(
        _repeated(release.scenes, objects),
        **{
            "object_id": ids,
            "scene_id": [f"{i}/300/float" for i in ids],
            "setting": ["floating"] * objects,
            "split": [SPLIT] * objects,
            "size_mm": np.full(objects, 300),
            "selected_rows": np.full(objects, each),
            "audit_rows": np.zeros(objects, np.int64),
        },
    )
    parquet.write_table(out / "scenes.parquet", scenes)
    _write_clouds(release, out, objects)
    _write_rows(source, out, each * objects)
    manifest = {**release.manifest, "form": "hdf5", "splits": [[SPLIT, objects]]}
    del manifest["files"]
    write_manifest(out, manifest)
    return out


def _write_clouds(release: Release, out: Path, objects: int) -> None:
    rng = np.random.default_rng(0)
    (out / "clouds").mkdir()
    cloud = np.asarray(release.cloud("cloud_solid"))
    many = np.empty((objects, *cloud.shape[1:]), np.float32)
    for k in range(objects):
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0].astype(np.float32)
        many[k] = cloud[k % len(cloud)] @ turn
    np.save(out / "clouds" / "cloud_solid.npy", many)


def _write_rows(source: Path, out: Path, rows: int) -> None:
    with (
        h5py.File(source / TRAINING_FILE) as old,
        h5py.File(out / TRAINING_FILE, "w", libver=("v110", "v114"), track_order=True) as new,
    ):
        new.attrs.update(old.attrs)
        theirs: Any = old[f"selected/{SPLIT}"]
        group = new.create_group(f"selected/{SPLIT}", track_order=True)
        new.create_group(f"audit/{SPLIT}", track_order=True)
        for name, dataset in theirs.items():
            if not isinstance(dataset, h5py.Dataset):
                continue
            stored = dataset[:]
            made: Any = group.create_dataset(name, (rows, *stored.shape[1:]), stored.dtype)
            made.attrs.update(dataset.attrs)
            for low in range(0, rows, 65_536):
                high = min(low + 65_536, rows)
                made[low:high] = stored[np.arange(low, high) % len(stored)]


def _repeated(table: pa.Table, count: int) -> pa.Table:
    return table.take(pa.array(np.arange(count) % table.num_rows))


def _with(table: pa.Table, **columns: Any) -> pa.Table:
    for name, values in columns.items():
        at = table.schema.get_field_index(name)
        field = table.schema.field(at)
        table = table.set_column(at, field, pa.array(values, field.type))
    return table
