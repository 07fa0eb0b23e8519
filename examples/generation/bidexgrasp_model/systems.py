"""What is judged: models, the transfer from the nearest object, and the synthesis itself."""

from __future__ import annotations

import dataclasses
import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from bidexdata import Release, Run
from bidexgrasp_model.checkpoint import Checkpoint
from bidexgrasp_model.config import Config, with_settings
from bidexgrasp_model.hand_shape import HandShapes
from bidexgrasp_model.places import Place, depth_clouds, release_clouds
from bidexgrasp_model.sampling import Samples, Touch, fitted, run_columns, sample
from bidexgrasp_model.surfaces import estimated_surface, known_surface, tables_under
from bidexgrasp_model.transfer import known_cases, transfer

FULL = "BCM + GAF + SAGA"
DDPM = "plain DDPM"
DIRECT = f"{FULL}, pairs drawn at once"
AS_SAMPLED = ", as sampled"
"""Behind the name of a model whose samples are not refined."""
BEST_OF = 4
"""Samples of which one is kept, in a row of its own."""
BEST = f"{FULL}, best of {BEST_OF}"
PAPER_ORDER = (DDPM, "GAF + SAGA", "BCM + GAF", FULL)
"""Rows of the paper's ablation, worst first."""
TRANSFER = "nearest-object transfer"
FITTED = "nearest-object transfer, refined"
SYNTHESIS = "synthesis"


@dataclass(frozen=True, slots=True)
class System:
    """Something that makes grasps of the test objects."""

    name: str
    kind: Literal["model", "transfer", "synthesis"]
    checkpoint: Path | None = None
    """Of a model; for the transfer, whose settings say how clouds are read."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Changed for sampling alone, such as `model.coordination`."""

    @property
    def slug(self) -> str:
        """Name of its folder."""
        return "".join(c if c.isalnum() else "-" for c in self.name.lower()).strip("-")

    def as_sampled(self) -> System:
        """The same model without refinement and without a choice."""
        settings = {**self.settings, "refine.steps": 0, "refine.draws": 1}
        return dataclasses.replace(self, name=self.name + AS_SAMPLED, settings=settings)


