"""Turn what `BiDexDataset.__getitems__` gives into a batch of tensors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, overload

if TYPE_CHECKING:
    import torch


class RowBatch(Sequence[dict[str, Any]]):
    """Rows that were read together: stacked tensors that can also be walked row by row.

    `collate` takes the stacked form as it is. PyTorch's default collate function walks the rows,
    which gives the same batch at the price of a copy per row.
    """

    def __init__(self, stacked: Mapping[str, Any], length: int):
        self.stacked = dict(stacked)
        self._length = length

    def __len__(self) -> int:
        return self._length

    @overload
    def __getitem__(self, index: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[dict[str, Any]]: ...
    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(self._length))]
        if not -self._length <= index < self._length:
            raise IndexError(index)
        return {name: values[index] for name, values in self.stacked.items()}

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (self[i] for i in range(self._length))


def collate(rows: Sequence[dict[str, Any]]) -> dict[str, torch.Tensor | list[str]]:
    """Give the stacked batch: pass this as `collate_fn` of a DataLoader."""
    if isinstance(rows, RowBatch):
        return rows.stacked
    from torch.utils.data import default_collate

    return default_collate(list(rows))
