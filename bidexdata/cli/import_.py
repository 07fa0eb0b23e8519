"""`bidexdata import`: grasps of another project become a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from bidexdata.cli import options
from bidexdata.cli.report import command, counts_text, finish, warn_of_failed
from bidexdata.wording import counted

_SHOWN = 10
"""Failed files that are printed; all are in the run's files.parquet and in --json."""


def import_(
    format_: Annotated[
        str,
        typer.Argument(
            metavar="FORMAT",
            help="dexgraspbench, bodex, dexgraspnet, bimangrasp or bimandexgraspbench.",
        ),
    ],
    path: Annotated[Path, typer.Argument(metavar="PATH", help="The other project's folder.")],
    out: Annotated[Path, typer.Option(metavar="RUN", help="Folder of the run.")],
    hand: Annotated[
        str, typer.Option(help="The hand that the grasps are of; `hands` lists them.")
    ] = "shadow",
    setting: Annotated[
        str, typer.Option(help="What the scenes are: floating or tabletop.")
    ] = "floating",
    objects: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of the objects, where they are not at their own paths."
        ),
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Only the first N files in byte order of the path.")
    ] = None,
    workers: options.Workers = 0,
    executor: options.ExecutorName = "processes",
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Import grasps of another project, with their objects, as a run.

    A file that cannot be used is counted with its reason; files.parquet in the run lists all. The
    same command goes on after a stop. What the files do not say is listed. A grasp that the hand
    cannot take becomes a row without a pose, status joint_range.

    --json keys: run, fingerprint, files, files_failed, n, by_status, left_out, objects,
    objects_failed, tasks, tasks_before, tasks_failed, failures (file, reason), unknown (phrases),
    seconds.
    """
    from bidexdata.errors import NothingSucceeded
    from bidexdata.formats.importers import load_format
    from bidexdata.record import Status
    from bidexdata.record.scene import setting_of
    from bidexdata.runs.import_ import ImportRequest, import_run

    request = ImportRequest(
        format=format_,
        path=path,
        hand=hand,
        setting=setting_of(setting),
        objects=objects,
        limit=limit,
    )
    form = load_format(format_)
    execution = options.execution_of(executor, workers, None, quiet)
    report = import_run(request, out, execution=execution)
    failed, stage = report.failed, report.stage
    made = sum(r["status"] == Status.OK for r in report.objects)
    done = stage.before + stage.finished
    data: dict[str, Any] = {
        "run": str(out),
        "fingerprint": report.fingerprint,
        "files": len(report.files),
        "files_failed": len(failed),
        "n": report.rows,
        "by_status": dict(report.by_status),
        "left_out": report.left_out,
        "objects": made,
        "objects_failed": len(report.objects) - made,
        "tasks": stage.tasks,
        "tasks_before": stage.before,
        "tasks_failed": len(stage.failures),
        "failures": [{"file": f.file, "reason": f.reason} for f in report.files if f.reason],
        "unknown": list(report.unknown),
        "seconds": round(report.seconds, 3),
    }
    warn_of_failed(stage, out)
    told = [f for f in report.files if f.reason]
    lines = [f"{f.file}: {f.reason}" for f in told[:_SHOWN]]
    if len(told) > _SHOWN:
        more = counted(len(told) - _SHOWN, "more file")
        # Without a grasp there is no run, and no file in it.
        listed = f" and {out}/files.parquet" if report.fingerprint else ""
        lines.append(f"... and {more}: --json{listed}")
    statuses = counts_text({"read": len(report.files) - len(failed), "failed": len(failed)})
    lines.append(
        f"{counted(report.rows, 'grasp')} of {counted(made, 'object')} "
        f"from {counted(len(report.files), 'file')} ({statuses}) in "
        f"{report.seconds:.1f} s"
    )
    odd = {k: n for k, n in report.by_status.items() if k != Status.OK.label}
    if odd:
        lines.append(f"without a pose: {counts_text(odd)} ({Status.JOINT_RANGE.sentence})")
    if done:
        lines += [f"not known: {phrase}" for phrase in report.unknown]
    finish(
        data,
        lines,
        following=command("validate", out, "--protocol", form.protocol) if done else "",
        as_json=as_json,
        quiet=quiet,
    )
    if not done:
        raise NothingSucceeded(
            f"not one grasp of {path} could be imported; see the reasons; expected {form.expected}"
        )
