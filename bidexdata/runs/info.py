"""What a folder is, how far it is, and its figures: for libraries, runs and releases."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bidexdata.errors import NotUsable, UnknownName
from bidexdata.kinds import expect_kind
from bidexdata.record import Status
from bidexdata.runs.chosen import check_protocol, refuse_other_rig
from bidexdata.runs.finished import Finished
from bidexdata.runs.pack_rows import count_tested, rows_of_object
from bidexdata.runs.run import Run
from bidexdata.runs.run_folder import PROTOCOL_FILE
from bidexdata.runs.shards import read_mark, shard_path

if TYPE_CHECKING:
    from bidexdata.formats.figures import Tally
    from bidexdata.formats.release import Release
    from bidexdata.objects.library import Library
    from bidexdata.runs.spec import RunSpec


def describe(
    path: str | Path,
    by: str | None = None,
    protocol: str | None = None,
    rig: str | Path | None = None,
) -> dict[str, Any]:
    """Describe a library, a run or a release as plain data (the keys of `info --json`).

    Args:
        path: What to describe.
        by: A grouping of `formats.groups.BY`: gives the figures of its groups too, as `groups`
            (protocol, test, group).
        protocol: Whose figures and groups; when omitted the figures of a release's default
            protocol, or of all that a run has verdicts of, and the groups of all.
        rig: Whose arms are meant in a run that has solutions of several rigs; see `Run.rig`.

    Raises:
        PathNotFound: There is none of the three.
        UnknownName: There is no such grouping, or there are no verdicts of this protocol or arms of
            this rig.
        NotUsable: A library, which holds no grasps, is to be grouped.
        Contradiction: It is damaged.
    """
    from bidexdata.formats.groups import BY
    from bidexdata.formats.release import Release
    from bidexdata.objects.library import Library

    if by is not None and by not in BY:
        raise UnknownName("grouping", by, BY)
    kind = expect_kind(path, "library", "run", "release")
    if kind == "release":
        release = Release.open(path)
        refuse_other_rig(path, release.rig, rig)
        return describe_release(release, by, protocol)
    if kind == "run":
        return describe_run(Run.open(path, rig=rig), by, protocol)
    refuse_other_rig(path, "", rig)
    check_protocol((), protocol)
    if by is not None:
        raise NotUsable(f"{path} is a library: it holds no grasps that --by {by} could group")
    return describe_library(Library.open(path))


def describe_library(library: Library) -> dict[str, Any]:
    """Inputs per status, those that gave no object, and what to know of the others."""
    from bidexdata.objects.library import failures_of, warnings_of

    rows = library.index.to_pylist()
    return {
        "kind": "library",
        "path": str(library.path),
        "fingerprint": library.fingerprint,
        "inputs": len(rows),
        "objects": len(library.object_ids),
        "hulls": sum(r["piece_method"] == "hull" for r in rows),
        "by_status": dict(sorted(Counter(Status(r["status"]).label for r in rows).items())),
        "failures": failures_of(rows),
        "warnings": warnings_of(rows),
    }


def describe_run(run: Run, by: str | None = None, protocol: str | None = None) -> dict[str, Any]:
    """Progress per stage, and figures per protocol over all finished rows; groups if asked for."""
    spec, finished = run.spec, Finished.of(run)
    check_protocol(finished.tests, protocol)
    stages = {run.stage_folder("rows").name: len(finished.rows)}
    if finished.armed:
        stages[_stage_name(run, run.arms_folder())] = len(finished.armed)
    for (name, test), tasks in finished.verdicts.items():
        stages[_stage_name(run, run.stage_folder("validate", name, test))] = len(tasks)
    protocols = [protocol] if protocol else sorted({p for p, _ in finished.tests}) or [""]
    tallies = {p: run_tally(run, finished, p) for p in protocols}
    figures = {p: run_figures(run, finished, p, *counted) for p, counted in tallies.items()}
    groups = {
        p: {t: tally.groups(t, by) for t in tally.tests}
        for p, (tally, _) in tallies.items()
        if p and by is not None
    }
    return {
        "kind": "run",
        "path": str(run.path),
        "fingerprint": run.fingerprint,
        "hand": spec.hand,
        "method": spec.method,
        "preset": spec.preset,
        "changed": changed_keys(spec),
        "setting": spec.setting,
        **_imported(run),
        "rest_poses": spec.rest_poses,
        "without_scene": list(spec.without_scene),
        "without_grasp": tallies[protocols[0]][0].without_grasp(),
        "sizes_mm": list(spec.sizes_mm),
        "grasps": spec.grasps,
        "candidates": spec.candidates,
        "seed": spec.seed,
        "objects": len(run.object_ids),
        "tasks": len(run.tasks),
        "rig": run.rig,
        "rigs": list(run.arm_rigs()),
        "arms": arms_of(run, finished),
        "made_for": spec.rig.name if spec.rig else "",
        "unfinished": _unfinished(run, finished),
        "done": stages,
        "made_with": made_with_of(run, finished),
        "figures": figures[protocols[0]],
        "protocols": {p: found for p, found in figures.items() if p},
        **({"by": by, "groups": groups} if by else {}),
    }


def arms_of(run: Run, finished: Finished) -> dict[str, Any]:
    """What the arms that are meant came to, per kind of rows; nothing where none are solved."""
    from bidexdata.runs.arm_counts import ROWS, ArmCounts

    if not finished.armed:
        return {}
    counts = ArmCounts.of_run(run, finished.armed & finished.rows)
    return {kind: counts.figures(kind) for kind in ROWS}


def _unfinished(run: Run, finished: Finished) -> list[str]:
    """Protocols that a validation was started with, and no task has a verdict of."""
    known = {name for name, _ in finished.tests}
    started = (run.path / "validate").glob(f"*/{PROTOCOL_FILE}")
    return sorted({path.parent.name for path in started} - known)


def changed_keys(spec: RunSpec) -> list[str]:
    """Give the keys that a run's configuration sets to something else than where it started from.

    As `--set` takes them: `staging.mass=0.5`. None for imported rows, and where the preset is no
    longer there.
    """
    from bidexdata.config import differing_keys, to_plain
    from bidexdata.synthesis.method_names import DEFAULT_METHOD
    from bidexdata.synthesis.methods import load_method
    from bidexdata.synthesis.presets import load_preset

    if spec.kind != "synth":
        return []
    try:
        method = load_method(spec.method or DEFAULT_METHOD)
        base = load_preset(spec.preset) if method.name == DEFAULT_METHOD else method.config()
    except UnknownName:
        return []
    differing = differing_keys(to_plain(base), spec.config)
    return [re.sub(r": .* -> ", "=", text, count=1) for text in differing]


def _imported(run: Run) -> dict[str, Any]:
    """What became of the files of an imported run; nothing for other runs."""
    if run.spec.kind != "import":
        return {}
    from bidexdata.runs.import_scan import read_files

    files = read_files(run.path)
    told = [{"file": f.file, "reason": f.reason} for f in files if f.reason]
    counts = {
        "read": sum(not f.failed for f in files),
        "failed": sum(f.failed for f in files),
        "left_out": sum(f.left_out for f in files),
    }
    return {"files": {**counts, "failures": told}}


def made_with_of(run: Run, finished: Finished) -> dict[str, list[dict[str, Any]]]:
    """Devices and versions per stage, each with the number of tasks, the most used first."""
    stages = {run.stage_folder("rows"): finished.rows}
    if finished.armed:
        stages[run.arms_folder()] = finished.armed
    for (protocol, test), tasks in finished.verdicts.items():
        stages[run.stage_folder("validate", protocol, test)] = tasks
    found = {}
    for folder, tasks in stages.items():
        marks = (read_mark(shard_path(folder, task_id)) for task_id in tasks)
        kinds = Counter(tuple(sorted(mark.made_with.items())) for mark in marks)
        ordered = sorted(kinds.items(), key=lambda kind: (-kind[1], kind[0]))
        found[_stage_name(run, folder)] = [{"tasks": n, **dict(kind)} for kind, n in ordered]
    return found


def _stage_name(run: Run, folder: Path) -> str:
    return folder.relative_to(run.path).as_posix()


def run_figures(
    run: Run, finished: Finished, protocol: str, tally: Tally, untested: int
) -> dict[str, Any]:
    """What a run's rows come to; `tally` and `untested` are from `run_tally`."""
    tested_rows, _ = count_tested(run, finished, protocol)
    figures = tally.figures()
    for test, found in figures["tests"].items():
        found["by_verdict_selected"] = tally.selected_verdicts(test)
    return {**figures, "untested_objects": untested, "tested_rows": tested_rows}


