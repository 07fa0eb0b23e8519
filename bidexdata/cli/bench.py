"""`bidexdata bench`: the paper's tables on a library of one's own, and the speed of a machine."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, finish, percent, table, warn
from bidexdata.wording import counted

bench = typer.Typer(invoke_without_command=True, no_args_is_help=False)

BENCHES = {
    "tables": "the paper's tables of the data synthesis on a library: success, depth, speed",
    "speed": "how fast each stage is on this machine, on built-in objects",
}


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
    lines += [f"how: {command('bench', name, '--help')}" for name in BENCHES]
    finish({"benches": found}, lines, as_json=as_json, quiet=quiet)


@bench.command("speed")
def _speed(
    hand: Annotated[
        str, typer.Option(help="NAME or LEFT,RIGHT; `bidexdata hands` lists them.")
    ] = "capsule",
    device: Annotated[str, typer.Option(help="cpu, or cuda:0 where there is one.")] = "cpu",
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Time each stage in one process on three built-in objects at three sizes; a minute or two.

    --json keys: hand, device, config, protocol, objects, attempts, prepare_seconds (per object),
    attempts_per_second, attempts_with_a_grasp, microseconds_per_bimanual_step (five contacts a
    hand), verdicts_per_second (test f of paper-1 with its metrics), suc_f, seconds.
    """
    started = time.perf_counter()
    from bidexdata.runs.bench_stages import stage_speeds

    say = (lambda _: None) if quiet else (lambda text: warn(f"-- {text}"))
    found = stage_speeds(hand, device, say=say)
    rows = [
        ["prepare", f"{found['prepare_seconds']:.1f} s per object"],
        [
            "synth",
            f"attempts per second: {found['attempts_per_second']:.0f},"
            f" {100 * found['attempts_with_a_grasp']:.0f} % with a grasp",
        ],
        ["", _step_text(found["microseconds_per_bimanual_step"])],
        ["validate", _verdict_text(found)],
    ]
    finish(
        {**found, "seconds": round(time.perf_counter() - started, 3)},
        [
            f"one process, {counted(found['objects'], 'object')} x 3 sizes, hand {hand}, device {device};"
            " medians over objects",
            *table(rows),
        ],
        as_json=as_json,
        quiet=quiet,
    )


def _step_text(microseconds: float | None) -> str:
    if microseconds is None:
        return "no attempt had a start"
    return f"{microseconds:.1f} us per step of both hands, five contacts each"


def _verdict_text(found: Mapping[str, Any]) -> str:
    if found["verdicts_per_second"] is None:
        return "no attempt gave a grasp"
    rate, share = found["verdicts_per_second"], 100 * found["suc_f"]
    return f"{rate:.1f} verdicts/s of test f, {share:.0f} % passed"


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
    rig: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE|none",
            help="Arms that grasps on a table are made for (as synth --rig) and tested with; none: no arms.",
        ),
    ] = "ur10e_post",
    workers: options.Workers = 0,
    executor: options.ExecutorName = "processes",
    seed: options.Seed = 0,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Make the paper's tables again: comparison, ablation, region quality.

    Eleven rows; `--limit 1 --grasps 1` takes some minutes. Each row is a run DIR/ROW, made and tested as by synth and validate, which other commands take
    too. The same command goes on after a stop, and does nothing where nothing is missing. Writes
    DIR/tables.md and DIR/tables.json, with the paper's figures beside ours. docs/tables.md says
    what each row is and which of them are readings of the paper.

    --json keys: those of tables.json (version, library, hand, sizes_mm, grasps, seed, protocol,
    rig, rows, table_2, table_3, regions, paper; docs/tables.md), and files, seconds.
    """
    started = time.perf_counter()
    from bidexdata.errors import NothingSucceeded
    from bidexdata.runs.bench_tables import TablesRequest, make_tables

    execution = options.execution_of(executor, workers, None, quiet)
    asked = TablesRequest(
        hand=hand,
        sizes_mm=options.parse_sizes(sizes),
        grasps=grasps,
        limit=limit,
        seed=seed,
        rig="" if rig == "none" else rig,
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

    tests = ("suc_f", "suc_l", *(("suc_a",) if data["rig"] else ()))
    names = (f"{test.replace('_', '-').upper()}, unselected" for test in tests)
    rows = [["row", *(cell for name in names for cell in (name, "selected")), "differs by"]]
    for row in data["rows"].values():
        rates = [
            percent(row[kind].get(test)) for test in tests for kind in ("unselected", "selected")
        ]
        rows.append([row["title"], *rates, difference(row)])
    kinds = [["regions", "Q1 [1e-2]", "what"]]
    for name, kind in data["regions"]["kinds"].items():
        kinds.append([name, mean_text(kind["q1"], 2, 100.0), kind["says"]])
    return [*table(rows), *table(kinds)]


def _rates(row: dict[str, Any]) -> list[dict[str, Any]]:
    kinds = (row["unselected"], row["selected"])
    return [kind[key] for kind in kinds for key in ("suc_f", "suc_l") if key in kind]
