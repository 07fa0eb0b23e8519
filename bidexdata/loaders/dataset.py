"""BiDexDataset: a release as a map-style torch dataset, batched access first.

Float columns are one row-major array: mapped from the training form where the release has one,
read from Parquet into memory otherwise. A batch is one `np.take`; clouds are stored once per
object and gathered per batch.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from bidexdata.errors import BadConfig, MissingExtra, UnknownName
from bidexdata.formats import hdf5
from bidexdata.formats.release import Release
from bidexdata.formats.tables import CONFIGURATIONS, CONTACT_COLUMNS
from bidexdata.loaders.collation import RowBatch
from bidexdata.loaders.filters import Where, columns_named, matching_rows, scalar_values
from bidexdata.loaders.poses import points_in_world, poses_in_object_frame
from bidexdata.record.fields import TESTS

log = logging.getLogger(__name__)

DEFAULT_FIELDS = ("hand_pos", "hand_quat_wxyz", "joints", "size_mm", "size")
_POSE_OF_OBJECT = ("object_pos", "object_quat_wxyz")
_HAND_POSES = ("hand_pos", "hand_quat_wxyz")
_ALWAYS = ("object_id", "setting")


class BiDexDataset:
    """Grasps of a release, one item per grasp.

    An item is a dict: the fields asked for, `object_index` (into `object_ids`) and, unless
    `cloud=None`, the object's points at the grasp's size [m]. Loads selected rows unless told
    otherwise; selected rows are better than what the generator makes on average.

    A field `suc_*` is False also where the test was not run: choose tested rows by
    `where="suc_f or not suc_f"`.

    Use `DataLoader(data, batch_size=256, shuffle=True, collate_fn=collate)`. Reading is fast:
    workers only pay off for heavy transforms of your own; start them with
    `multiprocessing_context="spawn"`.
    """

    def __init__(
        self,
        root: str | Path,
        *,
        split: str | None = "train",
        where: Where = None,
        fields: Sequence[str] | None = None,
        frame: str = "object",
        cloud: str | None = "cloud_solid",
        points: int = 1024,
        configuration: str = "selected",
    ):
        """Open a release and choose rows.

        Args:
            root: Release folder.
            split: `train` or `test`; None loads all splits, one after the other in the release's
                order.
            where: Which rows; see `loaders.filters.matching_rows`.
            fields: Columns of an item (grasps and contacts tables); `DEFAULT_FIELDS` when omitted.
            frame: Frame of hand poses and clouds: `object` or `world`. Contact points are always
                in the object frame.
            cloud: `cloud_solid`, `cloud_mesh` or None.
            points: Points per cloud, the first of the stored farthest-point order.
            configuration: `selected` or `audit`.

        Raises:
            MissingExtra: torch is not installed.
            PathNotFound: There is no release at `root`.
            UnknownName: No such split, field, cloud or configuration.
            BadConfig: `where` cannot be read, or fewer points are stored than asked for.
        """
        _require_torch()
        self.release = Release.open(root)
        self.split, self.frame, self.configuration = split, frame, configuration
        self.where = where
        if split is not None and split not in self.release.split_names:
            raise UnknownName("split", str(split), self.release.split_names)
        if frame not in ("object", "world"):
            raise UnknownName("frame", frame, ("object", "world"))
        if configuration not in CONFIGURATIONS:
            raise UnknownName("configuration", configuration, CONFIGURATIONS)
        self.fields = tuple(fields) if fields is not None else DEFAULT_FIELDS
        self.cloud, self.points = cloud, points
        self._open()
        log.info("%r", self)
        self._warn_of_untested()
        if where is not None and self._total and not len(self):
            log.warning("where=%s keeps none of %d grasps", self._where_name(), self._total)

    def __len__(self) -> int:
        """Number of grasps chosen."""
        return len(self._rows)

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Give one grasp as tensors (text fields as str)."""
        return self.__getitems__([index])[0]

    def __getitems__(self, indices: Sequence[int]) -> RowBatch:
        """Give many grasps at once: what a DataLoader calls."""
        chosen = np.asarray(indices, np.int64)
        if len(chosen) and not (-len(self) <= chosen.min() and chosen.max() < len(self)):
            raise IndexError(f"this dataset has {len(self)} grasps")
        return RowBatch(self._read(self._rows[chosen]), len(chosen))

    def _warn_of_untested(self) -> None:
        """Warn where `suc_*` are False for want of a test: of all, or of one that is asked for."""
        tests = self.release.figures.get("tests", {})
        run = {name for name, t in tests.items() if t["selected"]["n"] or t["by_verdict"]}
        if not run:
            log.warning("%s was never tested: its suc_* are False everywhere", self.release.path)
            return
        asked = {*self.fields, *(columns_named(self.where) or ())}
        for name in (f"suc_{t}" for t in TESTS if t not in run):
            if name in asked:
                log.warning(
                    "%s holds no verdict of test %s: no row has %s",
                    *(self.release.path, name.removeprefix("suc_"), name),
                )

    @property
    def object_ids(self) -> tuple[str, ...]:
        """What `object_index` counts: all objects of the release."""
        return self.release.object_ids

    @property
    def joint_names(self) -> tuple[tuple[str, ...], ...]:
        """Names of the J axis of `joints`, per hand."""
        return tuple(hand.joint_names for hand in self.release.hands)

    @property
    def sides(self) -> tuple[str, ...]:
        """Names of the H axis."""
        return tuple(hand.side for hand in self.release.hands)

    def __repr__(self) -> str:
        """Say what is loaded, that it is a selection, and whose verdicts `suc_*` are."""
        rows = "selected rows only" if self.configuration == "selected" else "audit rows only"
        where = "" if self.where is None else f", where={self._where_name()}"
        return (
            f"BiDexDataset({self.release.name} {self.release.version}, split={self.split!r}, "
            f"{rows}, {len(self)} of {self._total} grasps{where}, frame={self.frame!r}, "
            f"suc_* by {self.release.default_protocol})"
        )

    @property
    def _splits(self) -> tuple[str, ...]:
        return self.release.split_names if self.split is None else (self.split,)

    def _where_name(self) -> str:
        return getattr(self.where, "__name__", repr(self.where))

    def __getstate__(self) -> dict[str, Any]:
        # Workers map the files themselves; sending arrays would copy the whole table.
        kept = {k: v for k, v in self.__dict__.items() if k not in ("_values", "_ends", "_cloud")}
        return {**kept, "release": self.release.path}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.release = Release.open(state["release"])
        self._map()

    def _open(self) -> None:
        scalars = self._scalar_columns()
        self._map()
        known = {*self._columns, *scalars, *hdf5.INTEGER_LISTS, *CONTACT_COLUMNS, "size"}
        for name in self.fields:
            if name not in known:
                raise UnknownName("field", name, sorted(known))
        named = columns_named(self.where)
        for name in named or ():
            if name not in scalars:
                raise UnknownName("column", name, scalars, "in where")
        mine = [n for n in self.fields if n in scalars and n not in self._columns]
        apart = (*hdf5.INTEGER_LISTS, *CONTACT_COLUMNS)
        lists = [n for n in self.fields if n in apart and n not in self._columns]
        place = (self.configuration, self.split)
        size = "size" if "size" in scalars else "size_mm"
        needed = [*mine, *_ALWAYS, size, *(scalars if named is None else named)]
        index = self.release.index(*place, list(dict.fromkeys(needed)))
        self._total = index.num_rows
        self._rows = matching_rows(self.where, index)
        parts = [
            hdf5.map_columns(self.release.path, self.configuration, split, lists)
            for split in self._splits
        ]
        self._lists = {name: np.concatenate([part[name] for part in parts]) for name in lists}
        ids = scalar_values(index.column("object_id"))
        self._object_index = np.searchsorted(np.array(self.release.object_ids), ids)
        sizes = scalar_values(index.column(size))
        self._sizes = sizes if size == "size" else (sizes / 1000).astype(np.float32)
        self._scalars = {n: scalar_values(index.column(n)) for n in mine}
        if "size" in self.fields and "size" not in self._columns:
            self._scalars["size"] = self._sizes
        # Floating scenes have the identity pose: nothing to convert (docs/conventions.md).
        self._moved = bool(np.any(scalar_values(index.column("setting")) != "floating"))

    def _map(self) -> None:
        root = self.release.path
        parts = [
            hdf5.map_values(root, self.configuration, split)
            or hdf5.read_values(root, self.configuration, split)
            for split in self._splits
        ]
        self._values = [part.values for part in parts]
        self._ends = np.cumsum([len(values) for values in self._values])
        self._columns = parts[0].columns  # the same in all splits
        self._cloud = None
        if self.cloud is not None:
            stored = self.release.cloud(self.cloud)
            if self.points > stored.shape[1]:
                raise BadConfig(
                    f"points={self.points}, but the release stores {stored.shape[1]} per object"
                )
            # Contiguous, because np.take copies the whole of anything else.
            self._cloud = np.ascontiguousarray(stored[:, : self.points])

    def _scalar_columns(self) -> list[str]:
        import pyarrow as pa

        schema = self.release.table_schema("grasps", self.configuration)
        return [f.name for f in schema if not pa.types.is_fixed_size_list(f.type)]

    def _read(self, rows: np.ndarray) -> dict[str, Any]:
        import torch

        block = self._floats(rows)
        found = {n: self._column(block, n) for n in self.fields if n in self._columns}
        if self._moved and self.frame == "object" and any(n in found for n in _HAND_POSES):
            pose = dict(zip(_HAND_POSES, self._hands_in_object(block), strict=True))
            found |= {n: v for n, v in pose.items() if n in found}
        batch: dict[str, Any] = {}
        for name in self.fields:
            if name in found:
                batch[name] = torch.from_numpy(np.ascontiguousarray(found[name]))
            elif name in self._lists:
                batch[name] = torch.from_numpy(self._lists[name][rows])
            else:
                values = self._scalars[name][rows]
                text = values.dtype.kind == "U"
                batch[name] = values.tolist() if text else torch.from_numpy(values)
        objects = self._object_index[rows]
        batch["object_index"] = torch.from_numpy(objects)
        if self._cloud is not None and self.cloud is not None:
            batch[self.cloud] = torch.from_numpy(self._clouds(rows, objects, block))
        return batch

    def _floats(self, rows: np.ndarray) -> np.ndarray:
        """Float columns of some rows; those of each split are an array of their own."""
        if len(self._values) == 1:
            return np.take(self._values[0], rows, axis=0)
        block = np.empty((len(rows), self._values[0].shape[1]), np.float32)
        part = np.searchsorted(self._ends, rows, side="right")
        for k, values in enumerate(self._values):
            mine = part == k
            block[mine] = np.take(values, rows[mine] - self._ends[k] + len(values), axis=0)
        return block

    def _column(self, block: np.ndarray, name: str) -> np.ndarray:
        place, shape = self._columns[name]
        return block[:, place].reshape(len(block), *shape)

    def _hands_in_object(self, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pos, quat = (self._column(block, n) for n in _POSE_OF_OBJECT)
        return poses_in_object_frame(pos, quat, *(self._column(block, n) for n in _HAND_POSES))

    def _clouds(self, rows: np.ndarray, objects: np.ndarray, block: np.ndarray) -> np.ndarray:
        assert self._cloud is not None
        cloud = np.asarray(np.take(self._cloud, objects, axis=0))
        cloud *= self._sizes[rows][:, None, None]
        if self._moved and self.frame == "world":
            pos, quat = (self._column(block, n) for n in _POSE_OF_OBJECT)
            cloud = points_in_world(pos, quat, cloud)
        return cloud


def _require_torch() -> None:
    if find_spec("torch") is None:
        raise MissingExtra("torch")
