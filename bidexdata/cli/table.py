"""`bidexdata table`: one flat row per grasp, or per input file, for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.report import finish
from bidexdata.wording import counted


def table(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A library, a run or a release.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="A .csv or .parquet file.")],
    protocol: options.ProtocolName = None,
    rig: options.RigName = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Write one flat row per grasp of a run or release, or per input file of a library.

    docs/fields.md lists the columns and their units: SI, but for `size_mm`, codes, and what is a share
    of the diagonal in a library. An empty cell means that nothing is known, for a verdict that the
    test was not run.

    --json keys: out, kind, n (rows), columns, protocol.
    """
    from bidexdata.runs.table import write_table

    report = write_table(path, out, protocol=protocol, rig=rig, quiet=quiet)
    rows = counted(report.rows, "input" if report.kind == "library" else "row")
    verdicts = f", verdicts of {report.protocol}" if report.protocol else ""
    if report.kind != "library" and not report.protocol:
        verdicts = ", not validated"
    finish(
        {
            "out": str(out),
            "kind": report.kind,
            "n": report.rows,
            "columns": list(report.columns),
            "protocol": report.protocol,
        },
        [f"{out}: {rows}, {counted(len(report.columns), 'column')}{verdicts}"],
        as_json=as_json,
        quiet=quiet,
    )
