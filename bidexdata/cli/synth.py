"""`bidexdata synth`: grasps for every object of a library."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from bidexdata.cli import options
from bidexdata.cli.explain import explain as _explain
from bidexdata.cli.explain import refuse_settings
from bidexdata.cli.figures import attempt_lines
from bidexdata.cli.report import (
    command,
    counts_text,
    earlier_text,
    finish,
    no_grasp_text,
    no_scene_text,
    validate_again,
    warn_of_failed,
)
from bidexdata.synthesis.method_names import DEFAULT_METHOD
from bidexdata.wording import counted

_OPTIONS = (
    *("--hand", "--sizes", "--grasps", "--candidates", "--setting", "--rest-poses"),
    *("--preset", "--method", "--rig", "--device", "--seed"),
)
"""What a person may look for among the keys of the configuration."""


def synth(
    library: Annotated[Path, typer.Argument(metavar="LIBRARY", help="Made by prepare.")],
    out: Annotated[
        Path, typer.Option(metavar="RUN", help="Folder of the run; resumed if it is there.")
    ],
    hand: Annotated[
        str,
        typer.Option(help="NAME or LEFT,RIGHT; `bidexdata hands` lists them; a spec file works."),
    ] = "shadow",
    sizes: Annotated[
        str | None,
        typer.Option(
            help="Bounding-box diagonals in metres, separated by commas; by default the paper's "
            "eleven, 0.3 to 0.8 in steps of 0.05. They stay as they are on a run."
        ),
    ] = None,
    grasps: Annotated[
        int | None, typer.Option(min=1, help="Grasps kept per scene (10); may grow on a run.")
    ] = None,
    candidates: Annotated[
        int | None, typer.Option(min=1, help="Attempts per scene (4 per grasp kept).")
    ] = None,
    setting: Annotated[
        str, typer.Option(help="floating, or tabletop: the object rests on the plane z = 0.")
    ] = "floating",
    rest_poses: Annotated[
        int | None,
        typer.Option(min=1, help="tabletop: rest poses of each object, most probable first (1)."),
    ] = None,
    preset: Annotated[str, typer.Option(help="`bidexdata presets` lists them.")] = "default",
    method: Annotated[
        str,
        typer.Option(
            help="bidexgrasp, or a peer's to compare with: bodex, bimangrasp (floating only). "
            "`bidexdata presets METHOD` lists a peer's keys; --explain knows none of them."
        ),
    ] = DEFAULT_METHOD,
    rig: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="tabletop: make grasps that these two arms can take; `bidexdata rigs` lists them, a YAML "
            "file of your own works.",
        ),
    ] = None,
    device: Annotated[str, typer.Option(help="cpu, or cuda:0 where there is one.")] = "cpu",
    explain: Annotated[
        str | None,
        typer.Option(
            metavar="GRASP_ID",
            help="Make one grasp of RUN again and write pictures of its stages to "
            "RUN/explain/GRASP_ID; the run's own settings decide. The first digits of an id do.",
        ),
    ] = None,
    workers: options.Workers = 0,
    executor: options.ExecutorName = "processes",
    shard: options.Shard = None,
    seed: options.Seed = 0,
    config: options.ConfigFile = None,
    assignments: options.Assignments = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Synthesise two-handed grasps.

    The same command goes on after a stop. On a table an object without a rest pose gives no scene.
    With --rig, starts that the arms cannot take are drawn anew, and grasps without a motion of the
    arms are not kept; `bidexdata arms RUN` then makes the motions.

    --json keys: run, fingerprint, rig (empty: none), tasks, tasks_before, tasks_failed, without_scene (objects),
    without_grasp (scenes that no grasp was kept of), n, selected, by_status, by_stage
    (attempts by where they ended: regions, placement, reach with a rig, optimisation, checks, ok), by_size (per
    size_mm: by_status, by_stage), seconds. tasks_failed and what follows without_scene are of this
    call only; `info` gives the whole run. seconds is the time that the whole command took, with the loading of packages and hands and
    the start of the workers.

    With --explain: grasp_id, scene_id, attempt, status, reasons (every check it fails), stored,
    repeats, differing (columns), selected, audit, rank (in the order of selection), may_be_kept
    (attempts in that order), stages (stage, text, passed), verdicts of the
    run (protocol, test, status, failed_stage, direction, text), files, seconds. docs/explain.md says what
    the pictures and numbers mean.
    """
    if explain is not None:
        refuse_settings(
            {
                "--hand": hand != "shadow",
                "--sizes": sizes is not None,
                "--grasps": grasps is not None,
                "--candidates": candidates is not None,
                "--setting": setting != "floating",
                "--rest-poses": rest_poses is not None,
                "--preset": preset != "default",
                "--method": method != DEFAULT_METHOD,
                "--rig": rig is not None,
                "--shard": shard is not None,
                "--seed": seed != 0,
                "--config": config is not None,
                "--set": bool(assignments),
            }
        )
        _explain(library, out, explain, device, as_json=as_json, quiet=quiet)
        return
    started = time.perf_counter()
    from bidexdata.errors import NothingSucceeded
    from bidexdata.formats.attempts import sized_attempts
    from bidexdata.record.scene import setting_of
    from bidexdata.record.status import by_synth_stage
    from bidexdata.runs.run import Run
    from bidexdata.runs.synth import PAPER_SIZES_MM, SynthRequest, synth_library
    from bidexdata.runs.weights import fitting_protocol
    from bidexdata.synthesis.methods import load_method
    from bidexdata.synthesis.presets import load_preset

    base = load_preset(preset) if method == DEFAULT_METHOD else load_method(method).config()
    sizes_mm = PAPER_SIZES_MM if sizes is None else options.parse_sizes(sizes)
    execution = options.execution_of(executor, workers, shard, quiet)
    request = SynthRequest(
        config=options.configured(base, config, assignments, own=_OPTIONS),
        method=method,
        preset=preset,
        hand=hand,
        sizes_mm=sizes_mm,
        setting=setting_of(setting),
        rest_poses=rest_poses,
        grasps=grasps,
        candidates=candidates,
        seed=seed,
        rig=rig or "",
    )
    report = synth_library(library, out, request, execution=execution, device=device)
    run = Run.open(out)
    seconds = time.perf_counter() - started
    sized = sized_attempts(report.by_size)
    data: dict[str, Any] = {
        "run": str(out),
        "fingerprint": run.fingerprint,
        "rig": run.spec.rig.name if run.spec.rig else "",
        "tasks": report.tasks,
        "tasks_before": report.before,
        "tasks_failed": len(report.failures),
        "without_scene": list(run.spec.without_scene),
        "without_grasp": list(report.without_grasp),
        "n": report.rows,
        "selected": report.good,
        "by_status": report.by_status,
        "by_stage": by_synth_stage(report.by_status),
        "by_size": sized,
        "seconds": round(seconds, 3),
    }
    warn_of_failed(report, out)
    left_out = run.spec.without_scene
    following = validate_again(out, fitting_protocol(run.spec))
    if run.spec.rig is not None:
        following = command("arms", out)
    done = report.before + report.finished
    some = bool(report.good) or any(batch["selected"].any() for batch in run.batches())
    if report.before == report.tasks:
        made = [f"{counted(report.tasks, 'task')} done before, none open"]
    else:
        made = [
            f"{counted(report.good, 'row')} selected, {counted(report.rows, 'row')} stored "
            f"by {counted(report.finished, 'task')} in {seconds:.1f} s "
            f"({done} of {counted(report.tasks, 'task')} done){earlier_text(report.before)}",
            f"attempts: {counts_text(report.by_status)}",
            *attempt_lines(sized),
        ]
    finish(
        data,
        [
            *made,
            *([no_scene_text(left_out)] if left_out else []),
            *([no_grasp_text(report.without_grasp)] if report.without_grasp else []),
        ],
        following=following if some else "",
        as_json=as_json,
        quiet=quiet,
    )
    # This machine's part of the plan may be empty.
    if not some and (report.tasks or not run.tasks):
        raise NothingSucceeded(f"{out}: not one grasp was made; `{command('info', out)}` says why")
