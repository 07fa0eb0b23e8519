"""`bidexdata arms`: lead two arms to the grasps of a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bidexdata.cli import options
from bidexdata.cli.report import (
    command,
    counts_text,
    earlier_text,
    finish,
    table,
    warn_of_failed,
)
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.runs.run import Run
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
    those), by_status (of all rows), by_size (by_status per size_mm), seconds,
    milliseconds_per_grasp (of CPU). They count this call only.
    """
    from bidexdata.kinds import expect_kind
    from bidexdata.runs.arm_folder import rig_name
    from bidexdata.runs.arms import arms_run
    from bidexdata.runs.rigged import arm_config_of, rig_meant
    from bidexdata.runs.run import Run

    expect_kind(path, "run")
    run = Run.open(path)
    settings = options.configured(arm_config_of(run, rig), config, assignments)
    execution = options.execution_of(executor, workers, shard, quiet)
    report = arms_run(run, rig, settings, execution=execution, device=device)
    name = rig_name(rig or rig_meant(run))
    data = {"run": str(path), "rig": name, **_figures(report)}
    warn_of_failed(report, path)
    others = len(run.arm_rigs()) > 1
    following = command("validate", path, "--tests", "l,a", *(("--rig", name) if others else ()))
    finish(data, _lines(data, report), following=following, as_json=as_json, quiet=quiet)
    _refuse_unreachable(run.for_rig(name), report)


def _figures(report: StageReport) -> dict[str, Any]:
    asked = report.rows - report.by_status.get("no_grasp", 0)
    return {
        "tasks": report.tasks,
        "tasks_before": report.before,
        "tasks_failed": len(report.failures),
        "n": asked,
        "reachable": report.good,
        "by_status": report.by_status,
        "by_size": {str(mm): counts for mm, counts in report.by_size.items()},
        "seconds": round(report.seconds, 3),
        "milliseconds_per_grasp": round(1e3 * report.cpu_seconds / asked, 3) if asked else None,
    }


def _lines(data: dict[str, Any], report: StageReport) -> list[str]:
    from bidexdata.formats.figures import size_text
    from bidexdata.record.rates import rate_interval

    if report.before == report.tasks:
        return [f"arms of {data['rig']}: {counted(report.tasks, 'task')} done before, none open"]
    lost = {label: n for label, n in data["by_status"].items() if label != "ok"}
    cost = data["milliseconds_per_grasp"]
    lines = [
        f"arms of {data['rig']}: {data['reachable']} of {counted(data['n'], 'grasp')} have a motion "
        f"(not: {counts_text(lost)}) in {report.seconds:.1f} s"
        f"{'' if cost is None else f', {cost:.1f} ms of CPU each'}{earlier_text(report.before)}"
    ]
    rows = [["size", "have a motion", "reasons of the others"]]
    for size, counts in data["by_size"].items():
        given = {label: n for label, n in counts.items() if label != "no_grasp"}
        reasons = {label: n for label, n in given.items() if label != "ok"}
        rate = str(rate_interval(given.get("ok", 0), sum(given.values())))
        rows.append([size_text(size), rate, counts_text(reasons)])
    return lines + table(rows)


def _refuse_unreachable(run: Run, report: StageReport) -> None:
    """End the command with exit code 6 unless the arms can take some grasp, now or before."""
    from bidexdata.errors import NothingSucceeded
    from bidexdata.record import Status

    if report.good:
        return
    armed = run.armed()
    solved = (run.task_arms(t, run.task_batch(t)) for t in run.tasks if t.task_id in armed)
    if not any((batch["arm_status"] == Status.OK).any() for batch in solved):
        raise NothingSucceeded(
            f"{run.path}: the arms of {run.rig} can take not one grasp; `bidexdata rigs check "
            f"{run.rig}` says where they reach"
        )
