"""Load releases for training: data sets, samplers that resume, collation, prefetch.

`HandModel` is a hand as a differentiable torch module. Everything that needs torch or Arrow is
imported when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from bidexdata.loaders.collation import RowBatch as RowBatch
from bidexdata.loaders.collation import collate as collate
from bidexdata.loaders.collation import collate_cases as collate_cases
from bidexdata.loaders.collation import pack_contacts as pack_contacts
from bidexdata.loaders.items import GraspItem as GraspItem
from bidexdata.loaders.prefetch import Prefetch as Prefetch
from bidexdata.loaders.samplers import EpochSampler as EpochSampler
from bidexdata.loaders.samplers import ObjectSampler as ObjectSampler

_LATE = {
    "BiDexCases": "bidexdata.loaders.cases",
    "BiDexDataset": "bidexdata.loaders.dataset",
    "BiDexStream": "bidexdata.loaders.stream",
    "HandModel": "bidexdata.hands.torch_layer",
    "ResumableLoader": "bidexdata.loaders.resume",
    "expand_clouds": "bidexdata.loaders.clouds",
    "normals_on": "bidexdata.loaders.normals",
}

if TYPE_CHECKING:
    from bidexdata.hands.torch_layer import HandModel as HandModel
    from bidexdata.loaders.cases import BiDexCases as BiDexCases
    from bidexdata.loaders.clouds import expand_clouds as expand_clouds
    from bidexdata.loaders.dataset import BiDexDataset as BiDexDataset
    from bidexdata.loaders.normals import normals_on as normals_on
    from bidexdata.loaders.resume import ResumableLoader as ResumableLoader
    from bidexdata.loaders.stream import BiDexStream as BiDexStream


def __dir__() -> list[str]:
    return sorted({*globals(), *_LATE})


def __getattr__(name: str) -> Any:
    if name not in _LATE:
        raise AttributeError(f"module 'bidexdata.loaders' has no attribute {name!r}")
    return getattr(import_module(_LATE[name]), name)
