"""A sampler whose order is a function of (seed, epoch) alone and that resumes exactly."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np


class EpochSampler:
    """Shuffle `length` rows anew each epoch; shared fairly between ranks; resumable.

    State: the epoch and how many samples of this rank it has given out. With DataLoader workers
    the sampler runs ahead of the trainer: store `state_dict(consumed)` with the trainer's own
    count.
    """

    def __init__(self, length: int, seed: int = 0, *, rank: int = 0, world_size: int = 1):
        if not 0 <= rank < world_size:
            raise ValueError(f"rank must lie in [0, {world_size}), not {rank}")
        self.length, self.seed = length, seed
        self.rank, self.world_size = rank, world_size
        self.epoch = 0
        self._given = 0

    def __len__(self) -> int:
        """Samples that this rank gets in an epoch; the tail that does not divide is dropped."""
        return self.length // self.world_size

    def __iter__(self) -> Iterator[int]:
        """Give the rest of this epoch, then step to the next one."""
        order = self.order()
        while self._given < len(order):
            self._given += 1
            yield int(order[self._given - 1])
        self.epoch, self._given = self.epoch + 1, 0

    def order(self) -> np.ndarray:
        """All rows of this rank in this epoch, (len,)."""
        shuffled = np.random.default_rng([self.seed, self.epoch]).permutation(self.length)
        return shuffled[self.rank :: self.world_size][: len(self)]

    def set_epoch(self, epoch: int) -> None:
        """Start a given epoch from its beginning."""
        self.epoch, self._given = epoch, 0

    def state_dict(self, consumed: int | None = None) -> dict[str, Any]:
        """What is needed to go on; `consumed` = samples of this epoch that reached the trainer."""
        given = self._given if consumed is None else consumed
        return {"seed": self.seed, "epoch": self.epoch, "given": given}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where `state_dict` was taken."""
        self.seed, self.epoch, self._given = state["seed"], state["epoch"], state["given"]