def beside(checkpoint: Path, config: Config, models: Sequence[System]) -> list[System]:
    """What a model is judged beside.

    Its own samples without refinement, the best of several, views drawn in pairs, the transfer and
    the synthesis.

    Args:
        checkpoint: Of the model.
        config: Its own; where it asks for no refinement nothing is told apart by that.
        models: Those that are judged, it among them.
    """
    refine = config.refine.steps
    found = [model.as_sampled() for model in models] if refine else []
    found.append(System(BEST, "model", checkpoint, {"refine.draws": BEST_OF}))
    found.append(System(DIRECT, "model", checkpoint, {"model.coordination": "direct"}))
    found.append(System(TRANSFER, "transfer", checkpoint))
    if refine:
        found.append(System(FITTED, "transfer", checkpoint, {"refine.steps": refine}))
    return [*found, System(SYNTHESIS, "synthesis")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """The scenes, and how many grasps of each."""

    release: Path
    places: tuple[Place, ...]
    samples: int = 3
    seed: int = 0
    single_view: bool = False


def make_run(system: System, task: Task, out: Path) -> Run:
    """Write the grasps of a system as a run, or open the one that is there.

    Raises:
        ValueError: `out` holds a run of another checkpoint or task.
    """
    mark = _mark(system, task)
    if (out / "run.json").is_file():
        run = Run.open(out)
        if run.spec.config["about"].get("mark") != mark:
            raise ValueError(
                f"{out} holds grasps of another checkpoint or task; choose another --out"
            )
        return run
    assert system.checkpoint is not None
    checkpoint = Checkpoint.load(system.checkpoint)
    release = Release.open(task.release)
    if system.kind == "transfer":
        found = _transferred(checkpoint, system, task, release)
    else:
        found = _sampled(checkpoint, system, task, release)
    columns = run_columns(found.poses, checkpoint.hands)
    places = [task.places[b] for b in found.cloud.tolist()]
    about = {"system": system.name, "mark": mark, "release": dataclasses.asdict(checkpoint.release)}
    return Run.create(
        out,
        {**columns, **scene_columns(places)},
        source=task.release,
        hand=",".join(dict.fromkeys(checkpoint.hands.names)),
        about=about,
        seed=task.seed,
    )


def scene_columns(places: Sequence[Place]) -> dict[str, np.ndarray]:
    """The columns of the record that say where the object is."""
    return {
        "scene_id": np.array([p.scene_id for p in places], np.str_),
        "object_pos": np.array([p.pos for p in places], np.float32),
        "object_quat_wxyz": np.array([p.quat_wxyz for p in places], np.float32),
    }


def seconds_per_batch(
    system: System, release: Path, places: Sequence[Place], repeats: int = 5
) -> float:
    """Median time of sampling 64 grasps of one cloud on this machine [s]."""
    assert system.checkpoint is not None
    found = Checkpoint.load(system.checkpoint)
    model = found.model()
    model.config = with_settings(found.config, system.settings)
    opened = Release.open(release)
    clouds = release_clouds(opened, places[:1], found.config.model.points)
    touch = touch_of(model.config, opened, places[:1], None)
    times = []
    for k in range(repeats + 1):
        start = time.perf_counter()
        sample(model, clouds, 64, found.hands, torch.Generator().manual_seed(k), touch)
        times.append(time.perf_counter() - start)
    return float(np.median(times[1:]))


def _sampled(checkpoint: Checkpoint, system: System, task: Task, release: Release) -> Samples:
    model = checkpoint.model()
    model.config = with_settings(checkpoint.config, system.settings)
    points = checkpoint.config.model.points
    if task.single_view:
        rng = np.random.default_rng(task.seed)
        clouds = depth_clouds(release, task.places, points, rng)
    else:
        clouds = release_clouds(release, task.places, points)
    generator = torch.Generator().manual_seed(task.seed)
    touch = touch_of(model.config, release, task.places, clouds if task.single_view else None)
    return sample(model, clouds, task.samples, checkpoint.hands, generator, touch)


def touch_of(
    config: Config, release: Release, places: Sequence[Place], seen: Float[Tensor, "B P 3"] | None
) -> Touch | None:
    """What refinement needs; None where the configuration asks for none.

    Args:
        config: Steps and points.
        release: Of the objects and the hands.
        places: The scenes.
        seen: Clouds from one side, where nothing else of the objects is known.
    """
    if not config.refine.wanted:
        return None
    if seen is None:
        surface = known_surface(release, places)
    else:
        surface = estimated_surface(seen, tables_under(places))
    return Touch(surface, HandShapes.of_release(release.path, 1))


def _transferred(checkpoint: Checkpoint, system: System, task: Task, release: Release) -> Samples:
    config = with_settings(checkpoint.config, {"refine.steps": 0, **system.settings})
    known = known_cases(task.release, config, checkpoint.where)
    clouds = release_clouds(release, task.places, config.model.points)
    sizes = [round(1000 * p.size) for p in task.places]
    found = transfer(known, clouds, sizes, task.samples, config, checkpoint.hands.joints)
    touch = touch_of(config, release, task.places, None)
    if touch is None:
        return found
    return fitted(found, clouds, checkpoint.model(), touch, checkpoint.hands, config)


def _mark(system: System, task: Task) -> str:
    """Hash of what decides the grasps."""
    digest = hashlib.sha256()
    if system.checkpoint is not None and system.kind == "model":
        path = system.checkpoint
        path = path / "checkpoint.pt" if path.is_dir() else path
        digest.update(path.read_bytes())
    digest.update(repr((system.kind, sorted(system.settings.items()))).encode())
    digest.update(repr((task.places, task.samples, task.seed, task.single_view)).encode())
    digest.update((task.release / "manifest.json").read_bytes())
    return digest.hexdigest()[:16]
