"""Load releases for training: `BiDexDataset`, its collate function and a resumable sampler."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bidexdata.loaders.collate import collate as collate
    from bidexdata.loaders.dataset import BiDexDataset as BiDexDataset
    from bidexdata.loaders.samplers import EpochSampler as EpochSampler

_PUBLIC = {
    "BiDexDataset": "bidexdata.loaders.dataset",
    "EpochSampler": "bidexdata.loaders.samplers",
    "collate": "bidexdata.loaders.collate",
}

__all__ = list(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'bidexdata.loaders' has no attribute {name!r}")
    return getattr(import_module(_PUBLIC[name]), name)
