"""Load releases for training: `BiDexDataset`, its collate function and a resumable sampler."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bidexdata.loaders.collation import collate as collate
from bidexdata.loaders.samplers import EpochSampler as EpochSampler

if TYPE_CHECKING:
    from bidexdata.loaders.dataset import BiDexDataset as BiDexDataset


def __getattr__(name: str) -> Any:
    # Arrow is loaded with the data set, not with this package.
    if name != "BiDexDataset":
        raise AttributeError(f"module 'bidexdata.loaders' has no attribute {name!r}")
    from bidexdata.loaders.dataset import BiDexDataset

    return BiDexDataset
