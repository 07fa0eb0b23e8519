"""Training: from a release to a checkpoint, on a CPU, a GPU, or several through torchrun.

What is drawn in a step is a function of (seed, step, rank), and the order of the cases one of
(seed, epoch): a run that is killed goes on from its last checkpoint as if nothing had happened.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from bidexdata.loaders import EpochSampler, HandModel, ResumableLoader
from bidexgrasp_model.checkpoint import Checkpoint, HandId
from bidexgrasp_model.config import BadSetting, Config
from bidexgrasp_model.data import CaseBatch, Cases
from bidexgrasp_model.hand_shape import SIDES, HandShapes
from bidexgrasp_model.model import GenerationModel, Scenes
from bidexgrasp_model.objective import total_loss
from bidexgrasp_model.places import Place, places_of_split
from bidexgrasp_model.ranks import Ranks
from bidexgrasp_model.state import Scale, encode
from bidexgrasp_model.training_log import TrainingLog

CHECKPOINT = "checkpoint.pt"
_STATISTICS_CASES = 400
"""Cases that the spread of states is measured on. Ours: some thousand grasps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainRequest:
    """What `bidexgrasp-model train` was asked for."""

    release: Path
    out: Path
    """Folder of checkpoint and log."""
    config: Config
    seed: int = 0
    where: str | None = None
    device: str = "cpu"
    steps: int | None = None
    """Length of training; the configuration's epochs when neither it nor `minutes` is given."""
    minutes: float | None = None
    """Length by the clock: a resumed run then depends on how fast the machine was."""
    overfit: int | None = None
    """Learn so many cases by heart, without augmentation."""
    save_every: float = 120.0
    """Seconds between checkpoints."""
    cache: Path | None = None
    """Folder of the neighbour tables; `out` when omitted."""
    quiet: bool = False