def run_tally(run: Run, finished: Finished, protocol: str) -> tuple[Tally, int]:
    """Count a run's finished rows; rates where all rows of an object are tested.

    The definitions are those of `formats.figures`, the same as in a release.

    Returns:
        The counts, and the number of objects whose rows are not all tested.
    """
    from bidexdata.formats.figures import Tally

    tests = tuple(t for p, t in finished.tests if p == protocol)
    tally = Tally(tests or ("f",))
    untested = 0
    for object_id in run.object_ids:
        rows = rows_of_object(run, finished, object_id, "", [(protocol, t) for t in tests])
        if rows is None:
            continue
        untested += len(rows.verdicts) < len(tests)
        verdicts = {t: columns for (_, t), columns in rows.verdicts.items()}
        tally.add(rows.batch, verdicts, grasps=run.spec.grasps)
    return tally, untested


def describe_release(
    release: Release, by: str | None = None, protocol: str | None = None
) -> dict[str, Any]:
    """Name, version and the figures that the manifest states; groups, if asked for, of the rows.

    Raises:
        UnknownName: There are no verdicts of this protocol.
        NotUsable: The manifest, of an older version, states no figures of it.
    """
    check_protocol(release.protocols, protocol)
    name = protocol or release.default_protocol
    every = {**release.other_figures, release.default_protocol: release.figures}
    if name not in every:
        raise NotUsable(
            f"{release.path} states the figures of {', '.join(every)} only; pack its runs again "
            f"for those of {name}"
        )
    tests = [(p, t) for p, t in release.protocols if protocol in (None, p)]
    return {
        "kind": "release",
        "path": str(release.path),
        "name": release.name,
        "version": release.version,
        "schema_version": release.header.schema_version,
        "default_protocol": release.default_protocol,
        "tests": [list(t) for t in release.protocols],
        "splits": {name: len(ids) for name, ids in release.splits.items()},
        "hands": [f"{h.name} ({h.side})" for h in release.hands],
        "rig": release.rig,
        "protocol": name,
        "figures": every[name],
        **({"by": by, "groups": release_groups(release, by, tests)} if by else {}),
    }


def release_groups(release: Release, by: str, tests: Iterable[tuple[str, str]]) -> dict[str, Any]:
    """Figures of every group per protocol and test, from the rows, row group by row group.

    The manifest states those of few groups only, and only of the default protocol.
    """
    from bidexdata.formats.groups import GroupTally, hands_label
    from bidexdata.formats.verdict_rows import verdict_rows

    found: dict[str, Any] = {}
    for protocol, test in tests:
        tally = GroupTally()
        for configuration in release.configurations if by == "status" else ("selected",):
            for rows in verdict_rows(release, protocol, test, configuration):
                tally.add(
                    *(rows.object_id, rows.size_mm, rows.setting),
                    *(hands_label(release.header), rows.passed, rows.verdict),
                    np.full(len(rows.object_id), configuration == "selected"),
                )
        found.setdefault(protocol, {})[test] = tally.groups(by)
    return found
