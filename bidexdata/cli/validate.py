"""`bidexdata validate`: test the grasps of a run, or of a release, by a named protocol."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bidexdata.cli import options
from bidexdata.cli.report import (
    command,
    counts_text,
    earlier_text,
    finish,
    free_name,
    refuse_nothing,
    warn,
    warn_of_failed,
)
from bidexdata.wording import counted

if TYPE_CHECKING:
    from bidexdata.runs.run import Run
    from bidexdata.runs.stage import TaskExecution
    from bidexdata.runs.validate import Extra
    from bidexdata.validation.protocols import Protocol


def validate(
    path: Annotated[Path, typer.Argument(metavar="RUN|RELEASE", help="What to test.")],
    protocol: Annotated[
        str, typer.Option(help="`bidexdata protocols` lists them; a YAML file of your own works.")
    ] = "paper-1",
    tests: Annotated[
        str,
        typer.Option(help="Of f, l and a, separated by commas; by default what the rows allow."),
    ] = "",
    rig: options.RigName = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="RUN2", help="For a release: the run that gets the new verdicts."),
    ] = None,
    load_margin: Annotated[
        bool,
        typer.Option("--load-margin", help="Measure the load margin too (10 to 20 times slower)."),
    ] = False,
    analytic: Annotated[
        bool, typer.Option("--analytic", help="Compute Q1 and the QP certificate too.")
    ] = False,
    plain: Annotated[
        bool,
        typer.Option(
            "--plain", help="Hold every load to its end, all by the engine (several times slower)."
        ),
    ] = False,
    replay: Annotated[
        str | None,
        typer.Option(
            metavar="GRASP_ID",
            help="Test one grasp of a run again and look on. The first digits of an id do.",
        ),
    ] = None,
    video: Annotated[
        Path | None, typer.Option(metavar="FILE.mp4", help="With --replay: film it.")
    ] = None,
    backend: Annotated[
        str,
        typer.Option(help="mujoco, or mujoco_warp for a GPU: other verdicts, under NAME-warp."),
    ] = "mujoco",
    device: Annotated[
        str | None,
        typer.Option(help="Of mujoco_warp: cuda:0 (the default), or cpu to try it out."),
    ] = None,
    workers: Annotated[
        int,
        typer.Option(
            min=0, help="Worker processes; 0 means one per core, with mujoco_warp one in all."
        ),
    ] = 0,
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
    Test a, the lift with arms, is for runs that `bidexdata arms` has found motions for.

    MuJoCo's C engine judges. --backend mujoco_warp is another engine, for many grasps at once on a
    GPU (the extra gpu): its verdicts are close to those and not equal, so they are stored under a
    name of their own, paper-1-warp, and never mixed with them.

    --json keys: run, protocol, rig (of test a; empty without), seconds and, per test in `tests`: tasks, tasks_before,
    tasks_failed, n, success, by_status, seconds. n, success and by_status count this call only.
    With --replay: grasp_id, protocol, test, success, status, failed_stage, direction,
    stored_status, seconds_simulated, frames, video.
    """
    from bidexdata.validation.backends import on_backend
    from bidexdata.validation.protocols import load_protocol

    rules = _renamed(load_protocol(protocol), config, assignments)
    named = options.parse_words(tests)
    if replay is not None:
        _require_watchable(
            {
                "--backend": backend != "mujoco",
                "--device": device is not None,
                "--out": out is not None,
                "--load-margin": load_margin,
                "--analytic": analytic,
                "--plain": plain,
                "--workers": workers != 0,
                "--executor": executor != "processes",
                "--shard": shard is not None,
            }
        )
        _replay(path, replay, rules, named, rig, video, as_json=as_json, quiet=quiet)
        return
    if video is not None:
        raise typer.BadParameter("--video films one grasp: name it with --replay GRASP_ID")
    execution = options.execution_of(executor, workers, shard, quiet)
    wanted: dict[Extra, bool] = {
        "load_margin": load_margin,
        "analytic": analytic,
        "plain": plain,
    }
    extras: list[Extra] = [name for name, asked in wanted.items() if asked]
    device = device or ("cuda:0" if backend == "mujoco_warp" else "cpu")
    rules = on_backend(rules, backend, device)  # before anything is written
    _validate(
        *(_run_of(path, out, rules, named, rig), rules, named, execution, extras, device),
        as_json=as_json,
        quiet=quiet,
    )


def _require_watchable(given: Mapping[str, bool]) -> None:
    """Refuse options that mean nothing for one grasp that is looked at."""
    from bidexdata.errors import NotUsable

    named = options.given_names(given)
    if named:
        raise NotUsable(
            "--replay looks on while MuJoCo's C engine tests one grasp and stores nothing: leave "
            f"out {named}"
        )


def _run_of(
    path: Path, out: Path | None, rules: Protocol, tests: Sequence[str], rig: str | None
) -> Run:
    """The run to test: the one at `path`, or one that holds the rows of a release.

    No rows are copied for tests that they do not allow.
    """
    from bidexdata.errors import NotUsable
    from bidexdata.kinds import expect_kind
    from bidexdata.runs.retest import planned_retest, start_retest
    from bidexdata.runs.run import Run
    from bidexdata.runs.validate import allowed_tests

    if expect_kind(path, "run", "release") == "release":
        if out is None:
            raise NotUsable(f"{path} is a release and never changed; name a run with --out RUN2")
        allowed_tests(planned_retest(path, out), rules, tests)
        run = start_retest(path, out)
        return run if rig is None else run.for_rig(rig)
    if out is not None:
        raise NotUsable(f"--out is for releases; the verdicts of {path} are stored in it")
    return Run.open(path, rig=rig)


