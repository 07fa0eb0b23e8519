"""`bidexdata demo`: the whole pipeline on built-in objects and the built-in hand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.figures import figure_lines
from bidexdata.cli.report import command, finish, warn
from bidexdata.wording import counted


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for everything it makes.")],
    grasps: Annotated[int, typer.Option(min=1, help="Grasps kept per object and size.")] = 8,
    workers: options.Workers = 0,
    executor: options.ExecutorName = "processes",
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Run the whole pipeline on built-in objects.

    Prepare, synthesise, validate, pack and draw: no network, a few minutes on two cores.

    --json keys: library, run, release, contact_sheet, objects_prepared, seconds (per stage), and
    all figures of the card (n, suc_f, kept, by_size, by_status, tests ...).
    """
    from bidexdata.errors import NothingSucceeded
    from bidexdata.runs.demo import PROTOCOL, run_demo

    execution = options.execution_of(executor, workers, None, quiet)
    say = (lambda _: None) if quiet else (lambda text: warn(f"-- {text}"))
    report = run_demo(out, execution=execution, grasps=grasps, say=say)
    places = {
        "library": out / "library",
        "run": out / "run",
        "release": out / "release",
        "contact_sheet": report.sheet,
    }
    data = {
        **{name: str(place) for name, place in places.items()},
        "objects_prepared": report.objects,
        "seconds": report.seconds,
        **report.figures,
    }
    verdicts = report.figures["tests"]["f"]["by_verdict"]
    passed, validated = verdicts.get("ok", 0), sum(verdicts.values()) - verdicts.get("not_run", 0)
    lines = [
        f"{counted(report.figures['n'], 'row')} synthesised, {validated} validated, {passed} passed",
        *figure_lines(report.figures, PROTOCOL),
        "took " + ", ".join(f"{name} {s:.0f} s" for name, s in report.seconds.items()),
        f"pictures: open {report.sheet}",
        f"in the browser: {command('view', places['release'])}",
        f"as tensors: BiDexDataset({str(places['release'])!r})",
    ]
    finish(data, lines, following=command("view", places["release"]), as_json=as_json, quiet=quiet)
    if not passed:
        raise NothingSucceeded(f"{out}: not one grasp passed")
