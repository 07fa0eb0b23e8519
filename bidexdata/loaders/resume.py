"""A DataLoader that knows how far its trainer is, so that training resumes in mid-epoch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from bidexdata.loaders.collation import collate
from bidexdata.loaders.dataset import BiDexDataset
from bidexdata.loaders.prefetch import Prefetch
from bidexdata.loaders.samplers import EpochSampler

ROWS_AT_ONCE = 2048
"""Rows that are read together where no worker is asked for: some 2 MB, and Python's work for a
gather is shared by eight batches of 256."""


class ResumableLoader:
    """Batches of a map-style data set in a sampler's order; counts those that were handed out.

    Workers and the prefetch thread read ahead; what they have read and the trainer has not had does
    not count. A batch counts from the moment it is handed out, so take the state behind the step
    that used it. Each pass is an epoch; one that was left early is gone on with by the next.
    """

    def __init__(
        self,
        data: Any,
        batch_size: int,
        sampler: EpochSampler,
        *,
        prefetch: int = 0,
        drop_last: bool = False,
        **options: Any,
    ):
        """Make the loader.

        Args:
            data: `BiDexDataset`, `BiDexCases` or any map-style data set.
            batch_size: Items of a batch.
            sampler: Gives the order; its `state_dict` is the loader's.
            prefetch: Batches that a thread reads ahead; 0 = no thread.
            drop_last: Leave out a last batch that is not full.
            options: Passed on to `torch.utils.data.DataLoader`; `collate_fn` is our `collate` when
                omitted. Without options a `BiDexDataset` is read directly, several batches' rows
                at once.
        """
        from torch.utils.data import DataLoader

        self.sampler, self.batch_size = sampler, batch_size
        self.drop_last, self._prefetch = drop_last, prefetch
        self._loader = DataLoader(
            data,
            batch_size,
            sampler=sampler,
            drop_last=drop_last,
            **{"collate_fn": collate, **options},
        )
        self._consumed: int | None = None
        self._direct = data if isinstance(data, BiDexDataset) and not options else None

    def __iter__(self) -> Iterator[Any]:
        """Give the rest of the epoch."""
        self.load_state_dict(self.state_dict())
        total, consumed = len(self.sampler), 0
        source: Iterable[Any] = self._loader if self._direct is None else self._blocks()
        if self._prefetch:
            source = Prefetch(source, self._prefetch)
        for batch in source:
            consumed += min(self.batch_size, total - consumed)
            if self.drop_last and total - consumed < self.batch_size:
                consumed = total  # what is left is dropped, so this is the end of the epoch
            self._consumed = consumed
            yield batch
        self._consumed = None  # the sampler has stepped to the next epoch

    def _blocks(self) -> Iterator[Any]:
        assert self._direct is not None
        chunks = self.sampler.chunks(max(ROWS_AT_ONCE // self.batch_size, 1) * self.batch_size)
        return self._direct.batches(chunks, self.batch_size, drop_last=self.drop_last)

    def __len__(self) -> int:
        """Batches that are left of this epoch."""
        return len(self._loader)

    def state_dict(self) -> dict[str, Any]:
        """What is needed to go on behind the batch that was handed out last."""
        return self.sampler.state_dict(self._consumed)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where `state_dict` was taken, on any number of ranks and workers."""
        self._consumed = None
        self.sampler.load_state_dict(state)
