"""`bidexdata bench`: the paper's tables, made again on a library of one's own."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, finish, percent, table, warn

bench = typer.Typer(invoke_without_command=True, no_args_is_help=False)

BENCHES = {"tables": "the paper's tables of the data synthesis on a library: success, depth, speed"}


@bench.callback()
def _list(
    context: options.Context,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """List what can be measured, or measure it.

    --json keys: benches (a list of name, description).
    """
    if context.invoked_subcommand is not None:
        return
    found = [{"name": name, "description": text} for name, text in BENCHES.items()]
    lines = table([[f["name"], f["description"]] for f in found])
    lines.append(f"how: {command('bench', 'tables', '--help')}")
    finish({"benches": found}, lines, as_json=as_json, quiet=quiet)


@bench.command("tables")
def _tables(
    library: Annotated[Path, typer.Argument(metavar="LIBRARY", help="Made by prepare.")],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of the rows and tables; resumed.")
    ],
    hand: Annotated[
        str, typer.Option(help="NAME or LEFT,RIGHT; `bidexdata hands` lists them.")
    ] = "shadow",
    sizes: Annotated[
        str, typer.Option(help="Bounding-box diagonals in metres, separated by commas.")
    ] = "0.3,0.5,0.8",
    grasps: Annotated[
        int, typer.Option(min=1, help="Grasps kept per scene; may grow in a later call.")
    ] = 5,
    limit: Annotated[
        int | None,
        typer.Option(min=1, help="Only the first so many objects; may differ in a later call."),
    ] = None,
    workers: options.Workers = 0,
    executor: options.ExecutorName = "processes",
    seed: options.Seed = 0,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Make the paper's tables again: comparison, ablation, region quality.

    Each row is a run DIR/ROW, made and tested as by synth and validate, which other commands take
    too. The same command goes on after a stop, and does nothing where nothing is missing. Writes
    DIR/tables.md and DIR/tables.json, with the paper's figures beside ours. docs/tables.md says
    what each row is and which of them are readings of the paper.

    --json keys: those of tables.json (version, library, hand, sizes_mm, grasps, seed, protocol,
    rows, table_2, table_3, regions, paper; docs/tables.md), and files, seconds.
    """
    started = time.perf_counter()
    from bidexdata.errors import NothingSucceeded
    from bidexdata.runs.bench_tables import TablesRequest, make_tables

    execution = options.execution_of(executor, workers, None, quiet)
    asked = TablesRequest(
        hand=hand, sizes_mm=options.parse_sizes(sizes), grasps=grasps, limit=limit, seed=seed
    )
    say = (lambda _: None) if quiet else (lambda text: warn(f"-- {text}"))
    report = make_tables(library, out, asked, execution=execution, say=say)
    for failure in report.failures:
        warn(f"{failure}; the same command tries them again")
    seconds = round(time.perf_counter() - started, 3)
    files = [str(report.markdown_file), str(report.json_file)]
    finish(
        {**report.data, "files": files, "seconds": seconds},
        [
            *_lines(report.data),
            f"tables with the paper's figures: {files[0]}, all counts: {files[1]}",
        ],
        as_json=as_json,
        quiet=quiet,
    )
    rates = (rate for row in report.data["rows"].values() for rate in _rates(row))
    if not any(rate["k"] for rate in rates):
        raise NothingSucceeded(
            f"{out}: not one grasp passed; {files[0]} counts what became of them"
        )


def _lines(data: Mapping[str, Any]) -> list[str]:
    from bidexdata.runs.bench_markdown import difference, mean_text

    rows = [["row", "SUC-F, unselected", "selected", "SUC-L, unselected", "selected", "differs by"]]
    for row in data["rows"].values():
        rates = [
            percent(row[kind].get(test))
            for test in ("suc_f", "suc_l")
            for kind in ("unselected", "selected")
        ]
        rows.append([row["title"], *rates, difference(row)])
    kinds = [["regions", "Q1 [1e-2]", "what"]]
    for name, kind in data["regions"]["kinds"].items():
        kinds.append([name, mean_text(kind["q1"], 2, 100.0), kind["says"]])
    return [*table(rows), *table(kinds)]


def _rates(row: dict[str, Any]) -> list[dict[str, Any]]:
    kinds = (row["unselected"], row["selected"])
    return [kind[key] for kind in kinds for key in ("suc_f", "suc_l") if key in kind]
