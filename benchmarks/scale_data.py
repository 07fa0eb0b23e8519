"""A large run out of a small one: real grasps repeated with noise, real solids under new names.

Rows are the selected rows of a run or release. Each copy has a name of its own and noise in the last
12 of the 23 bits of every float's mantissa, so that nothing compresses better than real data do; pose
and size of the object stay. Objects are those with the fewest vertices, moved by 1e-6 of their size, so
that no two have one hash.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bidexdata import Library, Release, Run
from bidexdata.config import fingerprint, to_plain
from bidexdata.kinds import kind_of
from bidexdata.objects.library import content_sha256, object_folder, write_index
from bidexdata.objects.prepared import PreparedObject, SignedDistanceGrid, Solid, TriangleMesh
from bidexdata.objects.storage import object_files, solid_files
from bidexdata.record import FIELDS, GraspBatch, Status
from bidexdata.record.fields import columns_written_by
from bidexdata.record.scene import Scene
from bidexdata.runs.plan import Round, Task, write_plan
from bidexdata.runs.run import verdict_fingerprint
from bidexdata.runs.run_folder import PLAN_FILE, PROTOCOL_FILE
from bidexdata.runs.run_rows import verdict_batch
from bidexdata.runs.shards import shard_path, write_shard, write_text
from bidexdata.runs.spec import RunSpec, relative_to_run, write_spec
from bidexdata.validation.protocols import load_protocol, protocol_from

NOISE_BITS = 12
SOLIDS = 24
"""Source objects that are repeated: those with the fewest vertices."""
SHIFT = 1e-6
"""Of vertices [share of the diagonal]."""
FIXED = ("object_pos", "object_quat_wxyz", "size")
"""What scenes have in common gets no noise."""


class Source(NamedTuple):
    """Where grasps and solids come from."""

    path: Path
    protocol: str

    def objects(self) -> list[str]:
        """Objects with the fewest vertices that have tested rows, sorted."""
        found = {i: len(_solid(self.path, i).mesh.vertices) for i in _owned(self)}
        return sorted(sorted(found, key=lambda i: (found[i], i))[:SOLIDS])


class Wanted(NamedTuple):
    """Size of the large run."""

    rows: int
    objects: int
    shards: int
    seed: int = 0


def make_run(source: Source, out: Path, wanted: Wanted, workers: int) -> None:
    """Write `out/library` and `out/run`."""
    names = source.objects()
    ids = [_new_id(names[k % len(names)], k) for k in range(wanted.objects)]
    context = get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_without_sync) as pool:
        jobs = [(source, names[k % len(names)], ids[k], out / "library") for k in range(len(ids))]
        rows = list(pool.map(_write_object, jobs, chunksize=16))
        write_index(out / "library", rows, {"benchmark": "scale"})
        tasks = _plan(source, names, ids, wanted)
        _write_head(source, out, [task for task, _, _ in tasks])
        parts = [(source, out / "run", *task, wanted.seed) for task in tasks]
        for _ in pool.map(_write_shards, parts, chunksize=8):
            pass


def noisy(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Float32 numbers with random last mantissa bits; zeros and what is not finite stay."""
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32)
    noise = rng.integers(0, 1 << NOISE_BITS, bits.shape, np.uint32)
    changed = (bits >> NOISE_BITS << NOISE_BITS | noise).view(np.float32)
    return np.where(np.isfinite(values) & (values != 0), changed, values)


def _without_sync() -> None:
    """Spare this process some ten thousand waits for the disk: what it writes can be made again."""
    os.fsync = lambda _: None


def _new_id(object_id: str, number: int) -> str:
    slug = object_id.rpartition("-")[0]
    digits = hashlib.sha256(f"{object_id}/{number}".encode()).hexdigest()[:8]
    return f"{slug[:40]}-{number:06d}-{digits}"


