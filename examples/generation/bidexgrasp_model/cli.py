"""The command `bidexgrasp-model`: train, sample, evaluate, ablate."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

os.environ.setdefault("TYPER_USE_RICH", "0")

import typer

app = typer.Typer(
    name="bidexgrasp-model",
    help="Train, sample and judge a grasp generation model on a release of bidexdata.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
OVERFIT = ("train.rate=0.001", "train.repeats=8", "loss.geometric_every=8")
"""Settings of `train --overfit`: few clouds, many noise levels of each grasp. Ours."""
Out = Annotated[Path, typer.Option(help="Folder of what is made.")]
Set = Annotated[list[str] | None, typer.Option("--set", help="Setting as GROUP.KEY=VALUE.")]
Preset = Annotated[str, typer.Option(help="paper or cpu.")]
Device = Annotated[str, typer.Option(help="cpu or cuda.")]
Threads = Annotated[int, typer.Option(help="Threads of torch; 0 leaves them as they are.")]
Minutes = Annotated[float | None, typer.Option(help="Length of training by the clock.")]
Steps = Annotated[int | None, typer.Option(help="Length of training in steps.")]
Seed = Annotated[int, typer.Option(help="Seed of every draw.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show no progress.")]
ReleaseArg = Annotated[Path, typer.Argument(help="Release folder.")]


@app.command()
def train(
    release: ReleaseArg,
    out: Out,
    preset: Preset = "cpu",
    settings: Set = None,
    steps: Steps = None,
    minutes: Minutes = None,
    overfit: Annotated[int | None, typer.Option(help="Learn so many cases by heart.")] = None,
    where: Annotated[str | None, typer.Option(help="Which grasps, such as suc_l.")] = None,
    seed: Seed = 0,
    device: Device = "cpu",
    threads: Threads = 0,
    quiet: Quiet = False,
) -> None:
    """Train a model, or go on where training stopped."""
    from bidexgrasp_model.ranks import Ranks
    from bidexgrasp_model.training import Trainer, TrainRequest

    _use_threads(threads)
    ranks = Ranks.from_environment(device)
    if overfit is not None:
        settings = [*OVERFIT, *(settings or [])]
    request = TrainRequest(
        release=release,
        out=out,
        config=_config(preset, settings),
        seed=seed,
        where=where,
        device=device,
        steps=steps,
        minutes=minutes,
        overfit=overfit,
        quiet=quiet or not ranks.first,
    )
    made = Trainer.start(request, ranks).run()
    ranks.close()
    if ranks.first:
        typer.echo(
            f"{out}: {made.step} steps in {made.seconds / 60:.1f} min, {len(made.weights)} tensors"
        )
        typer.echo(f"next: bidexgrasp-model sample MESH --checkpoint {out} --out RUN")


@app.command()
def sample(
    source: Annotated[Path, typer.Argument(help="A mesh, or a cloud (.npy, .txt, .xyz, .csv).")],
    checkpoint: Annotated[Path, typer.Option(help="Folder that `train` wrote.")],
    out: Out,
    sizes: Annotated[str, typer.Option(help="Diagonals that a mesh is scaled to [m].")] = "0.5",
    grasps: Annotated[int, typer.Option(min=1, help="Grasps of each scene.")] = 64,
    rest_poses: Annotated[int, typer.Option(min=1, help="Rest poses on the table.")] = 1,
    single_view: Annotated[
        bool, typer.Option("--single-view", help="See it from one side.")
    ] = False,
    refine: Annotated[
        int | None, typer.Option(min=0, help="Steps that fit grasps to the surface.")
    ] = None,
    draws: Annotated[
        int | None, typer.Option(min=1, help="Samples per grasp, of which the best is kept.")
    ] = None,
    seed: Seed = 0,
    device: Device = "cpu",
    threads: Threads = 0,
    quiet: Quiet = False,
) -> None:
    """Make grasps of an unseen object: a run for validate, view, render and pack."""
    from bidexgrasp_model.unseen import SampleRequest, sample_unseen

    _use_threads(threads)
    if not source.is_file():
        raise ValueError(f"{source}: no such file; give a mesh or a cloud")
    run = sample_unseen(
        SampleRequest(
            source=source,
            checkpoint=checkpoint,
            out=out,
            sizes_mm=_sizes(sizes),
            rest_poses=rest_poses,
            grasps=grasps,
            seed=seed,
            single_view=single_view,
            refine=refine,
            draws=draws,
            device=device,
            quiet=quiet,
        )
    )
    typer.echo(f"{sum(len(b) for b in run.batches())} grasps of {run.object_ids[0]} in {out}")
    typer.echo(f"next: bidexdata validate {out}, or bidexdata view {out}")


@app.command()
def sample_train(
    release: ReleaseArg,
    checkpoint: Annotated[Path, typer.Option(help="Folder of the model.")],
    out: Out,
    overfit: Annotated[int, typer.Option(min=1, help="Cases that were learned by heart.")] = 8,
    samples: Annotated[int, typer.Option(min=1, help="Grasps of each.")] = 8,
    seed: Seed = 0,
    threads: Threads = 1,
) -> None:
    """Make grasps of the cases that `train --overfit N` learned by heart."""
    from bidexgrasp_model.systems import FULL, System, Task, make_run
    from bidexgrasp_model.training import overfit_places

    _use_threads(threads)
    places = overfit_places(release, checkpoint, overfit)
    task = Task(release=release, places=tuple(places), samples=samples, seed=seed)
    run = make_run(System(FULL, "model", checkpoint), task, out)
    typer.echo(f"{len(places) * samples} grasps of {len(places)} learned cases in {run.path}")
    typer.echo(f"next: bidexdata validate {out} --tests l")


@app.command()
def evaluate(
    release: ReleaseArg,
    out: Out,
    checkpoint: Annotated[Path, typer.Option(help="Folder of the model.")],
    plain: Annotated[Path | None, typer.Option(help="Folder of a plain DDPM.")] = None,
    samples: Annotated[int, typer.Option(min=1, help="Grasps of each scene.")] = 3,
    objects: Annotated[int | None, typer.Option(min=1, help="Only so many test objects.")] = None,
    tests: Annotated[str, typer.Option(help="Tests, such as l,f.")] = "l,f",
    seed: Seed = 0,
    workers: Annotated[int, typer.Option(help="Of the simulation; 0: one per core.")] = 0,
    single_view: Annotated[bool, typer.Option("--single-view", help="From one side.")] = False,
    threads: Threads = 1,
    as_json: Annotated[bool, typer.Option("--json", help="One object on standard output.")] = False,
    quiet: Quiet = False,
) -> None:
    """Judge a model and its baselines on the test objects."""
    from bidexgrasp_model import systems
    from bidexgrasp_model.checkpoint import Checkpoint
    from bidexgrasp_model.evaluation import EvalRequest
    from bidexgrasp_model.evaluation import evaluate as judge

    _use_threads(threads)
    chosen = [systems.System(systems.FULL, "model", checkpoint)]
    if plain is not None:
        chosen.append(systems.System(systems.DDPM, "model", plain))
    chosen += systems.beside(checkpoint, Checkpoint.load(checkpoint).config, chosen)
    request = EvalRequest(
        release=release,
        out=out,
        systems=tuple(chosen),
        reference=systems.FULL,
        samples=samples,
        objects=objects,
        tests=tuple(tests.split(",")),
        seed=seed,
        workers=workers,
        single_view=single_view,
        quiet=quiet or as_json,
    )
    found = judge(request, _say(quiet or as_json))
    _show(found, out, as_json=as_json)


@app.command()
def ablate(
    release: ReleaseArg,
    out: Out,
    preset: Preset = "cpu",
    settings: Set = None,
    minutes: Minutes = None,
    steps: Steps = None,
    samples: Annotated[int, typer.Option(min=1, help="Grasps of each scene.")] = 3,
    objects: Annotated[int | None, typer.Option(min=1, help="Only so many test objects.")] = None,
    tests: Annotated[str, typer.Option(help="Tests, such as l,f.")] = "l,f",
    seed: Seed = 0,
    device: Device = "cpu",
    workers: Annotated[int, typer.Option(help="Of the simulation; 0: one per core.")] = 0,
    threads: Threads = 0,
    as_json: Annotated[bool, typer.Option("--json", help="One object on standard output.")] = False,
    quiet: Quiet = False,
) -> None:
    """Train the paper's ablation rows for as long each, and judge them; resumable."""
    from bidexgrasp_model.ablation import ablate as run_all
    from bidexgrasp_model.evaluation import EvalRequest
    from bidexgrasp_model.training import TrainRequest

    _use_threads(threads)
    if minutes is None and steps is None:
        minutes = 15.0
    request = TrainRequest(
        release=release,
        out=out,
        config=_config(preset, settings),
        seed=seed,
        device=device,
        steps=steps,
        minutes=minutes,
        quiet=quiet or as_json,
    )
    judging = EvalRequest(
        release=release,
        out=out,
        systems=(),
        samples=samples,
        objects=objects,
        tests=tuple(tests.split(",")),
        seed=seed,
        workers=workers,
        quiet=quiet or as_json,
    )
    _show(run_all(request, judging, _say(quiet or as_json)), out, as_json=as_json)


