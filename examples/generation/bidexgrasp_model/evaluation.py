"""Judge systems on the objects that no model has seen, and write what came of it."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bidexdata import Release, TaskExecution, load_protocol, validate_run
from bidexgrasp_model.checkpoint import Checkpoint
from bidexgrasp_model.config import BadSetting
from bidexgrasp_model.data import Cases
from bidexgrasp_model.judging import PROTOCOL, Judged, figures, judged_run, judged_split, paired
from bidexgrasp_model.model import Scenes
from bidexgrasp_model.places import Place, places_of_split
from bidexgrasp_model.systems import (
    AS_SAMPLED,
    PAPER_ORDER,
    SYNTHESIS,
    System,
    Task,
    make_run,
    seconds_per_batch,
)

PAPER_SECONDS = 1.67
"""Time of a batch of 64 in the paper, on one RTX 4090 [s]. Paper, appendix."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EvalRequest:
    """What `bidexgrasp-model evaluate` was asked for."""

    release: Path
    out: Path
    systems: tuple[System, ...]
    reference: str | None = None
    """System that the others are compared with, scene by scene."""
    samples: int = 3
    """Grasps of each scene. Paper, 6."""
    objects: int | None = None
    """Only so many test objects, spread over all."""
    tests: tuple[str, ...] = ("l", "f")
    seed: int = 0
    workers: int = 0
    single_view: bool = False
    quiet: bool = False


def evaluate(request: EvalRequest, say: Callable[[str], None] = print) -> dict[str, Any]:
    """Sample, test and count; what is there already is kept, so a stopped command goes on.

    Returns:
        Figures per system; also written as `results.json` and `results.md` in `out`.

    Raises:
        BadSetting: The release has no test object.
    """
    from bidexgrasp_model.report import markdown

    release = Release.open(request.release)
    places = chosen_places(release, request.objects)
    if not places:
        raise BadSetting(f"{request.release}: its split test has no scene to judge on")
    task = Task(
        release=request.release,
        places=tuple(places),
        samples=request.samples,
        seed=request.seed,
        single_view=request.single_view,
    )
    judged: dict[str, Judged] = {}
    found: dict[str, Any] = {
        "release": {"name": release.name, "version": release.version},
        "objects": len({p.object_id for p in places}),
        "scenes": len(places),
        "samples": request.samples,
        "tests": list(request.tests),
        "systems": {},
    }
    for system in request.systems:
        say(f"{system.name}: {len(places)} scenes, {request.samples} grasps of each")
        judged[system.name] = _judge(system, task, request)
        row = {"kind": system.kind, **figures(judged[system.name])}
        if system.kind == "model" and system.checkpoint is not None:
            row |= model_figures(system, request, places)
        found["systems"][system.name] = row
        write(request.out, found, markdown(found))
    reference = request.reference
    if reference in judged:
        for name, other in judged.items():
            if name not in (reference, SYNTHESIS):
                pairs = {t: paired(judged[reference], other, t) for t in request.tests}
                found["systems"][name]["reference_minus_this"] = pairs
        found["reference"] = reference
    found["order"] = {end: _order(judged, end, request.tests) for end in ("", AS_SAMPLED)}
    write(request.out, found, markdown(found))
    return found


def chosen_places(release: Release, objects: int | None) -> list[Place]:
    """Scenes of the test split; of some of its objects where that is asked for."""
    places = places_of_split(release, "test")
    names = sorted({p.object_id for p in places})
    if objects is not None and objects < len(names):
        kept = {names[k * len(names) // objects] for k in range(objects)}
        places = [p for p in places if p.object_id in kept]
    return places


def model_figures(system: System, request: EvalRequest, places: Sequence[Place]) -> dict[str, Any]:
    """Of a model alone: length of training, time of a batch, and how often it names the views."""
    assert system.checkpoint is not None
    checkpoint = Checkpoint.load(system.checkpoint)
    return {
        "steps": checkpoint.step,
        "training_minutes": round(checkpoint.seconds / 60, 2),
        "parameters": sum(p.numel() for p in checkpoint.model().parameters()),
        "seconds_per_64": seconds_per_batch(system, request.release, places),
        "paper_seconds_per_64": PAPER_SECONDS,
        "views": view_hits(checkpoint, request.release),
    }


@torch.inference_mode()
def view_hits(checkpoint: Checkpoint, release: Path, most: int = 128) -> dict[str, float] | None:
    """How often views of stored grasps are among the best that the model names, on test objects.

    Returns:
        Shares: `right_top1`, `right_top5` (a uniform guess gives 1/16 and 5/16), and `left_top5`,
        the left hand's view among the five best given the right's.
    """
    model = checkpoint.model()
    if model.coordination is None:
        return None
    cases = Cases(
        release, checkpoint.config, split="test", where=checkpoint.where, augment=False, only=most
    )
    hits = {"right_top1": 0, "right_top5": 0, "left_top5": 0}
    total = 0
    for low in range(0, len(cases), 16):
        items = [cases[k] for k in range(low, min(low + 16, len(cases)))]
        batch = cases.batch(items, torch.Generator().manual_seed(0))
        scores = model.see(Scenes.of(batch.clouds, batch.tables)).scores
        assert scores is not None
        left, right = batch.view.unbind(-1)
        best = scores.single[batch.case, 1].topk(5, dim=-1).indices
        hits["right_top1"] += int((best[:, 0] == right).sum())
        hits["right_top5"] += int((best == right[:, None]).any(-1).sum())
        row = scores.pair[batch.case, right].topk(5, dim=-1).indices
        hits["left_top5"] += int((row == left[:, None]).any(-1).sum())
        total += len(right)
    return {name: count / max(1, total) for name, count in hits.items()}


def write(out: Path, found: dict[str, Any], text: str) -> None:
    """Write both files, each whole or not at all."""
    out.mkdir(parents=True, exist_ok=True)
    for name, content in (
        ("results.json", json.dumps(found, indent=1) + "\n"),
        ("results.md", text),
    ):
        partial = out / f".{name}.{os.getpid()}"
        partial.write_text(content, encoding="utf-8")
        os.replace(partial, out / name)


def _order(
    judged: Mapping[str, Judged], end: str, tests: Sequence[str]
) -> list[dict[str, Any]] | None:
    """How much better each row of the paper's ablation is than the one before."""
    names = [name + end for name in PAPER_ORDER]
    if not set(names) <= set(judged):
        return None
    return [
        {t: paired(judged[better], judged[worse], t) for t in tests}
        for worse, better in itertools.pairwise(names)
    ]


def _judge(system: System, task: Task, request: EvalRequest) -> Judged:
    if system.kind == "synthesis":
        stored = tuple(
            t for t in request.tests if (PROTOCOL, t) in Release.open(task.release).protocols
        )
        found = judged_split(task.release, "test", stored)
        kept = {p.scene_id for p in task.places}
        return found.select(np.array([scene in kept for scene in found.scene_id], bool))
    run = make_run(system, task, request.out / "runs" / system.slug)
    execution = TaskExecution(workers=request.workers, quiet=request.quiet)
    validate_run(run, load_protocol(PROTOCOL), request.tests, execution=execution)
    return judged_run(run.path, request.tests)
