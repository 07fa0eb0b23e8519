"""Samplers whose order is a function of (seed, epoch) alone, and that resume exactly.

The order is global: rank r of R takes its share of it, so what is left of an epoch does not depend
on how many ranks there are. State is (seed, epoch, samples of the epoch that all ranks have had).
Memory does not grow with the number of rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Int

from bidexdata.loaders.permutation import permuted

BLOCK = 65_536
"""Positions that are permuted at once: below it numpy's calls cost more than the arithmetic."""


class EpochSampler:
    """Shuffle `length` rows anew each epoch; shared fairly between ranks; resumable.

    Iterating steps to the next epoch at the end. With DataLoader workers the sampler runs ahead of
    the trainer: take `state_dict(consumed)` with the trainer's own count, or let `ResumableLoader`
    count.
    """

    group = 1
    """Samples in a row that one rank gets."""

    def __init__(self, length: int, seed: int = 0, *, rank: int = 0, world_size: int = 1):
        if not 0 <= rank < world_size:
            raise ValueError(f"rank must lie in [0, {world_size}), not {rank}")
        self.length, self.seed = length, seed
        self.rank, self.world_size = rank, world_size
        self.epoch = 0
        self._emitted = 0  # of all ranks, when this rank's share was last dealt
        self._given = 0  # of this rank since then
        self._begun = (0, 0)  # epoch and _emitted of the pass that runs or ran last

    def __len__(self) -> int:
        """Samples that this rank still gets in this epoch; what does not divide is dropped."""
        return self._share(self._emitted) - self._given

    def __iter__(self) -> Iterator[int]:
        """Give the rest of this epoch, then step to the next one."""
        for block in self._begin():
            for row in block.tolist():
                self._given += 1
                yield row
        self.set_epoch(self.epoch + 1)

    def chunks(self, rows: int) -> Iterator[Int[np.ndarray, " n"]]:
        """What iterating gives, as arrays of `rows` samples; the last may be smaller."""
        left = np.zeros(0, np.int64)
        for block in self._begin():
            ready = np.concatenate([left, block]) if len(left) else block
            whole = len(ready) // rows * rows
            for low in range(0, whole, rows):
                self._given += rows
                yield ready[low : low + rows]
            left = ready[whole:]
        if len(left):
            self._given += len(left)
            yield left
        self.set_epoch(self.epoch + 1)

    def order(self) -> Int[np.ndarray, " n"]:
        """All that this rank still gets in this epoch: `len` rows."""
        parts = list(self._mine(self._emitted + self._given * self.world_size))
        return np.concatenate([np.zeros(0, np.int64), *parts])

    def set_epoch(self, epoch: int) -> None:
        """Start a given epoch from its beginning."""
        self.epoch, self._emitted, self._given = epoch, 0, 0

    def state_dict(self, consumed: int | None = None) -> dict[str, Any]:
        """What is needed to go on, on any number of ranks.

        Args:
            consumed: Samples that reached this rank's trainer in the pass that began last; what
                the sampler has given out when omitted.

        Raises:
            ValueError: Ranks that have all had `consumed` samples have not had the beginning of
                the order: it is no multiple of `group`.
        """
        if consumed is None:
            epoch, emitted, given = self.epoch, self._emitted, self._given
        else:
            (epoch, emitted), given = self._begun, consumed
            if given >= self._share(emitted):
                epoch, emitted, given = epoch + 1, 0, 0
        if self.world_size > 1 and given % self.group:
            raise ValueError(f"{given} samples cannot be resumed from: no multiple of {self.group}")
        emitted += given * self.world_size
        return {"seed": self.seed, "epoch": epoch, "emitted": emitted}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where `state_dict` was taken, on this sampler's rank and number of ranks."""
        self.seed = state["seed"]
        self.set_epoch(state["epoch"])
        self._emitted = state["emitted"]
        self._begun = (self.epoch, self._emitted)

    def _begin(self) -> Iterator[Int[np.ndarray, " n"]]:
        """Note that a pass begins; the rest of this epoch in blocks."""
        self._emitted, self._given = self._emitted + self._given * self.world_size, 0
        self._begun = (self.epoch, self._emitted)
        return self._mine(self._emitted)

    def _share(self, start: int) -> int:
        """Samples per rank behind the first `start`: whole rounds of groups, so all get as many."""
        left = max(self.length - start, 0)
        if self.world_size == 1:
            return left
        return left // (self.world_size * self.group) * self.group

    def _mine(self, start: int) -> Iterator[Int[np.ndarray, " n"]]:
        """This rank's rows behind the first `start` of the order, in blocks."""
        every = self.world_size * self.group
        end = start + self._share(start) * self.world_size
        at = start
        step = max(BLOCK // every, 1) * every
        while at < end:
            stop = min(at + step, end)
            block = self._order(at, stop)
            if self.world_size > 1:
                turns = block.reshape(-1, self.world_size, self.group)
                block = turns[:, self.rank].reshape(-1)
            yield block
            at = stop

    def _order(self, low: int, high: int) -> Int[np.ndarray, " n"]:
        """Rows at the positions [low, high) of this epoch's order."""
        return permuted(np.arange(low, high), self.length, self.seed, self.epoch)


class ObjectSampler(EpochSampler):
    """Shuffle rows so that `group` of one object follow each other, for batches of few objects.

    With `clouds="unique"` a batch then holds few clouds. Groups are dealt in a random order, and
    the rows of an object fall into groups at random; the last group of an object may be smaller,
    so a group of the order may hold two objects. Memory: three numbers per object.
    """

    def __init__(
        self,
        object_rows: Int[np.ndarray, " K"],
        group: int = 16,
        seed: int = 0,
        *,
        rank: int = 0,
        world_size: int = 1,
    ):
        """Take the number of rows of each object, as `BiDexDataset.object_rows` gives it.

        Args:
            object_rows: Rows of each object; rows of one object lie together.
            group: Rows of one object that follow each other.
            seed: Seed of the order.
            rank: Number of this process.
            world_size: Number of processes.
        """
        counts = np.asarray(object_rows, np.int64)
        super().__init__(int(counts.sum()), seed, rank=rank, world_size=world_size)
        if group < 1:
            raise ValueError(f"group must be at least 1, not {group}")
        self.group = group
        self._counts = counts
        self._first_row = np.cumsum(counts) - counts
        pieces = -(-counts // group)
        self._first_piece = np.cumsum(pieces) - pieces
        self._pieces = int(pieces.sum())
        self._cursor: tuple[tuple[int, int] | None, int, int] = (None, 0, 0)
        # (seed, epoch), piece and position where the last block ended

    def _order(self, low: int, high: int) -> Int[np.ndarray, " n"]:
        found: list[np.ndarray] = []
        piece, at = self._piece_at(low)
        while at < high:
            stop = min(piece + max(BLOCK // self.group, 1), self._pieces)
            start, sizes = self._pieces_at(piece, stop)
            ends = at + np.cumsum(sizes)
            last = int(np.searchsorted(ends, high))  # the piece that holds row high - 1
            taken = slice(0, last + 1)
            found.append(self._rows(start[taken], sizes[taken])[max(low - at, 0) : high - at])
            whole = last if last < len(ends) and ends[last] > high else last + 1
            whole = min(whole, len(ends))
            piece, at = piece + whole, int(ends[whole - 1]) if whole else at
            self._cursor = ((self.seed, self.epoch), piece, at)
            if last < len(ends):
                break
        return np.concatenate(found)

    def _piece_at(self, low: int) -> tuple[int, int]:
        """A piece of the order at or before a position, and the position where it begins."""
        of, piece, at = self._cursor
        if of != (self.seed, self.epoch) or at > low:
            piece, at = 0, 0
        # Pieces differ in size, so a far position is found by adding up those before it.
        while piece < self._pieces:
            stop = min(piece + max(BLOCK // self.group, 1), self._pieces)
            _, sizes = self._pieces_at(piece, stop)
            if at + int(sizes.sum()) > low:
                break
            piece, at = stop, at + int(sizes.sum())
        return piece, at

    def _pieces_at(self, low: int, high: int) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the pieces at some places of this epoch's order, and their sizes."""
        piece = permuted(np.arange(low, high), self._pieces, self.seed, self.epoch)
        owner = np.searchsorted(self._first_piece, piece, side="right") - 1
        behind = (piece - self._first_piece[owner]) * self.group
        return piece, np.minimum(self._counts[owner] - behind, self.group)

    def _rows(self, piece: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Rows of some pieces, one piece after the other."""
        piece = np.repeat(piece, sizes)
        first = np.cumsum(sizes) - sizes
        owner = np.searchsorted(self._first_piece, piece, side="right") - 1
        inside = (piece - self._first_piece[owner]) * self.group
        inside = inside + np.arange(len(piece)) - np.repeat(first, sizes)
        row = permuted(inside, self._counts[owner], self.seed, self.epoch, owner)
        return self._first_row[owner] + row
