"""`bidexdata validate`: test the grasps of a run, or of a release, by a named protocol."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, counts_text, finish, warn

if TYPE_CHECKING:
    from bidexdata.validation.protocols import Protocol


def validate(
    path: Annotated[Path, typer.Argument(metavar="RUN|RELEASE", help="What to test.")],
    protocol: Annotated[
        str, typer.Option(help="`bidexdata protocols` lists them; a YAML file of your own works.")
    ] = "paper-1",
    tests: Annotated[
        str, typer.Option(help="f, l, a separated by commas; by default what the rows allow.")
    ] = "",
    out: Annotated[
        Path | None,
        typer.Option(metavar="RUN2", help="For a release: the run that gets the new verdicts."),
    ] = None,
    load_margin: Annotated[
        bool,
        typer.Option("--load-margin", help="Measure the load margin too (about ten times slower)."),
    ] = False,
    analytic: Annotated[
        bool, typer.Option("--analytic", help="Compute Q1 and the QP certificate too.")
    ] = False,
    replay: Annotated[
        str | None,
        typer.Option(metavar="GRASP_ID", help="Test one grasp of a run again and look on."),
    ] = None,
    video: Annotated[
        Path | None, typer.Option(metavar="FILE.mp4", help="With --replay: film it.")
    ] = None,
    workers: options.Workers = 0,
    executor: options.ExecutorName = "processes",
    shard: options.Shard = None,
    config: options.ConfigFile = None,
    assignments: options.Assignments = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Test grasps in simulation by a named protocol.

    Grasps that have a verdict are left alone, so the same command goes on after a stop. --config
    and --set change settings of the protocol, which then needs a name of its own (--set name=NAME).

    --json keys: run, protocol, seconds and, per test in `tests`: tasks, tasks_before,
    tasks_failed, n, success, by_status, seconds. n, success and by_status count this call only.
    """
    from bidexdata.errors import NothingSucceeded, NotUsable
    from bidexdata.runs.retest import start_retest
    from bidexdata.runs.run import Run
    from bidexdata.runs.validate import Extra, validate_run
    from bidexdata.validation.protocols import load_protocol

    rules = _renamed(load_protocol(protocol), config, assignments)
    execution = options.execution_of(executor, workers, shard, quiet)
    if (path / "manifest.json").exists():
        if out is None:
            raise NotUsable(f"{path} is a release and never changed; name a run with --out RUN2")
        run = start_retest(path, out)
    else:
        if out is not None:
            raise NotUsable(f"--out is for releases; the verdicts of {path} are stored in it")
        run = Run.open(path)
    wanted: dict[Extra, bool] = {"load_margin": load_margin, "analytic": analytic}
    extras: list[Extra] = [name for name, asked in wanted.items() if asked]
    reports = validate_run(
        run, rules, options.parse_words(tests), execution=execution, extras=extras
    )
    data: dict[str, Any] = {
        "run": str(run.path),
        "protocol": rules.name,
        "seconds": round(sum(r.seconds for r in reports.values()), 3),
        "tests": {},
    }
    lines = []
    for test, report in reports.items():
        data["tests"][test] = {
            "tasks": report.tasks,
            "tasks_before": report.before,
            "tasks_failed": len(report.failures),
            "n": report.rows,
            "success": report.good,
            "by_status": report.by_status,
            "seconds": round(report.seconds, 3),
        }
        lines.append(
            f"test {test}: {report.good} of {report.rows} rows pass "
            f"({counts_text(report.by_status)}) in {report.seconds:.1f} s"
        )
        if report.failures:
            warn(
                f"{len(report.failures)} of {report.tasks} tasks failed (first: "
                f"{report.failures[0].reason}); the same command tries them again"
            )
    following = command("info", run.path)
    if run.spec.kind == "synth":
        following = command(
            *("pack", run.path, "--out", "RELEASE", "--name", "NAME", "--version", "1.0.0")
        )
    finish(data, lines, following=following, as_json=as_json, quiet=quiet)
    # Rows of earlier calls count too: the exit code must not depend on how often one asks.
    if not any(r.good for r in reports.values()) and not any(
        batch.success.any() for test in reports for batch in run.batches(rules.name, test)
    ):
        raise NothingSucceeded(f"{run.path}: not one grasp passed; `bidexdata info` says why")


def _renamed(
    protocol: Protocol, config: Path | None, assignments: list[str] | None
) -> Protocol:
    """Change settings of a protocol; refuse to do that under its own name."""
    from bidexdata.errors import BadConfig

    changed = options.configured(protocol, config, assignments)
    if changed != protocol and changed.name == protocol.name:
        raise BadConfig(
            f"--set and --config change protocol {protocol.name!r}, and other settings are another "
            "name: add --set name=NAME"
        )
    return changed
