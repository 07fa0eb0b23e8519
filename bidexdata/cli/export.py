"""`bidexdata export`: grasps in the format of another project, or motions of arms for controllers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, counts_text, finish
from bidexdata.wording import counted


def export(
    path: Annotated[
        Path, typer.Argument(metavar="RUN|RELEASE", help="A release; for trajectories a run too.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="New folder for what is written.")],
    format_: Annotated[
        str,
        typer.Option("--format", help="dexgraspbench, trajectories-csv or trajectories-ros."),
    ] = "dexgraspbench",
    split: Annotated[str | None, typer.Option(help="Only this split, such as test.")] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first N grasps.")] = None,
    rig: options.RigName = None,
    only: Annotated[
        str | None,
        typer.Option(help="success or failure: trajectories that test a said this of."),
    ] = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Write selected grasps for other programs.

    dexgraspbench: the grasps of a release with their objects, one file per grasp. Releases of the
    right Shadow hand are written for DexGraspBench, those of both Shadow hands for its two-handed
    fork, BimanDexGraspBench.

    trajectories-csv, trajectories-ros: the motions of two arms that `bidexdata arms` found, from a
    run or a release: per grasp a CSV with a row per knot, or a trajectory_msgs/JointTrajectory as
    JSON per arm and per hand. INDEX.csv has the objects' poses, README.md says what is what.

    --json keys: out, format, n, skipped (rows without a pose or a motion, per status), objects and
    hands (dexgraspbench), rig (trajectories), seconds.
    """
    from bidexdata.errors import BadValue
    from bidexdata.runs.trajectories import FORMATS

    if format_ in FORMATS:
        how = {"rig": rig, "split": split, "limit": limit, "only": only}
        _trajectories(path, out, format_, how, as_json=as_json, quiet=quiet)
        return
    given = options.given_names({"--rig": rig is not None, "--only": only is not None})
    if given:
        raise BadValue(f"{given} goes with --format {' and '.join(FORMATS)}, not with {format_}")
    _grasps(path, out, format_, {"split": split, "limit": limit}, as_json=as_json, quiet=quiet)


def _grasps(
    path: Path, out: Path, form: str, how: dict[str, Any], *, as_json: bool, quiet: bool
) -> None:
    from bidexdata.runs.export import export_release

    report = export_release(path, out, format=form, quiet=quiet or as_json, **how)
    data = {
        "out": str(report.out),
        "format": form,
        "n": report.grasps,
        "skipped": dict(report.skipped),
        "objects": report.objects,
        "hands": list(report.hands),
        "seconds": round(report.seconds, 3),
    }
    lines = [
        f"{counted(report.grasps, 'grasp')} of {counted(report.objects, 'object')} written in "
        f"{report.seconds:.1f} s; paths of objects are relative to {report.out}"
    ]
    if report.skipped:
        lines.append(f"left out, without a pose: {counts_text(report.skipped)}")
    back = "bimandexgraspbench" if len(report.hands) == 2 else "dexgraspbench"
    following = command("import", back, report.out, "--out", "RUN")
    finish(data, lines, following=following, as_json=as_json, quiet=quiet)


def _trajectories(
    path: Path, out: Path, form: str, how: dict[str, Any], *, as_json: bool, quiet: bool
) -> None:
    from bidexdata.runs.trajectories import FORMATS, README, export_trajectories

    report = export_trajectories(path, out, FORMATS[form], quiet=quiet or as_json, **how)
    data = {
        "out": str(report.out),
        "format": form,
        "n": report.grasps,
        "skipped": dict(report.skipped),
        "rig": report.rig,
        "seconds": round(report.seconds, 3),
    }
    lines = [
        f"{counted(report.grasps, 'motion')} of {report.rig} written in {report.seconds:.1f} s; "
        f"{report.out / README} says what is what"
    ]
    if report.skipped:
        lines.append(f"left out, without a motion: {counts_text(report.skipped)}")
    finish(data, lines, as_json=as_json, quiet=quiet)
