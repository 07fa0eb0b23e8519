"""BiDexCases: one item per scene, with all its grasps: for models of sets and of distributions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bidexdata.errors import BadConfig
from bidexdata.loaders.dataset import BiDexDataset

_OF_CASE = (
    "object_index",
    "size_mm",
    "size",
    "setting",
    "object_id",
    "scene_id",
    "mirrored",
    "cloud_normal",
)
_POSE = ("object_pos", "object_quat_wxyz", "object_quat_xyzw", "object_rot6d", "object_matrix")


class BiDexCases:
    """Scenes of a release, one item per object, size and pose with the grasps chosen of it.

    An item is a dict: columns of the G grasps of the scene have leading axis G; what is the same
    for all of them (`object_index`, `size`, the object's pose, the cloud) is there once. `grasps` is
    G and `per_grasp` names the columns with that axis. Augmentation moves a scene as a whole.

    Use `DataLoader(cases, batch_size=16, collate_fn=collate_cases)`.
    """

    def __init__(self, root: str | Path, **options: Any):
        """Open a release.

        Args:
            root: Release folder.
            options: Those of `BiDexDataset`, but for `clouds` and `as_tensordict`.

        Raises:
            BadConfig: An option is given that cases do not have; and as `BiDexDataset`.
        """
        for name in ("clouds", "as_tensordict"):
            if name in options:
                raise BadConfig(f"a case has one cloud and many grasps: {name} is no option of it")
        self.grasps = BiDexDataset(root, clouds="unique", **options)
        """The same rows, one item per grasp."""

    def __len__(self) -> int:
        """Number of scenes that have a chosen grasp."""
        return len(self.grasps.case_ends)

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Give one scene with its grasps."""
        count = len(self)
        if not -count <= index < count:
            raise IndexError(f"there are {count} scenes")
        ends = self.grasps.case_ends
        index %= count
        low = int(ends[index - 1]) if index else 0
        return self._case(low, int(ends[index]))

    def __getitems__(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """Give many scenes: what a DataLoader calls."""
        return [self[int(i)] for i in indices]

    def set_epoch(self, epoch: int) -> None:
        """Draw augmentation anew."""
        self.grasps.set_epoch(epoch)

    def __repr__(self) -> str:
        """Say what is loaded."""
        return f"BiDexCases({len(self)} scenes of {self.grasps!r})"

    def _case(self, low: int, high: int) -> dict[str, Any]:
        data = self.grasps
        rows = data.rows(np.arange(low, high))
        scene = data.scene_of(low)
        batch = data.read(rows, np.full(len(rows), scene))
        cloud = data.options.cloud
        if cloud is not None and cloud in batch and len(batch[cloud]) != 1:
            raise BadConfig(
                f"the grasps of {data.scene_ids[scene]} have {len(batch[cloud])} sizes or poses "
                "of their object, so it is no case with one cloud; use cloud=None, or BiDexDataset"
            )
        batch.pop("point_index", None)
        once = {n for n in batch if n in (*_OF_CASE, *_POSE, cloud)}
        case = {n: v[0] if n in once else v for n, v in batch.items()}
        per_grasp = tuple(n for n in batch if n not in once)
        return {
            "scene_id": data.scene_ids[scene],
            **case,
            "grasps": high - low,
            "per_grasp": per_grasp,
        }
