"""The pack stage: one or several runs become a release."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from bidexdata.config import differing_keys, to_plain
from bidexdata.errors import NotUsable
from bidexdata.record import GraspBatch
from bidexdata.record.fields import columns_written_by
from bidexdata.record.scene import scene_parts
from bidexdata.record.settings import differing_settings, fuller_settings
from bidexdata.runs.chosen import DEFAULT_PROTOCOL, chosen_protocol
from bidexdata.runs.finished import Finished, Test
from bidexdata.runs.pack_objects import in_processes
from bidexdata.runs.progress import Progress
from bidexdata.runs.run import Run
from bidexdata.runs.run_rows import join_tasks
from bidexdata.runs.shards import read_mark, shard_path
from bidexdata.synthesis.method_names import DEFAULT_METHOD
from bidexdata.wording import counted

if TYPE_CHECKING:
    import numpy as np

    from bidexdata.formats.citation import About
    from bidexdata.formats.release import ReleaseRows, RunInfo
    from bidexdata.formats.rig_files import ReleaseRig
    from bidexdata.objects.prepared import PreparedObject


LICENCE_HINT = (
    "--licences ids-only packs the grasps without the meshes, and a list file's column `licence` "
    "states licences when they are prepared (docs/releases.md)"
)
"""What a person can do about objects that a policy leaves out."""


class LeftOut(NamedTuple):
    """An object that the licence policy leaves out."""

    object_id: str
    licence: str
    """As its source states it."""


class TestedRows(NamedTuple):
    """How many finished rows of a run have verdicts."""

    name: str
    path: Path
    tested: int
    rows: int


@dataclass(frozen=True, slots=True)
class PackReport:
    """What was packed."""

    path: Path
    protocol: str
    """Whose verdicts are `suc_*` and the metrics."""
    figures: Mapping[str, Any]
    """As in the manifest and the card."""
    unfinished: Mapping[str, int] = field(default_factory=dict)
    """Tasks per run that are not done; their rows are not in the release."""
    untested: int = 0
    """Objects without verdicts because not all their rows are validated."""
    left_out: tuple[LeftOut, ...] = ()
    """Objects left out for their licence."""
    half_tested: tuple[TestedRows, ...] = ()
    """Runs with rows that the protocol has not tested."""


class NamedRun(NamedTuple):
    """A run, its name in the release, and what of it is packed."""

    name: str
    run: Run
    finished: Finished


def pack_runs(
    paths: Sequence[str | Path],
    out: str | Path,
    *,
    name: str,
    version: str,
    form: str = "both",
    licences: str = "nc-ok",
    split: str = "object",
    protocol: str | None = None,
    seed: int = 0,
    about: About | None = None,
    rig: str | Path | None = None,
    pictures: bool = True,
    quiet: bool = False,
) -> PackReport:
    """Write a release of all finished rows of some runs.

    Args:
        paths: Runs of the same hands; every run once.
        out: The release folder; must not exist or be empty.
        name: Name of the data set.
        version: Its version, X.Y.Z.
        form: `both`, `parquet` without the training form, or `hdf5`: rows in that form alone.
        licences: `permissive` and `nc-ok` leave out objects whose licence is unknown or forbids
            what the policy promises; `ids-only` names all objects and leaves out all meshes.
        split: `object`, `category` or `size`: what is never in two splits.
        protocol: Whose verdicts become `suc_*` and the metrics; `paper-1` or the only one that
            the runs have verdicts of when omitted.
        seed: Seed of the split into train and test.
        about: Authors, date and address of the data set.
        rig: Whose arm solutions are packed, of runs that have those of several; see `Run.rig`.
        pictures: Draw the card's picture.
        quiet: No progress.

    Raises:
        BadValue: The name or version cannot be used.
        NotUsable: Nothing to pack, runs that do not fit together, a bad form or target, or
            verdicts of several protocols and no saying which.
        UnknownName: No run has verdicts of the protocol.
    """
    from bidexdata.formats.licences import check_policy
    from bidexdata.formats.release import write_release
    from bidexdata.formats.splits import check_rule
    from bidexdata.formats.writer import check_names
    from bidexdata.runs.release_pictures import card_pictures

    check_names(Path(out), name, version, form)  # before anything is read
    check_policy(licences)
    check_rule(split)
    runs = _named([_opened(Run.open(p), rig) for p in paths])
    _check_hands(runs)
    arms = _rig(runs)
    objects = _objects(runs)
    left_out = _refused_by_licence(objects, licences)
    ids = sorted(set(objects) - {o.object_id for o in left_out})
    if not ids:
        raise _nothing_left(left_out, licences)
    tests = sorted({t for r in runs for t in r.finished.tests})
    named = " ".join(str(r.run.path) for r in runs)
    protocol = chosen_protocol(named, tests, protocol) or DEFAULT_PROTOCOL
    untested: Counter[str] = Counter()

    def rows_of(object_id: str) -> Iterator[ReleaseRows]:
        for one in runs:
            rows = rows_of_object(one.run, one.finished, object_id, one.name, tests)
            if rows is not None:
                untested[object_id] += int(set(rows.verdicts) < set(one.finished.tests))
                yield rows

    def load_object(object_id: str) -> PreparedObject:
        return objects[object_id].library.load(object_id)

    with Progress(len(ids), "object", quiet=quiet) as progress:
        summary = write_release(
            Path(out),
            name=name,
            version=version,
            object_ids=ids,
            rows_of=rows_of,
            load_object=load_object,
            hands=runs[0].run.hands(),
            runs=[run_info(r) for r in runs],
            tests=tests,
            default_protocol=protocol,
            protocols=_protocols(runs, tests),
            seed=seed,
            split_by=split,
            sizes_mm=_sizes(runs, set(ids)),
            licences=licences,
            about=about,
            rig=arms,
            pictures=card_pictures if pictures else None,
            form=cast("Any", form),
            on_object=lambda object_id: progress.advance(note=object_id),
            each_object=in_processes({i: run.library for i, run in objects.items()}),
        )
    unfinished = {r.name: len(r.run.tasks) - len(r.finished.rows) for r in runs}
    counts = [
        TestedRows(r.name, r.run.path, *count_tested(r.run, r.finished, protocol)) for r in runs
    ]
    return PackReport(
        summary.path,
        protocol,
        summary.figures,
        {k: v for k, v in unfinished.items() if v},
        sum(1 for n in untested.values() if n),
        tuple(left_out),
        tuple(c for c in counts if c.tested < c.rows),
    )


def count_tested(run: Run, finished: Finished, protocol: str) -> tuple[int, int]:
    """Count the finished rows that every test begun of a protocol has a verdict on, and all."""
    tested = finished.tested([t for t in finished.tests if t[0] == protocol])
    folder = run.stage_folder("rows")
    rows = {i: read_mark(shard_path(folder, i)).rows for i in finished.rows}
    return sum(rows[i] for i in tested), sum(rows.values())


def rows_of_object(
    run: Run, finished: Finished, object_id: str, name: str, tests: Sequence[Test]
) -> ReleaseRows | None:
    """All finished rows of one object of a run, rounds joined, with their verdicts.

    A test that is not finished for all these rows is left out: half-tested scenes have no rate.
    """
    import numpy as np

    from bidexdata.formats.release import ReleaseRows

    tasks = finished.tasks_of(run, object_id)
    if not tasks:
        return None
    batches = [run.task_batch(t) for t in tasks]
    verdicts: dict[Test, dict[str, np.ndarray]] = {}
    for protocol, test in tests:
        if {t.task_id for t in tasks} <= finished.verdicts.get((protocol, test), frozenset()):
            pairs = zip(tasks, batches, strict=True)
            parts = [run.task_verdicts(t, b, protocol, test) for t, b in pairs]
            verdicts[protocol, test] = {c: np.concatenate([p[c] for p in parts]) for c in parts[0]}
    if not {t.task_id for t in tasks} <= finished.armed:
        return ReleaseRows(name, join_tasks(batches), verdicts)
    solved = join_tasks([run.task_arms(t, b) for t, b in zip(tasks, batches, strict=True)])
    arms = {n: solved[n] for n in columns_written_by("arms")}
    rows = {n: c for n, c in solved.columns.items() if n not in arms}
    return ReleaseRows(name, GraspBatch(solved.header, rows), verdicts, arms)


def run_info(one: NamedRun) -> RunInfo:
    """What the release's table of runs says of a run: no paths, no times."""
    from bidexdata.formats.release import RunInfo

    spec = one.run.spec
    return RunInfo(
        name=one.name,
        fingerprint=spec.fingerprint,
        grasps=spec.grasps,
        candidates=spec.candidates,
        seed=spec.seed,
        preset=spec.preset if spec.method in ("", DEFAULT_METHOD) else spec.method,
        setting=spec.setting,
        library_fingerprint=spec.source_fingerprint,
        version=spec.versions.get("bidexdata", ""),
        config=spec.config,
    )


