"""What is packed together: runs with names of their own that fit into one release."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bidexdata.config import differing_keys, to_plain
from bidexdata.errors import NotUsable
from bidexdata.record.scene import scene_parts
from bidexdata.record.settings import shared_settings
from bidexdata.runs.finished import Finished, Test
from bidexdata.runs.run import Run
from bidexdata.synthesis.method_names import DEFAULT_METHOD

if TYPE_CHECKING:
    from bidexdata.formats.rig_files import ReleaseRig
    from bidexdata.formats.rows import RunInfo


class NamedRun(NamedTuple):
    """A run, its name in the release, and what of it is packed."""

    name: str
    run: Run
    finished: Finished


def named_runs(runs: Sequence[Run]) -> list[NamedRun]:
    """Name runs after their folders, and look at each once.

    Raises:
        NotUsable: One is named twice, or holds no rows that can be packed.
    """
    folders = [r.path.resolve() for r in runs]
    if len(set(folders)) < len(folders):
        twice = next(f for f in folders if folders.count(f) > 1)
        raise NotUsable(f"{twice} is named twice; pack every run once")
    for run in runs:
        if run.spec.kind == "generated" and run.spec.of_release:
            raise NotUsable(
                f"{run.path} holds grasps of a release's objects, and packing needs the library "
                "they come from; create the run with that as its source"
            )
        if run.spec.kind == "release":
            raise NotUsable(f"{run.path} re-tests a release; it holds no rows of its own to pack")
    seen: Counter[str] = Counter()
    named = []
    for run, folder in zip(runs, folders, strict=True):
        seen[folder.name] += 1
        number = seen[folder.name]
        name = folder.name if number == 1 else f"{folder.name}-{number}"
        named.append(NamedRun(name, run, Finished.of(run)))
    return named


def for_rig(run: Run, rig: str | Path | None) -> Run:
    """The run for the rig that is asked for; as it is, where it has no arm solutions at all."""
    return run.for_rig(rig) if rig is not None and run.arm_rigs() else run


def check_hands(runs: Sequence[NamedRun]) -> None:
    """Refuse runs of different hands.

    Raises:
        NotUsable: One has other hands than the first.
    """
    first = runs[0]
    for other in runs[1:]:
        if other.run.spec.hands != first.run.spec.hands:
            raise NotUsable(
                f"{other.run.path} has other hands ({other.run.spec.hand}) than {first.run.path} "
                f"({first.run.spec.hand}), or another version of them; pack them apart"
            )


def shared_rig(runs: Sequence[NamedRun]) -> ReleaseRig | None:
    """The rig whose arm solutions are packed: that of all runs that have some.

    Raises:
        NotUsable: They are of different rigs, or were made with different settings.
    """
    from bidexdata.formats.rig_files import release_rig
    from bidexdata.runs.arm_folder import read_record

    armed = [one for one in runs if one.finished.armed]
    if not armed:
        return None
    first = armed[0].run
    record = read_record(first.path, first.rig)
    for one in armed[1:]:
        other = read_record(one.run.path, one.run.rig)
        ours, theirs = ({**r.identity(), "run": ""} for r in (record, other))
        differing = differing_keys(ours, theirs)
        if other.name != record.name or differing:
            why = f" ({differing[0]})" if other.name == record.name else ""
            raise NotUsable(
                f"{one.run.path} has arm solutions of rig {other.name} and {first.path} of "
                f"{record.name}{why}; a release has those of one: say which with --rig, or pack the "
                "runs apart"
            )
    task = next(t for t in first.tasks if t.task_id in armed[0].finished.armed)
    header = first.task_arms(task, first.task_batch(task)).header
    return release_rig(first.robot(), header.arms, record.spec, record.config)


def objects_of(runs: Sequence[NamedRun]) -> dict[str, Run]:
    """The objects with finished rows, and a run whose library has each.

    Raises:
        NotUsable: One object has different shapes in two libraries.
    """
    found: dict[str, Run] = {}
    for one in runs:
        for object_id in one.run.object_ids:
            if not one.finished.tasks_of(one.run, object_id):
                continue
            known = found.setdefault(object_id, one.run)
            mine, theirs = (r.library.row(object_id)["content_sha256"] for r in (one.run, known))
            if mine != theirs:
                raise NotUsable(
                    f"object {object_id} has another shape in the library of {one.run.path} than "
                    f"in that of {known.path}; pack runs of equally prepared objects"
                )
    return found


def shared_protocols(
    runs: Sequence[NamedRun], tests: Sequence[Test]
) -> dict[str, Mapping[str, Any]]:
    """Settings of the protocols that the runs have verdicts of; one name, one protocol.

    Raises:
        NotUsable: Two runs have verdicts of different settings under one name.
    """
    names = sorted({p for p, _ in tests})
    stored = (
        (
            one.run.path,
            {
                name: to_plain(one.run.protocol(name))
                for name in names
                if (one.run.path / "validate" / name).is_dir()
            },
        )
        for one in runs
    )
    return shared_settings(stored, "validate one of them again under another name")


def sizes_of(runs: Sequence[NamedRun], ids: set[str]) -> set[int]:
    """Sizes of the scenes of some objects [mm]."""
    tasks = (t for one in runs for t in one.run.tasks if t.object_id in ids)
    return {scene_parts(scene).size_mm for task in tasks for scene in task.scene_ids}


def run_info(one: NamedRun) -> RunInfo:
    """What the release's table of runs says of a run: no paths, no times."""
    from bidexdata.formats.rows import RunInfo

    spec = one.run.spec
    return RunInfo(
        name=one.name,
        fingerprint=spec.fingerprint,
        grasps=spec.grasps,
        candidates=spec.candidates,
        seed=spec.seed,
        preset=spec.preset if spec.method in ("", DEFAULT_METHOD) else spec.method,
        setting=spec.setting,
        rig=spec.rig.name if spec.rig is not None else "",
        library_fingerprint=spec.source_fingerprint,
        version=spec.versions.get("bidexdata", ""),
        config=spec.config,
    )