def _write_object(job: tuple[Source, str, str, Path]) -> dict[str, Any]:
    source, name, new_id, library = job
    obj, geometry = _prepared(source.path, name)
    rng = np.random.default_rng(int(new_id.rpartition("-")[2], 16))

    def moved(mesh: TriangleMesh) -> TriangleMesh:
        return mesh._replace(vertices=mesh.vertices + SHIFT * rng.normal(size=mesh.vertices.shape))

    obj = dataclasses.replace(
        obj,
        object_id=new_id,
        mesh=moved(obj.mesh),
        pieces=tuple(moved(piece) for piece in obj.pieces),
    )
    folder = library / object_folder(new_id)
    folder.mkdir(parents=True)
    for file, data in {**solid_files(obj), "geometry.npz": geometry}.items():
        (folder / file).write_bytes(data)
    known = {k: obj.provenance.get(k) for k in ("source_name", "source", "licence", "author")}
    return {
        **known,
        "category": obj.provenance.get("category"),
        "object_id": new_id,
        "status": int(Status.OK),
        "status_label": Status.OK.label,
        "reason": "",
        "pieces": len(obj.pieces),
        "volume": obj.volume,
        "rest_poses": len(obj.rest_heights),
        "content_sha256": content_sha256(folder),
    }


def _plan(
    source: Source, names: Sequence[str], ids: Sequence[str], wanted: Wanted
) -> list[tuple[Task, str, tuple[int, ...]]]:
    """Tasks with the source object and the rows of each scene: `wanted` of all in equal parts."""
    tasks, scenes = [], {name: _sizes(source, name) for name in names}
    cuts = np.linspace(0, wanted.shards, len(ids) + 1).round().astype(int)
    ends = np.linspace(0, wanted.rows, len(ids) + 1).round().astype(int)
    for k, object_id in enumerate(ids):
        name = names[k % len(names)]
        sizes = scenes[name]
        parts = min(max(int(cuts[k + 1] - cuts[k]), 1), len(sizes))
        rows = np.diff(np.linspace(0, ends[k + 1] - ends[k], len(sizes) + 1).round().astype(int))
        for chosen in np.array_split(np.arange(len(sizes)), parts):
            chunk = tuple(Scene(object_id, sizes[i]).scene_id for i in chosen)
            task = Task(fingerprint([object_id, chunk, 0]), object_id, chunk, 0)
            tasks.append((task, name, tuple(int(rows[i]) for i in chosen)))
    return tasks


def _write_head(source: Source, out: Path, tasks: list[Task]) -> None:
    library, run = Library.open(out / "library"), out / "run"
    spec = dataclasses.replace(
        _spec(source),
        source=relative_to_run(library.path, run),
        source_fingerprint=library.fingerprint,
        without_scene=(),
        rounds=(Round(1, 4),),
    )
    run.mkdir(parents=True)
    write_plan(run / PLAN_FILE, tasks)
    write_spec(run, spec)
    settings = json.dumps(to_plain(_settings(source)))
    write_text(run / "validate" / source.protocol / PROTOCOL_FILE, settings)


def _write_shards(part: tuple[Source, Path, Task, str, tuple[int, ...], int]) -> None:
    source, path, task, name, counts, seed = part
    run = _open_run(path)
    rng = np.random.default_rng([seed, int(task.task_id, 16)])
    batch, verdicts = _rows(source, name)
    sizes = np.array([int(scene.split("/")[-2]) for scene in task.scene_ids])
    pick = np.concatenate(
        [
            rng.choice(np.flatnonzero(batch["size_mm"] == size), count)
            for size, count in zip(sizes, counts, strict=True)
        ]
    )
    n = len(pick)
    columns = {c: _copied(c, v[pick], rng) for c, v in batch.columns.items()}
    columns["grasp_id"] = np.array([f"{v:016x}" for v in rng.integers(0, 2**64, n, np.uint64)])
    columns["object_id"] = np.full(n, task.object_id)
    columns["scene_id"] = np.repeat(np.array(task.scene_ids), counts)
    columns["attempt"] = np.concatenate([np.arange(c, dtype=np.int32) for c in counts])
    columns["selected"], columns["audit"] = np.ones(n, bool), np.zeros(n, bool)
    attempts = {s: {"ok": int(c)} for s, c in zip(task.scene_ids, counts, strict=True)}
    header = dataclasses.replace(batch.header, counts=attempts)
    rows = GraspBatch(header, columns)
    shard = shard_path(run.stage_folder("rows"), task.task_id)
    write_shard(shard, rows.to_arrow(), run.fingerprint)
    judged = {c: _copied(c, v[pick], rng) for c, v in verdicts.items()}
    shard = shard_path(run.stage_folder("validate", source.protocol, "f"), task.task_id)
    mark = verdict_fingerprint(run, run.protocol(source.protocol), "f")
    table = verdict_batch(rows.header, columns["grasp_id"], judged).to_arrow()
    write_shard(shard, table, mark)