def _named(runs: Sequence[Run]) -> list[NamedRun]:
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


def _check_hands(runs: Sequence[NamedRun]) -> None:
    first = runs[0]
    for other in runs[1:]:
        if other.run.spec.hands != first.run.spec.hands:
            raise NotUsable(
                f"{other.run.path} has other hands ({other.run.spec.hand}) than {first.run.path} "
                f"({first.run.spec.hand}), or another version of them; pack them apart"
            )


def _opened(run: Run, rig: str | Path | None) -> Run:
    """The run for the rig that is asked for; as it is, where it has no arm solutions at all."""
    return run.for_rig(rig) if rig is not None and run.arm_rigs() else run


def _rig(runs: Sequence[NamedRun]) -> ReleaseRig | None:
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


def _objects(runs: Sequence[NamedRun]) -> dict[str, Run]:
    """The objects with finished rows, and a run whose library has each."""
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


def _protocols(runs: Sequence[NamedRun], tests: Sequence[Test]) -> dict[str, Any]:
    """Settings of the protocols that the runs have verdicts of; one name, one protocol."""
    found: dict[str, tuple[Path, Any]] = {}
    for one in runs:
        for name in sorted({p for p, _ in tests}):
            if not (one.run.path / "validate" / name).is_dir():
                continue
            mine = to_plain(one.run.protocol(name))
            first, known = found.setdefault(name, (one.run.path, mine))
            differing = differing_settings(known, mine)
            if differing:
                raise NotUsable(
                    f"{one.run.path} and {first} have verdicts of different protocols called "
                    f"{name!r} ({differing[0]}); validate one of them again under another name"
                )
            found[name] = (first, fuller_settings(known, mine))
    return {name: settings for name, (_, settings) in sorted(found.items())}


def _sizes(runs: Sequence[NamedRun], ids: set[str]) -> set[int]:
    tasks = (t for one in runs for t in one.run.tasks if t.object_id in ids)
    return {scene_parts(scene).size_mm for task in tasks for scene in task.scene_ids}


def _refused_by_licence(objects: Mapping[str, Run], licences: str) -> list[LeftOut]:
    from bidexdata.formats.licences import UNKNOWN, allows

    found = []
    for object_id, run in sorted(objects.items()):
        licence = str(run.library.row(object_id)["licence"] or UNKNOWN)
        if not allows(licence, licences):
            found.append(LeftOut(object_id, licence))
    return found


def _nothing_left(left_out: Sequence[LeftOut], licences: str) -> NotUsable:
    if not left_out:
        return NotUsable("there is nothing to pack: no run has finished rows of a usable object")
    first = left_out[0]
    return NotUsable(
        f"there is nothing to pack under --licences {licences}: "
        f"{counted(len(left_out), 'object has a licence', 'objects have licences')} that "
        f"{'does' if len(left_out) == 1 else 'do'} not allow it (first: {first.object_id}, "
        f"{first.licence}); {LICENCE_HINT}"
    )