@dataclass(slots=True)
class Trainer:
    """A model, its optimiser and its place in the data."""

    request: TrainRequest
    cases: Cases
    ranks: Ranks
    step: int = 0
    seconds: float = 0.0
    model: GenerationModel = field(init=False)
    average: GenerationModel = field(init=False)
    optimiser: torch.optim.Optimizer = field(init=False)
    loader: ResumableLoader = field(init=False)
    hands: HandShapes = field(init=False)

    @classmethod
    def start(cls, request: TrainRequest, ranks: Ranks | None = None) -> Trainer:
        """Open the data, make a model, and go on from a checkpoint where there is one.

        Raises:
            BadSetting: The checkpoint in `out` was made with other settings, data or seed.
        """
        config = request.config
        cases = Cases(
            request.release,
            config,
            where=request.where,
            augment=request.overfit is None,
            cache=request.cache or request.out,
            seed=request.seed,
            only=request.overfit,
        )
        if not len(cases):
            raise BadSetting(
                f"{request.release}: no case of its split train has a grasp that passed"
            )
        self = cls(request, cases, ranks or Ranks())
        self._build()
        path = request.out / CHECKPOINT
        if path.is_file():
            self._resume(Checkpoint.load(path))
        return self

    @property
    def steps(self) -> int:
        """Steps to train, where the clock does not say."""
        if self.request.steps is not None:
            return self.request.steps
        return max(1, self.request.config.train.epochs * len(self.cases) // self._cases_per_step)

    @property
    def done(self) -> float:
        """Share of training that is over, 0 to 1."""
        if self.request.minutes is not None:
            return min(1.0, self.seconds / (60 * self.request.minutes))
        return min(1.0, self.step / self.steps)

    def run(self, report: Callable[[str], None] | None = None) -> Checkpoint:
        """Train to the end; the first process writes checkpoints and the log on the way.

        A training that is over leaves its files as they are, to the byte.
        """
        path, quiet = self.request.out / CHECKPOINT, self.request.quiet
        begun = time.monotonic() - self.seconds
        saved, unsaved = time.monotonic(), not path.is_file()
        with contextlib.ExitStack() as ends:
            log = None
            if self.ranks.first and self.done < 1:
                log = TrainingLog(path.with_name("log.csv"), self.step, quiet=quiet, report=report)
                ends.callback(log.close)
            batches = self._batches()
            while self.done < 1:
                terms = self.train_step(next(batches))
                self.seconds = self.ranks.agreed(time.monotonic() - begun)
                unsaved = True
                if log is not None:
                    log.add(self.step, self.loader.sampler.epoch, self.seconds, self.done, terms)
                if self.ranks.first and time.monotonic() - saved > self.request.save_every:
                    self.checkpoint().save(path)
                    saved, unsaved = time.monotonic(), False
        made = self.checkpoint()
        if self.ranks.first and unsaved:
            made.save(path)
        return made

    def train_step(self, items: list[Mapping[str, Any]]) -> dict[str, float]:
        """One step of the optimiser on some cases; gives the loss and its parts."""
        generator = self.generator()
        batch = self.cases.batch(items, generator).to(self.device)
        rate = self._rate()
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        self.optimiser.zero_grad(set_to_none=True)
        total, terms = self.loss(batch, generator)
        total.backward()
        self.ranks.average_gradients(self.model)
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), self.request.config.train.clip)
        self.optimiser.step()
        self._follow()
        self.step += 1
        values = {"loss": total.detach(), **{n: v.detach() for n, v in terms.items()}}
        return {"rate": rate, **{n: float(v) for n, v in values.items()}}

    def loss(
        self, batch: CaseBatch, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of this step; on a GPU the network runs in bfloat16."""
        mixed = self.device.type == "cuda"
        return total_loss(self.model, self._geometric_hands(), batch, generator, mixed=mixed)

    def generator(self) -> torch.Generator:
        """Draws of this step and rank, whatever came before."""
        mixed = (self.request.seed * 1_000_003 + self.step) * 1_009 + self.ranks.rank
        return torch.Generator().manual_seed(mixed % 2**63)

    @property
    def device(self) -> torch.device:
        """Where the model is."""
        return torch.device(self.request.device)

    def checkpoint(self) -> Checkpoint:
        """Everything as it stands."""
        return Checkpoint(
            config=self.request.config,
            release=self.cases.id,
            hands=hands_of(self.cases),
            setting=setting_of(self.cases),
            where=self.cases.where,
            step=self.step,
            seconds=self.seconds,
            weights=self.model.state_dict(),
            average=self.average.state_dict(),
            optimiser=self.optimiser.state_dict(),
            data=self.loader.state_dict(),
        )

    def _build(self) -> None:
        config, request = self.request.config, self.request
        with torch.random.fork_rng():
            torch.random.manual_seed(request.seed)
            self.model = GenerationModel(config, hands_of(self.cases).joints)
        self.model.scale = measure_scale(self.cases, self.model)
        self.model.to(self.device)
        self.average = GenerationModel(config, self.model.layout.joints).to(self.device)
        self.average.load_state_dict(self.model.state_dict())
        self.optimiser = torch.optim.AdamW(
            self.model.parameters(), config.train.rate, weight_decay=config.train.weight_decay
        )
        self.hands = HandShapes.of_release(request.release, config.loss.surface_points).to(
            self.device
        )
        sampler = EpochSampler(
            len(self.cases), request.seed, rank=self.ranks.rank, world_size=self.ranks.size
        )
        self.loader = ResumableLoader(
            self.cases, self._batch_size, sampler, collate_fn=list, drop_last=True
        )

    def _resume(self, found: Checkpoint) -> None:
        want = (self.request.config, self.cases.id, self.cases.where)
        if (found.config, found.release, found.where) != want:
            raise BadSetting(
                f"{self.request.out} holds a checkpoint of other settings or data; choose another --out"
            )
        if found.data["seed"] != self.request.seed:
            raise BadSetting(
                f"{self.request.out} was begun with --seed {found.data['seed']}, not {self.request.seed}"
            )
        self.step, self.seconds = found.step, found.seconds
        self.model.load_state_dict(found.weights)
        self.average.load_state_dict(found.average)
        self.optimiser.load_state_dict(found.optimiser)
        self.loader.load_state_dict(found.data)

    @property
    def _batch_size(self) -> int:
        return max(1, min(self.request.config.train.cases, len(self.cases) // self.ranks.size))

    @property
    def _cases_per_step(self) -> int:
        return self._batch_size * self.ranks.size

    def _batches(self) -> Iterator[list[Mapping[str, Any]]]:
        while True:
            self.cases.set_epoch(self.loader.sampler.epoch)
            yield from self.loader

    def _rate(self) -> float:
        """Linear warm-up, then the half cosine to 1 % of the rate."""
        train = self.request.config.train
        fall = 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * self.done))
        return train.rate * fall * min(1.0, (self.step + 1) / max(1, train.warm_up))

    def _geometric_hands(self) -> HandShapes | None:
        loss = self.request.config.loss
        due = self.step % loss.geometric_every == 0 and self.done >= loss.geometric_from
        return self.hands if due else None

    @torch.no_grad()
    def _follow(self) -> None:
        """Move the averaged weights; early on they follow fast."""
        decay = min(self.request.config.train.ema, (1 + self.step) / (10 + self.step))
        for mine, other in zip(self.average.parameters(), self.model.parameters(), strict=True):
            mine.lerp_(other.detach(), 1 - decay)


def overfit_places(release: Path, checkpoint: Path, only: int) -> list[Place]:
    """The scenes that `TrainRequest.overfit` chooses."""
    found = Checkpoint.load(checkpoint)
    cases = Cases(release, found.config, where=found.where, augment=False, only=only)
    scenes = {cases[k]["scene_id"] for k in range(len(cases))}
    return [p for p in places_of_split(cases.release, "train") if p.scene_id in scenes]


def measure_scale(cases: Cases, model: GenerationModel) -> Scale:
    """Mean and spread of the states of cases that are spread over the data."""
    count = min(len(cases), _STATISTICS_CASES)
    states = []
    for low in range(0, count, 16):
        chosen = range(low, min(low + 16, count))
        items = [cases[k * len(cases) // count] for k in chosen]
        batch = cases.batch(items, torch.Generator().manual_seed(low))
        scenes = Scenes.of(batch.clouds, batch.tables)
        frames = model.frames(scenes.radius, batch.case.repeat_interleave(2), _views(batch, model))
        anchor = type(frames.anchor)(
            frames.anchor.pos.reshape(-1, 2, 3) + scenes.centre[batch.case][:, None],
            frames.anchor.rot.reshape(-1, 2, 3, 3),
        )
        states.append(encode(batch.poses, anchor))
    return Scale.of(torch.cat(states), model.layout)


def _views(batch: CaseBatch, model: GenerationModel) -> Tensor:
    plain = model.coordination is None
    return torch.zeros_like(batch.view).flatten() if plain else batch.view.flatten()


def hands_of(cases: Cases) -> HandId:
    """The hands of a release."""
    hands = [HandModel.from_release(cases.release, side).hand for side in SIDES]
    return HandId(
        names=tuple(h.name for h in hands),  # type: ignore[arg-type]
        joint_names=tuple(h.joint_names for h in hands),  # type: ignore[arg-type]
        lower=tuple(tuple(map(float, h.joint_lower)) for h in hands),  # type: ignore[arg-type]
        upper=tuple(tuple(map(float, h.joint_upper)) for h in hands),  # type: ignore[arg-type]
    )


def setting_of(cases: Cases) -> str:
    """Tabletop where all scenes are."""
    found = set(cases.release.scenes.column("setting").to_pylist())
    return found.pop() if len(found) == 1 else "floating"
