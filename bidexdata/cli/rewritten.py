"""How migrate, merge, split and subset end: one report for all four."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bidexdata.cli.figures import figure_lines
from bidexdata.cli.report import command, finish, warn

if TYPE_CHECKING:
    from bidexdata.runs.rewrite import RewriteReport

Source = Annotated[Path, typer.Argument(metavar="RELEASE", help="Folder of the release.")]
Target = Annotated[
    Path, typer.Option("--out", metavar="NEW", help="Folder of the new release; must be free.")
]
NewName = Annotated[
    str | None, typer.Option("--name", help="Name of the new release; the old one when left out.")
]
NewVersion = Annotated[
    str, typer.Option("--version", metavar="X.Y.Z", help="Version of the new release.")
]
Pictures = Annotated[
    bool, typer.Option("--pictures/--no-pictures", help="Draw the card's picture.")
]


def finish_rewritten(
    report: RewriteReport, lines: Sequence[str] = (), *, as_json: bool, quiet: bool
) -> None:
    """Print what became of a release."""
    if not report.whole_scenes:
        warn(
            "rows were chosen one by one: the new release has no unselected rate and no kept share"
        )
    data: dict[str, Any] = {
        "release": str(report.path),
        "protocol": report.protocol,
        "whole_scenes": report.whole_scenes,
        **report.figures,
    }
    said = [*figure_lines(report.figures, report.protocol), *lines, f"written to {report.path}"]
    finish(
        data,
        said,
        following=command("verify", report.path, "--full"),
        as_json=as_json,
        quiet=quiet,
    )
