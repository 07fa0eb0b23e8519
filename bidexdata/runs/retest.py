"""Testing a release: its rows become a run beside it, which `validate` then works on."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.config import differing_keys, fingerprint
from bidexdata.errors import ConfigConflict, NotUsable
from bidexdata.formats.manifest import sha256_of
from bidexdata.kinds import MANIFEST, kind_of
from bidexdata.record import FIELDS, GraspBatch
from bidexdata.record.scene import Setting
from bidexdata.runs.made_with import package_versions
from bidexdata.runs.plan import Round, Task, write_plan
from bidexdata.runs.run import Run
from bidexdata.runs.run_folder import PLAN_FILE, refuse_foreign
from bidexdata.runs.shards import shard_path, write_shard
from bidexdata.runs.spec import RunSpec, relative_to_run, write_spec

if TYPE_CHECKING:
    from bidexdata.formats.release import Release


def start_retest(release_path: str | Path, out: str | Path) -> Run:
    """Copy the rows of a release into a run folder without verdicts, one task per object.

    Raises:
        ConfigConflict: `out` is a run of something else.
        NotUsable: `out` is no run and not empty.
    """
    from bidexdata.formats.release import Release

    release, out = Release.open(release_path), Path(out)
    spec = _spec(release, out)
    if kind_of(out) == "run":
        old = Run.open(out)
        differing = differing_keys(old.spec.identity(), spec.identity())
        if differing:
            raise ConfigConflict(out, differing)
        if (out / PLAN_FILE).exists():
            return old
    else:
        refuse_foreign(out, "import")
    run = Run(out, spec)
    tasks, attempts = [], _attempts(release)
    for object_id in release.object_ids:
        counts = attempts.get(object_id, {})
        batch = _rows(release, object_id, counts, run)
        scenes = tuple(counts)
        task = Task(fingerprint([object_id, scenes, 0]), object_id, scenes, 0)
        path = shard_path(run.stage_folder("rows"), task.task_id)
        write_shard(path, batch.to_arrow(), run.fingerprint)
        tasks.append(task)
    if not tasks:
        raise NotUsable(f"{release.path} holds no grasps")
    write_plan(out / PLAN_FILE, tasks)
    write_spec(out, spec)  # last: a killed copy starts again
    return run


def planned_retest(release_path: str | Path, out: str | Path) -> Run:
    """The run that `start_retest` would make; nothing is written."""
    from bidexdata.formats.release import Release

    return Run(Path(out), _spec(Release.open(release_path), Path(out)))


def _spec(release: Release, out: Path) -> RunSpec:
    release.require_shapes()  # grasps are tested on objects
    sizes = release.index("selected", columns=["size_mm"]).column("size_mm").unique().to_pylist()
    return RunSpec(
        kind="release",
        hand=",".join(h.name for h in release.hands),
        hands=release.hands,
        sizes_mm=tuple(sorted(sizes)),
        setting=_setting(release),
        source=relative_to_run(release.path, out),
        source_fingerprint=sha256_of(release.path / MANIFEST)[:16],
        rounds=_rounds(release),
        versions=package_versions(),
    )


def _setting(release: Release) -> Setting:
    """Tabletop where every scene is; a release of both is tested as floating ones are."""
    settings = set(release.scenes.column("setting").to_pylist())
    return "tabletop" if settings == {"tabletop"} else "floating"


def _rounds(release: Release) -> tuple[Round, ...]:
    """The N of all scenes, which rates need; none where scenes differ or rows were imported."""
    wanted = set(release.scenes.column("grasps_wanted").to_pylist())
    made = [sum(json.loads(a).values()) for a in release.scenes.column("attempts").to_pylist()]
    number = wanted.pop() if len(wanted) == 1 else 0
    return (Round(number, max(made)),) if number else ()


def _attempts(release: Release) -> dict[str, dict[str, dict[str, int]]]:
    """Attempts per status label for every scene of every object."""
    found: dict[str, dict[str, dict[str, int]]] = {}
    for row in release.scenes.to_pylist():
        found.setdefault(row["object_id"], {})[row["scene_id"]] = json.loads(row["attempts"])
    return found


def _rows(
    release: Release, object_id: str, counts: Mapping[str, Mapping[str, int]], run: Run
) -> GraspBatch:
    """Every stored row of an object, without verdicts."""
    batch = release.stored(object_id)
    columns = {n: c for n, c in batch.columns.items() if FIELDS[n].written_by != "validate"}
    prints = {**batch.header.fingerprints, "run": run.fingerprint}
    header = dataclasses.replace(batch.header, fingerprints=prints, counts=counts)
    return GraspBatch(header, columns)
