"""`bidexdata prepare`: meshes, built-in shapes, objects of other projects become an object library."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, counts_text, finish, free_name
from bidexdata.wording import counted


def prepare(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE...",
            help="Mesh files, folders, globs, list files (.txt, .csv), shapes[:FAMILY,...], "
            "dexgraspnet:PATH, bodex:PATH, objaverse:uids=FILE|lvis=CATEGORY|random=N,seed=K.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="LIBRARY", help="Folder of the library.")],
    limit: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Only the first N inputs, in the order of the sources; refused where the library has "
            "objects of the others.",
        ),
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="List the inputs and what the selection (--set select...) leaves out; write nothing.",
        ),
    ] = False,
    workers: options.Workers = 0,
    executor: options.ExecutorName = "processes",
    shard: options.Shard = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of the surface points: the key surface.seed.")
    ] = None,
    config: options.ConfigFile = None,
    assignments: options.Assignments = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Turn mesh files into an object library.

    dexgraspnet: and bodex: keep the convex pieces of these projects' objects; objaverse: downloads
    what is not in the cache of its package (docs/sources.md).

    Memory and time of every input are bounded (limits...) in worker processes, the default: the
    executors inline and ray set no such bounds, so give them files that you trust.

    The same command goes on after a stop. With --shard several machines prepare one folder: give
    each the same inputs and another part; the part that finishes last writes the index, and the
    library is the one that a single machine makes.

    --json keys: library, inputs, prepared, hulls, resumed, made (inputs that this call worked on),
    no_longer (objects that left the index), by_status, failures (source_name, status, reason),
    left_out (the same of duplicates and of what the selection leaves out; --dry-run does not look
    for near duplicates), warnings (source_name, warning), waiting (inputs of other parts that are not
    done), seconds, fingerprint. While some are waiting, the others count this part only.
    """
    from bidexdata.errors import NothingSucceeded
    from bidexdata.kinds import REPORT
    from bidexdata.objects.config import PrepareConfig
    from bidexdata.runs.prepare import prepare_library

    changes = [*(assignments or []), *([] if seed is None else [f"surface.seed={seed}"])]
    report = prepare_library(
        sources,
        out,
        options.configured(PrepareConfig(), config, changes),
        limit=limit,
        dry_run=dry_run,
        executor=executor,
        workers=workers,
        shard=options.parse_shard(shard),
        quiet=quiet,
    )
    data = report.as_dict()
    if dry_run:
        lines = [f"{r['source_name']}{r['reason'] and ': '}{r['reason']}" for r in report.rows]
        lines.append("near duplicates are not counted: they are found when the library is made")
        lines.append(
            f"{counted(len(report.rows), 'input')} ({counts_text(report.by_status)}); "
            "nothing was written"
        )
    else:
        lines = [f"{r['source_name']}: {r['reason']}" for r in data["failures"]]
        lines.append(
            f"{report.prepared} of {counted(len(report.rows), 'input')} prepared "
            f"({counts_text(report.by_status)}; {report.hulls} replaced by the hull) "
            f"in {report.seconds:.1f} s"
        )
        if report.no_longer:
            lines.append(
                f"{counted(len(report.no_longer), 'object')} of an earlier call left the index, as "
                "these sources do not name them: runs made from them need them. Name all sources "
                "in one call to have them back"
            )
        elif not report.made and not report.waiting:
            lines.append(f"nothing to do: every input was settled before; {out / REPORT} shows all")
        if (report.made or report.no_longer) and not report.waiting:
            lines.append(f"{out / REPORT} shows every input: open it in a browser")
        warned = {w["source_name"] for w in data["warnings"]}
        if warned:
            lines.append(
                f"{counted(len(warned), 'object')} with warnings, which `{command('info', out)}` "
                "lists: look at them before you go on"
            )
    if report.waiting:
        lines.append(
            f"part {shard}: {counted(report.waiting, 'input')} of other parts not done yet; "
            "the part that finishes last writes the index"
        )
    good = dry_run or report.prepared > 0 or report.waiting > 0
    finished = good and not dry_run and not report.waiting
    finish(
        data,
        lines,
        following=command("synth", out, "--out", free_name("RUN")) if finished else "",
        as_json=as_json,
        quiet=quiet,
    )
    if not good:
        raise NothingSucceeded(f"no input of {len(report.rows)} could be prepared; see the reasons")
