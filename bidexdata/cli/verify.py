"""`bidexdata verify`: does a release keep its word."""

from __future__ import annotations

import time
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
            "--full", help="Also recompute figures and contacts, and simulate a sample again."
        ),
    ] = False,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Check a release against its manifest.

    Every hash, schema, count, row and split; with --full also what can be recomputed
    (docs/verifying.md says what each proves).

    Exit code 4 when the release contradicts its manifest. --json keys: path, ok, full, seconds,
    checks (a list of name, ok, detail), next.
    """
    from bidexdata.formats.verify import verify_release
    from bidexdata.runs.resimulate import resimulate

    start = time.monotonic()
    report = verify_release(release, full=full, resimulate=resimulate if full else None)
    lines = [f"{'ok ' if c.ok else 'BAD'} {c.name}: {c.detail}" for c in report.checks]
    finish(
        {**report.to_dict(), "seconds": round(time.monotonic() - start, 3)},
        lines,
        following=_following(release) if report.ok else "",
        as_json=as_json,
        quiet=quiet,
    )
    report.raise_if_bad()


def _following(release: Path) -> str:
    """Look at it; without meshes there is nothing to look at but its figures."""
    from bidexdata.formats.release import Release

    return command("view" if Release.open(release).has_shapes else "info", release)
