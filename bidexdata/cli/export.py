"""`bidexdata export`: a release in the format of another project."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, counts_text, finish
from bidexdata.wording import counted


def export(
    release: Annotated[Path, typer.Argument(metavar="RELEASE", help="Folder of the release.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="New folder for what is written.")],
    format_: Annotated[str, typer.Option("--format", help="dexgraspbench.")] = "dexgraspbench",
    split: Annotated[str | None, typer.Option(help="Only this split, such as test.")] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first N grasps.")] = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Write the selected grasps of a release, with their objects, for another project's tools.

    One file per grasp. Releases of the right Shadow hand are written for DexGraspBench, those of
    both Shadow hands for its two-handed fork, BimanDexGraspBench.

    --json keys: out, format, n, skipped (rows without a pose, per status), objects, hands, seconds.
    """
    from bidexdata.runs.export import export_release

    report = export_release(
        release, out, format=format_, split=split, limit=limit, quiet=quiet or as_json
    )
    data = {
        "out": str(report.out),
        "format": format_,
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
    finish(
        data,
        lines,
        following=command("import", back, report.out, "--out", "RUN"),
        as_json=as_json,
        quiet=quiet,
    )
