"""The paper's ablation rows and the baselines: trained with one budget, judged together."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bidexgrasp_model.checkpoint import Checkpoint
from bidexgrasp_model.config import Config, with_settings
from bidexgrasp_model.evaluation import EvalRequest, evaluate
from bidexgrasp_model.systems import DDPM, FULL, System, beside
from bidexgrasp_model.training import CHECKPOINT, Trainer, TrainRequest

ROWS: Mapping[str, Mapping[str, Any]] = {
    DDPM: {"model.coordination": "none", "model.geometry": False, "model.anchor": False},
    "GAF + SAGA": {"model.coordination": "single"},
    "BCM + GAF": {"model.anchor": False},
    FULL: {},
}
"""What each row that is trained changes. Paper, table of the ablation. Without the coordination
module each hand draws its view by itself; without the anchor poses are relative to the object."""


def ablate(
    request: TrainRequest, evaluation: EvalRequest, say: Callable[[str], None] = print
) -> dict[str, Any]:
    """Train every row for as long, judge all, and write the table; goes on where it stopped.

    Args:
        request: Release, length of training and preset; each row trains in a folder below `out`.
        evaluation: Scenes and tests; its systems are replaced.
        say: Takes lines for the person who waits.
    """
    systems = []
    for name, changes in ROWS.items():
        system = System(name, "model", request.out / System(name, "model").slug)
        row = row_request(request, request.config, changes, system.checkpoint or request.out)
        if not finished(row):
            say(f"training {name}")
            Trainer.start(row).run()
        systems.append(system)
    systems += beside(systems[-1].checkpoint or request.out, request.config, systems)
    return evaluate(dataclasses.replace(evaluation, systems=tuple(systems), reference=FULL), say)


def row_request(
    request: TrainRequest, config: Config, changes: Mapping[str, Any], out: Path
) -> TrainRequest:
    """The training of one row."""
    cache = request.cache or request.out
    return dataclasses.replace(request, config=with_settings(config, changes), out=out, cache=cache)


def finished(request: TrainRequest) -> bool:
    """Whether a row's checkpoint has had its share of training."""
    path = request.out / CHECKPOINT
    if not path.is_file():
        return False
    found = Checkpoint.load(path)
    if request.minutes is not None:
        return found.seconds >= 60 * request.minutes
    return request.steps is not None and found.step >= request.steps