def main() -> None:
    """Run the command; a mistake of the user is one sentence and exit code 3."""
    from bidexgrasp_model.config import BadSetting

    try:
        app()
    except BadSetting as err:
        _refuse(str(err), 3)
    except KeyboardInterrupt:
        _refuse("interrupted; the same command goes on from the last checkpoint", 130)
    except Exception as err:
        code = getattr(err, "exit_code", None)
        if code is None and not isinstance(err, ValueError):
            raise
        _refuse(str(err), code or 3)


def _refuse(message: str, code: int) -> None:
    typer.echo(f"bidexgrasp-model: {message}", err=True)
    sys.exit(code)


def _config(preset: str, settings: list[str] | None) -> Any:
    from bidexgrasp_model.config import BadSetting, load_preset, with_settings

    changes = {}
    for text in settings or []:
        key, equal, value = text.partition("=")
        if not equal:
            raise BadSetting(f"--set {text}: give GROUP.KEY=VALUE")
        try:
            changes[key] = json.loads(value)
        except ValueError:
            changes[key] = value
    return with_settings(load_preset(preset), changes)


def _sizes(text: str) -> tuple[int, ...]:
    try:
        sizes = tuple(round(1000 * float(part)) for part in text.split(","))
    except ValueError as err:
        raise ValueError(f"--sizes {text}: give sizes in metres, such as 0.3,0.5") from err
    if not all(10 <= mm <= 5000 for mm in sizes):
        raise ValueError(f"--sizes {text}: give sizes between 0.01 and 5 m")
    return sizes


def _use_threads(count: int) -> None:
    import torch

    if count:
        torch.set_num_threads(count)


def _say(quiet: bool) -> Any:
    return (lambda _: None) if quiet else lambda line: typer.echo(line, err=True)


def _show(found: dict[str, Any], out: Path, *, as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(found))
        return
    typer.echo((out / "results.md").read_text(encoding="utf-8"))
    typer.echo(f"written to {out / 'results.json'} and {out / 'results.md'}")


if __name__ == "__main__":
    main()
