"""`bidexdata pack`: runs become a release."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.figures import figure_lines
from bidexdata.cli.report import command, finish, validate_again, warn
from bidexdata.wording import counted, listed


def pack(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Runs of the same hands.")],
    out: Annotated[Path, typer.Option(metavar="RELEASE", help="Folder of the release.")],
    name: Annotated[str, typer.Option(help="Name of the data set.")],
    version: Annotated[str, typer.Option(metavar="X.Y.Z", help="Version of the data set.")],
    form: Annotated[
        str,
        typer.Option(
            help="parquet, hdf5 (all rows in grasps.h5 alone), or both: Parquet and grasps.h5 as its "
            "training form."
        ),
    ] = "both",
    licences: Annotated[
        str,
        typer.Option(
            help="nc-ok (meshes that may be changed and given on), permissive (for any use), or "
            "ids-only (all objects by name and hash, no meshes)."
        ),
    ] = "nc-ok",
    split: Annotated[
        str, typer.Option(help="object, category or size: what is never in two splits.")
    ] = "object",
    protocol: Annotated[
        str | None,
        typer.Option(
            help="Whose verdicts are suc_f, suc_l, suc_a and the metrics; paper-1, or the only one, when "
            "left out. The tables hold those of every protocol."
        ),
    ] = None,
    rig: options.RigName = None,
    author: Annotated[
        list[str] | None,
        typer.Option(help="Family, Given or the name of a group; may be repeated."),
    ] = None,
    date: Annotated[str, typer.Option(metavar="YYYY-MM-DD", help="Day of the release.")] = "",
    url: Annotated[str, typer.Option(help="Address where the data set is found.")] = "",
    pictures: Annotated[
        bool, typer.Option("--pictures/--no-pictures", help="Draw the card's picture.")
    ] = True,
    seed: options.Seed = 0,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Write a release of finished runs.

    It holds tables, shapes, hands, clouds, a card with a picture, attribution, citation, a
    Croissant file and a manifest. Authors, date and address stand in the citation; nothing is
    taken from the clock. Objects that the licence policy leaves out are named.

    --json keys: release, name, version, protocol, rig (empty without arms), rigs_left_out, unfinished, untested, left_out (a list of object_id,
    licence), and all figures of the card (n, objects, scenes, suc_f, kept, by_size, by_status ...).
    """
    from bidexdata.formats.citation import About
    from bidexdata.runs.pack import LICENCE_HINT, pack_runs

    report = pack_runs(
        runs,
        out,
        name=name,
        version=version,
        form=form,
        licences=licences,
        split=split,
        protocol=protocol,
        rig=rig,
        seed=seed,
        about=About(authors=tuple(author or ()), date=date, url=url),
        pictures=pictures,
        quiet=quiet,
    )
    for unfinished, number in report.unfinished.items():
        warn(
            f"run {unfinished}: {counted(number, 'task is', 'tasks are')} not done; "
            "the release lacks the grasps"
        )
    for run in report.half_tested:
        rows = counted(run.rows, "row")
        missing = f"run {run.name}: {run.rows - run.tested} of {rows} not tested"
        warn(f"{missing}; `{validate_again(run.path, report.protocol)}` tests them")
    if report.untested:
        objects = counted(report.untested, "object has", "objects have")
        warn(f"{objects} no verdicts in the release, as some of their rows are not tested")
    if report.left_out:
        objects = counted(len(report.left_out), "object")
        named = listed([f"{o.object_id} ({o.licence})" for o in report.left_out])
        warn(f"left out under --licences {licences}: {objects}: {named}; {LICENCE_HINT}")
    data = {
        "release": str(report.path),
        "name": name,
        "version": version,
        "protocol": report.protocol,
        "rig": report.rig,
        "rigs_left_out": list(report.other_rigs),
        "unfinished": dict(report.unfinished),
        "untested": report.untested,
        "left_out": [o._asdict() for o in report.left_out],
        **report.figures,
    }
    lines = figure_lines(report.figures, report.protocol, rig=report.rig)
    if report.rig:
        others = f" (left out: {', '.join(report.other_rigs)}; --rig)" if report.other_rigs else ""
        lines.append(f"arms of {report.rig}{others}")
    lines.append(f"written to {report.path}")
    following = command("verify", out)
    if report.half_tested:  # a release of what nobody has tested is rarely what was meant
        following = validate_again(report.half_tested[0].path, report.protocol)
    finish(data, lines, following=following, as_json=as_json, quiet=quiet)