def _copied(name: str, values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    noise = FIELDS[name].dtype == "float32" and name not in FIXED
    return noisy(values, rng) if noise else values


@cache
def _open_run(path: Path) -> Run:
    return Run.open(path)


@cache
def _opened(path: Path) -> Run | Release:
    return Release.open(path) if kind_of(path) == "release" else Run.open(path)


@cache
def _solid(path: Path, object_id: str) -> Solid:
    return _opened(path).load_solid(object_id)


@cache
def _prepared(path: Path, object_id: str) -> tuple[PreparedObject, bytes]:
    """From the run's library; of a release, with what it lacks made up (no stage reads it here).

    Also the bytes of `geometry.npz`, which is the same for all copies.
    """
    opened = _opened(path)
    if isinstance(opened, Run):
        obj = opened.library.load(object_id)
    else:
        obj = _completed(opened.load_solid(object_id))
    return obj, object_files(obj)["geometry.npz"]


def _completed(solid: Solid) -> PreparedObject:
    kept = {name: getattr(solid, name) for name in Solid.__slots__}
    starts = np.cumsum([0, *(len(p.vertices) for p in solid.pieces)])
    faces = [p.faces + s for p, s in zip(solid.pieces, starts, strict=False)]
    vertices = np.concatenate([p.vertices for p in solid.pieces])
    union = TriangleMesh(vertices, np.concatenate(faces).astype(np.int32))
    points = union.vertices.astype(np.float32)
    grid = SignedDistanceGrid(np.zeros((8, 8, 8), np.float32), np.full(3, -0.5), 1 / 7)
    made = {"surface_points": points, "surface_normals": points, "sdf": grid}
    return PreparedObject(**kept, solid=union, hull=union, **made)


@cache
def _owned(source: Source) -> tuple[str, ...]:
    opened = _opened(source.path)
    return tuple(i for i in opened.object_ids if _rows(source, i) is not None)


@cache
def _rows(source: Source, object_id: str) -> Any:
    """Selected rows of one object that were tested and their verdicts; None where there is none."""
    opened = _opened(source.path)
    if isinstance(opened, Release):
        joined = [opened.grasps(object_id, protocol=source.protocol)]
    else:
        tasks = [t for t in opened.tasks_of(object_id) if opened.is_done(t, source.protocol)]
        joined = [opened.task_batch(t, source.protocol) for t in tasks]
    if not joined:
        return None
    batch = GraspBatch.concat(joined)
    batch = batch.select(batch["selected"] & (batch["verdict_status"] != Status.NOT_RUN))
    if not len(batch):
        return None
    late = columns_written_by("validate")
    own = {k: v for k, v in batch.columns.items() if k not in late}
    verdicts = {k: v for k, v in batch.columns.items() if k in late}
    return GraspBatch(batch.header, own), verdicts


def _sizes(source: Source, object_id: str) -> list[int]:
    return np.unique(_rows(source, object_id)[0]["size_mm"]).tolist()


def _spec(source: Source) -> RunSpec:
    opened = _opened(source.path)
    if isinstance(opened, Run):
        return opened.spec
    names = list(dict.fromkeys(hand.name for hand in opened.hands))
    sizes = np.unique(opened.scenes.column("size_mm").to_numpy()).tolist()
    return RunSpec(hand=",".join(names), hands=opened.hands, sizes_mm=tuple(sizes))


def _settings(source: Source) -> Any:
    opened = _opened(source.path)
    if isinstance(opened, Run):
        return opened.protocol(source.protocol)
    settings = opened.protocol_settings.get(source.protocol)
    return protocol_from(settings, "release") if settings else load_protocol(source.protocol)


def shards_of(rows: int) -> int:
    """Shards that a run of so many rows would have: about a thousand rows each."""
    return max(math.ceil(rows / 1000), 1)
