"""BiDexDataset: a release as a map-style torch dataset, batched access first.

Opening reads the scenes table, no column of the rows but those that `fields` or `where` name. Float
columns are one row-major array: mapped from the training form where the release has one, read from
Parquet into memory otherwise. A batch is one gather; clouds are stored once per object.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import Int

from bidexdata.errors import UnknownName
from bidexdata.formats.release import Release
from bidexdata.formats.tables import CONFIGURATIONS
from bidexdata.loaders.assembly import Assembly, Gathered, Selection, columns_needed
from bidexdata.loaders.collation import RowBatch, as_tensordict
from bidexdata.loaders.filters import Where, columns_named, matching_rows, rows_by_function
from bidexdata.loaders.items import GraspItem
from bidexdata.loaders.options import DEFAULT_FIELDS as DEFAULT_FIELDS
from bidexdata.loaders.options import ItemOptions, names_of, require_torch
from bidexdata.loaders.row_source import RowSource
from bidexdata.loaders.stored import ScalarColumns, refuse_arms
from bidexdata.record.fields import TESTS

log = logging.getLogger(__name__)

Transform = Callable[[dict[str, Any]], dict[str, Any]]


class _Kinds(NamedTuple):
    """Kinds of cloud: objects at their sizes."""

    of_row: Int[np.ndarray, " N"]
    objects: Int[np.ndarray, " K"]


class BiDexDataset:
    """Grasps of a release, one item per grasp.

    An item is a dict (`loaders.items.GraspItem`): the fields asked for, `object_index` (into
    `object_ids`) and, unless `cloud=None`, the object's points at the grasp's size [m]. Loads
    selected rows unless told otherwise; selected rows are better than what the generator makes on
    average.

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
        normals: bool = False,
        configuration: str = "selected",
        clouds: str = "expand",
        quat_order: str = "wxyz",
        rotation: str = "quat",
        augment: Sequence[str] = (),
        seed: int = 0,
        as_tensordict: bool = False,
        transform: Transform | None = None,
    ):
        """Open a release and choose rows.

        Args:
            root: Release folder.
            split: `train` or `test`; None loads all splits, one after the other in the release's
                order.
            where: Which rows; see `loaders.filters.matching_rows`.
            fields: Columns of an item (of grasps, contacts and, where the release has a rig, arms);
                `DEFAULT_FIELDS` when omitted.
            frame: Frame of hand poses and clouds: `object` or `world`, with angles of arms `world`.
                Contact points are always in the object frame.
            cloud: `cloud_solid`, `cloud_mesh` or None.
            points: Points per cloud, the first of the stored farthest-point order.
            configuration: `selected` or `audit`.
            normals: Give the outward normals at the points of `cloud_solid` too: `cloud_normal`.
            clouds: `expand` gives every grasp its cloud; `unique` gives each cloud of a batch once,
                and `point_index` says which is each grasp's (`expand_clouds` expands).
            quat_order: `wxyz` or `xyzw`; keys end in the order, as `hand_quat_xyzw`.
            rotation: `quat`, `6d` (`hand_rot6d`: first column of the matrix, then the second) or
                `matrix` (`hand_matrix`).
            augment: `yaw`, `mirror` or both: see `loaders.augment`; drawn anew by `set_epoch`.
            seed: Seed of the augmentation.
            as_tensordict: Give `tensordict.TensorDict` instead of dict.
            transform: Called with each batch (a dict of tensors, leading axis B), gives the batch.

        Raises:
            MissingExtra: torch, or tensordict where it is asked for, is not installed.
            PathNotFound: There is no release at `root`.
            UnknownName: No such split, field, cloud, configuration or option.
            NotUsable: Columns of arms of a release that has no arm solutions.
            BadConfig: `where` cannot be read, fewer points are stored than asked for, options
                exclude each other, or the hands have no mirror images.
        """
        require_torch()
        self.release = Release.open(root)
        self.split, self.configuration = split, configuration
        if split is not None and split not in self.release.split_names:
            raise UnknownName("split", str(split), self.release.split_names)
        if configuration not in CONFIGURATIONS:
            raise UnknownName("configuration", configuration, CONFIGURATIONS)
        self.options = ItemOptions(
            fields=names_of("fields", DEFAULT_FIELDS if fields is None else fields),
            frame=frame,
            cloud=cloud,
            points=points,
            normals=normals,
            clouds=clouds,
            quat_order=quat_order,
            rotation=rotation,
            augment=names_of("augment", augment),
            seed=seed,
        )
        self.epoch, self.transform = 0, transform
        self._tensordict = as_tensordict
        if as_tensordict:
            _require_tensordict(self.options)
        self._where = None if where is None else getattr(where, "__name__", repr(where))
        self._open()
        self._rows = self._chosen(where)
        log.info("%r", self)
        self._warn_of_untested(columns_named(where) or ())
        if where is not None and len(self._index) and not len(self):
            log.warning("where=%s keeps none of %d grasps", self._where, len(self._index))

    def __len__(self) -> int:
        """Number of grasps chosen."""
        return self._count if self._rows is None else len(self._rows)

    def __getitem__(self, index: int) -> GraspItem:
        """Give one grasp as tensors (text fields as str)."""
        return cast(GraspItem, self.__getitems__([index])[0])

    def __getitems__(self, indices: Sequence[int] | Int[np.ndarray, " n"]) -> RowBatch:
        """Give many grasps at once: what a DataLoader calls."""
        chosen = np.asarray(indices, np.int64)
        return RowBatch(self.read(self.rows(chosen)), len(chosen))

    def rows(self, indices: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Rows of the split that items are, by their numbers; negative ones count from the end.

        Raises:
            IndexError: There is no such item.
        """
        count = len(self)
        # Seen as unsigned, a negative number is a large one: one look finds both kinds of fault.
        if len(indices) and np.maximum.reduce(indices.view(np.uint64)) >= count:
            if indices.min() < -count or indices.max() >= count:
                raise IndexError(f"this dataset has {count} grasps")
            indices = np.where(indices < 0, indices + count, indices)
        return indices if self._rows is None else self._rows.take(indices)

    def objects_of(self, indices: Sequence[int]) -> Int[np.ndarray, " n"]:
        """`object_index` of some items, without reading them."""
        rows = self.rows(np.asarray(indices, np.int64))
        return self._index.object_index[rows].astype(np.int64)

    def read(self, rows: Int[np.ndarray, " n"], key: Int[np.ndarray, " n"] | None = None) -> Any:
        """Read rows of the split as a batch of tensors.

        Args:
            rows: Rows of the configuration and split, not negative.
            key: What augmentation is drawn by for each; the row when omitted.
        """
        return self._batch(self._gather(rows, key))

    def batches(
        self, chunks: Iterable[Int[np.ndarray, " n"]], batch_size: int, *, drop_last: bool = False
    ) -> Iterator[Any]:
        """Batches of items in a given order, read many rows at a time: `ResumableLoader` uses it.

        What Python does for a gather of rows is then shared by several batches. Their columns are
        parts of one block, each batch its own: whoever keeps one keeps the rows of a chunk.

        Args:
            chunks: Numbers of items; batches are cut from each chunk.
            batch_size: Items of a batch; the last of a chunk may be smaller.
            drop_last: Leave out batches that are not full.
        """
        for items in chunks:
            block = self._gather(self.rows(items), None)
            for low in range(0, len(items), batch_size):
                high = min(low + batch_size, len(items))
                if not drop_last or high - low == batch_size:
                    yield self._batch(block.part(low, high))

    def _gather(self, rows: Int[np.ndarray, " n"], key: Int[np.ndarray, " n"] | None) -> Gathered:
        found, text = self._source.take(rows)
        if self._kinds is None:
            kind, objects = None, self._index.object_index.take(rows).astype(np.int64)
        else:
            kind = self._kinds.of_row.take(rows)
            objects = self._kinds.objects.take(kind)
        return Gathered(found, text, Selection(rows if key is None else key, objects, kind))

    def _batch(self, rows: Gathered) -> Any:
        batch = self._assembly.batch(rows, self.epoch)
        if self.transform is not None:
            batch = self.transform(batch)
        return as_tensordict(batch, len(rows.selection.key)) if self._tensordict else batch

    def set_epoch(self, epoch: int) -> None:
        """Draw augmentation anew. Workers that persist between epochs do not see it."""
        self.epoch = epoch

    def warm(self) -> int:
        """Read one byte of every page of the mapped rows, so that batches meet no cold page.

        The first touch of a mapped page costs about as much as the copy of a row. For releases that
        fit into memory.

        Returns:
            Bytes that are mapped.
        """
        return self._source.warm()

    def _warn_of_untested(self, named: Sequence[str]) -> None:
        """Warn where `suc_*` are False for want of a test: of all, or of one that is asked for."""
        tests = self.release.figures.get("tests", {})
        run = {name for name, t in tests.items() if t["selected"]["n"] or t["by_verdict"]}
        if not run:
            log.warning("%s was never tested: its suc_* are False everywhere", self.release.path)
            return
        asked = {*self.fields, *named}
        for name in (f"suc_{t}" for t in TESTS if t not in run):
            if name in asked:
                log.warning(
                    "%s holds no verdict of test %s: no row has %s",
                    *(self.release.path, name.removeprefix("suc_"), name),
                )

    @property
    def fields(self) -> tuple[str, ...]:
        """Columns of an item, by their names in the field table."""
        return self.options.fields

    @property
    def frame(self) -> str:
        """Frame of hand poses and clouds."""
        return self.options.frame

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

    @property
    def rig(self) -> str:
        """Name of the rig that columns of arms are of; empty where the release has none."""
        return self.release.rig

    @property
    def arm_joint_names(self) -> tuple[tuple[str, ...], ...]:
        """Names of the A axis of `arm_joints` and `arm_path`, per arm; none without a rig."""
        return tuple(arm.joint_names for arm in self.release.header.arms)

    @property
    def object_rows(self) -> Int[np.ndarray, " K"]:
        """Items of each object that has some, in the order of the items: for `ObjectSampler`."""
        return _run_lengths(self._of_rows(self._index.object_index))

    @cached_property
    def case_ends(self) -> Int[np.ndarray, " G"]:
        """Item behind the last of each scene that has some, in the order of the items."""
        return np.cumsum(_run_lengths(self._of_rows(self._index.scene_index)))

    def scene_of(self, item: int) -> int:
        """Number of an item's scene, which `scene_ids` counts."""
        row = item if self._rows is None else int(self._rows[item])
        return int(self._index.scene_index[row])

    @property
    def scene_ids(self) -> tuple[str, ...]:
        """Scenes of the split."""
        return self._index.scene_ids

    def __repr__(self) -> str:
        """Say what is loaded, that it is a selection, and whose verdicts `suc_*` are."""
        rows = "selected rows only" if self.configuration == "selected" else "audit rows only"
        where = "" if self._where is None else f", where={self._where}"
        return (
            f"BiDexDataset({self.release.name} {self.release.version}, split={self.split!r}, "
            f"{rows}, {len(self)} of {len(self._index)} grasps{where}, frame={self.frame!r}, "
            f"suc_* by {self.release.default_protocol})"
        )

    def __getstate__(self) -> dict[str, Any]:
        # Workers map the files themselves; sending arrays would copy the whole table.
        dropped = ("_source", "_assembly", "_index", "_scalars", "_kinds", "case_ends")
        kept = {k: v for k, v in self.__dict__.items() if k not in dropped}
        return {**kept, "release": self.release.path}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.release = Release.open(state["release"])
        self._open()

    def _open(self) -> None:
        place = (self.configuration, self.split)
        self._index = self.release.row_index(*place)
        self._count = len(self._index)
        self._scalars = ScalarColumns(self.release, *place, self._index)
        # Floating scenes have the identity pose: nothing to convert (docs/conventions.md).
        on_table = bool(self._index.tabletop.any())
        names = columns_needed(self.options, on_table=on_table)
        self._source = RowSource(self._scalars, names)
        self._assembly = Assembly(self.release, self.options, on_table=on_table)
        self._kinds = self._open_kinds()

    def _open_kinds(self) -> _Kinds | None:
        """Objects at their sizes, if clouds are kept at them."""
        if self._assembly.clouds is None:
            return None
        index = self._index
        sizes_mm = self.release.scenes.column("size_mm").to_numpy()[index.scene_rows]
        pairs = np.stack([index.scene_objects, sizes_mm], axis=1)
        pairs, kind = np.unique(pairs, axis=0, return_inverse=True)
        # Of scenes with whole millimetres; rows of other sizes are found and scaled per batch.
        sizes = (pairs[:, 1] / 1000).astype(np.float32)
        if not self._assembly.clouds.keep(pairs[:, 0], sizes):
            return None
        return _Kinds(np.repeat(kind.reshape(-1).astype(np.int32), index.counts), pairs[:, 0])

    def _chosen(self, where: Where) -> Int[np.ndarray, " n"] | None:
        if where is None:
            return None
        if callable(where):
            return rows_by_function(where, self._scalars, len(self._index))
        names = columns_named(where) or []
        refuse_arms(self.release, names)
        for name in names:
            if name not in self._scalars:
                raise UnknownName("column", name, list(self._scalars), "in where")
        if not names:
            # Without a column there is no length; any will do.
            names = ["size_mm"]
        return matching_rows(where, self._scalars.table(names))

    def _of_rows(self, values: np.ndarray) -> np.ndarray:
        return values if self._rows is None else values[self._rows]


def _run_lengths(values: np.ndarray) -> np.ndarray:
    if not len(values):
        return np.zeros(0, np.int64)
    starts = np.flatnonzero(np.diff(values, prepend=values[0] - 1))
    return np.diff(starts, append=len(values))


def _require_tensordict(options: ItemOptions) -> None:
    from importlib.util import find_spec

    from bidexdata.errors import BadConfig, MissingExtra

    if find_spec("tensordict") is None:
        raise MissingExtra("tensordict")
    if options.clouds == "unique":
        raise BadConfig(
            "a TensorDict has one leading axis, and clouds='unique' gives two; use clouds='expand' "
            "or plain dicts"
        )
