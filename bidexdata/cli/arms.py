"""`bidexdata arms`: lead two arms to the grasps of a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bidexdata.cli import options
from bidexdata.cli.arm_figures import arm_table
from bidexdata.cli.report import (
    command,
    counts_text,
    finish,
    warn_of_failed,
)
from bidexdata.errors import NothingSucceeded
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.runs.arm_counts import ArmCounts
    from bidexdata.runs.stage import StageReport


def arms(
    path: Annotated[Path, typer.Argument(metavar="RUN", help="A run of tabletop grasps.")],
    rig: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="`bidexdata rigs` lists them; a YAML file of your own works. When left out, that of "
            "`synth --rig`, or else ur10e_post.",
        ),
    ] = None,
    device: Annotated[str, typer.Option(help="Warp device: cpu or cuda:0.")] = "cpu",
    workers: options.Workers = 0,
    executor: options.ExecutorName = "processes",
    shard: options.Shard = None,
    config: options.ConfigFile = None,
    assignments: options.Assignments = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Give every grasp of a run a motion of two arms, or the reason why there is none.

    Home, stand-off, pre-grasp, grasp, squeeze, 0.10 m up: inverse kinematics, clearance of table,
    object, the other arm and the arm itself, a smooth path with times. Solutions lie beside those of
    other rigs, and the grasps are not touched. Grasps that have one are left alone, so the same
    command goes on after a stop. `bidexdata rigs check` says whether a rig of your own works.

    --json keys: run, rig, tasks, tasks_before, tasks_failed, n (rows with a grasp), reachable (of
    those), by_status (of all rows), by_size (by_status per size_mm), now (n, reachable, by_status and
    by_size of this call), seconds, milliseconds_per_grasp (of CPU, of this call). What stands outside of
    now counts all tasks of the run that are solved, by this call or before.
    """
    from bidexdata.kinds import expect_kind
    from bidexdata.runs.arm_counts import ArmCounts
    from bidexdata.runs.arm_folder import rig_name
    from bidexdata.runs.arms import arms_run
    from bidexdata.runs.chosen import rig_option
    from bidexdata.runs.rigged import arm_config_of, rig_meant
    from bidexdata.runs.run import Run

    expect_kind(path, "run")
    run = Run.open(path)
    given = str(rig or rig_meant(run))
    settings = options.configured(arm_config_of(run, rig), config, assignments)
    execution = options.execution_of(executor, workers, shard, quiet)
    report = arms_run(run, rig, settings, execution=execution, device=device)
    run = run.for_rig(rig_name(given))
    counts = ArmCounts.of_run(run, run.armed())
    data = {"run": str(path), "rig": run.rig, **_figures(report, counts)}
    warn_of_failed(report, path)
    following = command("validate", path, "--tests", "l,a", *rig_option(run))
    finish(
        data,
        _lines(data, report),
        following=following if data["reachable"] else "",
        as_json=as_json,
        quiet=quiet,
    )
    if not data["reachable"]:
        raise NothingSucceeded(_nothing_words(path, run.rig, given, report))


def _figures(report: StageReport, counts: ArmCounts) -> dict[str, Any]:
    from bidexdata.runs.arm_counts import shares

    by_size = {str(mm): found for mm, found in report.by_size.items()}
    now = {**shares(report.by_status), "by_size": by_size}
    cost = 1e3 * report.cpu_seconds / now["n"] if now["n"] else None
    return {
        "tasks": report.tasks,
        "tasks_before": report.before,
        "tasks_failed": len(report.failures),
        **counts.figures(),
        "now": now,
        "seconds": round(report.seconds, 3),
        "milliseconds_per_grasp": None if cost is None else round(cost, 3),
    }


def _lines(data: dict[str, Any], report: StageReport) -> list[str]:
    lost = {label: n for label, n in data["by_status"].items() if label not in ("ok", "no_grasp")}
    none = data["by_status"].get("no_grasp", 0)
    lines = [
        f"arms of {data['rig']}: {data['reachable']} of {counted(data['n'], 'grasp')} have a motion "
        f"(not: {counts_text(lost)}){_attempts_text(none)}",
        _now_text(data, report),
    ]
    return lines + arm_table({"of all rows": data["by_size"]})


def _attempts_text(none: int) -> str:
    return (
        f"; {counted(none, 'stored attempt has', 'stored attempts have')} no grasp" if none else ""
    )


def _now_text(data: dict[str, Any], report: StageReport) -> str:
    """What of it this call did, and what it cost."""
    if not report.finished:
        open_tasks = "none open" if report.before == report.tasks else "none done now"
        return f"{counted(report.before, 'task')} done before, {open_tasks}"
    now, cost = data["now"], data["milliseconds_per_grasp"]
    earlier = f", {counted(report.before, 'task')} done before" if report.before else ""
    return (
        f"now: {now['reachable']} of {counted(now['n'], 'grasp')} in "
        f"{counted(report.finished, 'task')}{earlier}, {report.seconds:.1f} s"
        f"{'' if cost is None else f', {cost:.1f} ms of CPU each'}"
    )


def _nothing_words(path: Path, rig: str, given: str, report: StageReport) -> str:
    if report.tasks and len(report.failures) == report.tasks:
        return f"{path}: every task failed; {path / 'logs'} says why"
    return (
        f"{path}: the arms of {rig} can take not one grasp; `{command('rigs', 'check', given)}` says "
        "where they reach"
    )
