"""`bidexdata verify`: does a release keep its word."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, finish


def verify(
    release: Annotated[Path, typer.Argument(metavar="RELEASE", help="Folder of the release.")],
    full: Annotated[
        bool,
        typer.Option(
            "--full", help="Also decode, recompute contacts, and simulate a sample again."
        ),
    ] = False,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Check a release against its manifest.

    Every hash, schema, count and split; with --full also what can be recomputed.

    Exit code 4 when the release contradicts its manifest. --json keys: path, ok, full, checks
    (a list of name, ok, detail).
    """
    from bidexdata.formats.verify import verify_release
    from bidexdata.runs.resimulate import resimulate

    report = verify_release(release, full=full, resimulate=resimulate if full else None)
    lines = [f"{'ok ' if c.ok else 'BAD'} {c.name}: {c.detail}" for c in report.checks]
    finish(
        report.to_dict(),
        lines,
        following=command("view", release) if report.ok else "",
        as_json=as_json,
        quiet=quiet,
    )
    report.raise_if_bad()