def _validate(
    run: Run,
    rules: Protocol,
    tests: Sequence[str],
    execution: TaskExecution,
    extras: Sequence[Extra],
    device: str,
    *,
    as_json: bool,
    quiet: bool,
) -> None:
    from bidexdata.cli.figures import named_test
    from bidexdata.record.fields import WITH_ARMS
    from bidexdata.runs.chosen import DEFAULT_PROTOCOL, rig_option
    from bidexdata.runs.validate import validate_run
    from bidexdata.runs.weights import weight_difference

    note = weight_difference(run.spec, rules)
    if note:
        warn(note)
    reports = validate_run(
        *(run, rules, tests),
        execution=execution,
        extras=extras,
        backend=rules.backend,
        device=device,
    )
    data: dict[str, Any] = {
        "run": str(run.path),
        "protocol": rules.name,
        "rig": run.rig if set(reports) & set(WITH_ARMS) else "",
        "seconds": round(sum(r.seconds for r in reports.values()), 3),
        "tests": {},
    }
    lines = []
    for test, report in reports.items():
        named = named_test(test, rules.name, data["rig"])
        data["tests"][test] = {
            "tasks": report.tasks,
            "tasks_before": report.before,
            "tasks_failed": len(report.failures),
            "n": report.rows,
            "success": report.good,
            "by_status": report.by_status,
            "seconds": round(report.seconds, 3),
        }
        if report.before == report.tasks:
            tasks = counted(report.tasks, "task")
            lines.append(f"{named}: {tasks} done before, none open")
        else:
            lines.append(
                f"{named}: {report.good} of {counted(report.rows, 'row')} passed "
                f"({counts_text(report.by_status)}) in {report.seconds:.1f} s"
                f"{earlier_text(report.before)}"
            )
        warn_of_failed(report, run.path)
    arms = rig_option(run)
    following = command("info", run.path, *arms)
    good = sum(r.good for r in reports.values())
    # What is packed should have a success; the rows of a release have no library to be packed with.
    if not run.spec.of_release and (good or _passed_before(run, rules, reports)):
        named = () if rules.name == DEFAULT_PROTOCOL else ("--protocol", rules.name)
        following = command(
            *("pack", run.path, "--out", free_name("RELEASE")),
            *("--name", "NAME", "--version", "1.0.0"),
            *named,
            *arms,
        )
    finish(data, lines, following=following, as_json=as_json, quiet=quiet)
    if reports and all(len(r.failures) == r.tasks for r in reports.values()):
        sentence = f"{run.path}: every task failed; {run.path / 'logs'} says why"
    else:
        sentence = (
            f"{run.path}: not one grasp passed; `{command('info', run.path, *arms)}` says why"
        )
    refuse_nothing(
        good,
        (batch for test in reports for batch in run.batches(rules.name, test)),
        "success",
        sentence,
    )


def _passed_before(run: Run, rules: Protocol, tests: Iterable[str]) -> bool:
    return any(b["success"].any() for test in tests for b in run.batches(rules.name, test))


def _replay(
    path: Path,
    grasp_id: str,
    rules: Protocol,
    tests: Sequence[str],
    rig: str | None,
    video: Path | None,
    *,
    as_json: bool,
    quiet: bool,
) -> None:
    from bidexdata.cli.figures import named_test
    from bidexdata.kinds import expect_kind
    from bidexdata.pictures.captions import failure_place
    from bidexdata.record.fields import WITH_ARMS
    from bidexdata.record.status import sentence_at
    from bidexdata.runs.replay import replay_grasp
    from bidexdata.runs.run import Run
    from bidexdata.runs.validate import allowed_tests

    expect_kind(path, "run")
    run = Run.open(path, rig=rig)
    allowed = allowed_tests(run, rules, tests)
    # Arms are shown when they are asked for.
    test = [t for t in allowed if tests or t not in WITH_ARMS or len(allowed) == 1][-1]
    report = replay_grasp(run, grasp_id, rules, test, video, quiet=quiet)
    v = report.verdict
    failed = failure_place(v.failed_stage, v.direction, v.time)
    said = sentence_at(v.status, v.failed_stage)
    lines = [f"grasp {report.grasp_id}, {named_test(test, rules.name, run.rig)}: {said}{failed}"]
    if report.stored is not None:
        lines.append(f"the run says: {report.stored}")
    if report.video is not None:
        lines.append(f"{counted(report.frames, 'picture')} in {report.video}")
    finish(report.as_dict(), lines, as_json=as_json, quiet=quiet)


def _renamed(protocol: Protocol, config: Path | None, assignments: list[str] | None) -> Protocol:
    """Change settings of a protocol; refuse to do that under its own name, or a known one."""
    from bidexdata.errors import BadConfig
    from bidexdata.validation.protocols import require_own_name

    changed = options.configured(protocol, config, assignments)
    if changed != protocol and changed.name == protocol.name:
        raise BadConfig(
            f"--set and --config change protocol {protocol.name!r}, and other settings are another "
            "name: add --set name=NAME"
        )
    require_own_name(changed, "--set and --config: ")
    return changed
