"""What a folder is, how far it is, and its figures: for libraries, runs and releases."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bidexdata.errors import NotUsable, PathNotFound
from bidexdata.record import Status
from bidexdata.runs.pack import count_tested, rows_of_object
from bidexdata.runs.run import Run

if TYPE_CHECKING:
    from bidexdata.formats.release import Release
    from bidexdata.objects.library import Library


def describe(path: str | Path) -> dict[str, Any]:
    """Describe a library, a run or a release as plain data (the keys of `info --json`).

    Raises:
        PathNotFound: Nothing is there.
        NotUsable: It is none of the three.
        Contradiction: It is damaged.
    """
    path = Path(path)
    if not path.exists():
        raise PathNotFound(path, "a library, a run or a release")
    if (path / "manifest.json").exists():
        from bidexdata.formats.release import Release

        return describe_release(Release.open(path))
    if (path / "run.json").exists():
        return describe_run(Run.open(path))
    if (path / "index.parquet").exists() or (path / "objects").is_dir():
        from bidexdata.objects.library import Library

        return describe_library(Library.open(path))
    raise NotUsable(
        f"{path} is neither a library (index.parquet), a run (run.json) nor a release "
        "(manifest.json)"
    )


def describe_library(library: Library) -> dict[str, Any]:
    """Inputs per status, and the inputs that gave no object."""
    rows = library.index.to_pylist()
    return {
        "kind": "library",
        "path": str(library.path),
        "fingerprint": library.fingerprint,
        "inputs": len(rows),
        "objects": len(library.object_ids),
        "hulls": sum(r["piece_method"] == "hull" for r in rows),
        "by_status": dict(sorted(Counter(Status(r["status"]).label for r in rows).items())),
        "failures": [
            {
                "source_name": r["source_name"],
                "status": Status(r["status"]).label,
                "reason": r["reason"],
            }
            for r in rows
            if r["status"] != Status.OK
        ],
    }


def describe_run(run: Run) -> dict[str, Any]:
    """Progress per stage, and figures per protocol over all finished rows."""
    spec, tests = run.spec, run.verdict_tests()
    stages = {run.stage_folder("rows").name: len(run.done())}
    for protocol, test in tests:
        stages[f"validate/{protocol}/{test}"] = len(run.done(protocol, test))
    protocols = sorted({p for p, _ in tests}) or [""]
    return {
        "kind": "run",
        "path": str(run.path),
        "fingerprint": run.fingerprint,
        "hand": spec.hand,
        "preset": spec.preset,
        "setting": spec.setting,
        **_imported(run),
        "sizes_mm": list(spec.sizes_mm),
        "grasps": spec.grasps,
        "candidates": spec.candidates,
        "seed": spec.seed,
        "objects": len(run.object_ids),
        "tasks": len(run.tasks),
        "done": stages,
        "figures": run_figures(run, protocols[0]),
        "protocols": {p: run_figures(run, p) for p in protocols if p},
    }


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


def run_figures(run: Run, protocol: str) -> dict[str, Any]:
    """Figures of a run's finished rows; rates where all rows of an object are tested.

    The definitions are those of `formats.figures`, the same as in a release.
    """
    from bidexdata.formats.figures import Tally

    tests = tuple(t for p, t in run.verdict_tests() if p == protocol)
    tally = Tally(tests or ("f",))
    untested = 0
    tested_rows, _ = count_tested(run, protocol)
    for object_id in run.object_ids:
        rows = rows_of_object(run, object_id, "", [(protocol, t) for t in tests])
        if rows is None:
            continue
        untested += len(rows.verdicts) < len(tests)
        verdicts = {t: columns for (_, t), columns in rows.verdicts.items()}
        tally.add(rows.batch, verdicts, grasps=run.spec.grasps)
    return {**tally.figures(), "untested_objects": untested, "tested_rows": tested_rows}


def describe_release(release: Release) -> dict[str, Any]:
    """Name, version and the figures that the manifest states."""
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
        "figures": release.figures,
    }
