"""What all open pages share: objects, rows and hands, read once and kept for a while.

Rows of a release are found by its index columns and read one at a time; those of a run are read
object by object. Pages run in threads; reading is serialised by one lock.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from bidexdata.errors import BidexError
from bidexdata.pictures.posing import has_pose
from bidexdata.record import GraspBatch
from bidexdata.record.status import Status
from bidexdata.runs.arm_pictures import join_arms
from bidexdata.runs.browse import Browsable, rows_by_test, verdicts_of
from bidexdata.runs.release_rows import (
    NO_POSE,
    SYNTH_FAILURES,
    TEST_FAILURES,
    RowFilter,
    objects_matching,
)
from bidexdata.viewer.nodes import body_meshes

if TYPE_CHECKING:
    from bidexdata.arms.robot import Robot
    from bidexdata.hands.model import Hand
    from bidexdata.objects.prepared import Solid

T = TypeVar("T")

_CACHED_OBJECTS = 8


@dataclass(frozen=True)
class Found:
    """What a filter finds."""

    object_ids: tuple[str, ...]
    """Objects with matching rows, sorted; all that match themselves where rows are not known."""
    total: int | None
    """Matching rows of all objects; None where only reading them would tell."""
    rows_of: Callable[[str], list[int]]
    """Numbers of the matching rows of an object, by size, then as stored."""


class Catalog:
    """Reads a library, a run or a release for any number of pages."""

    def __init__(self, source: Browsable):
        self.source = source
        self._lock = threading.RLock()
        self._solids: OrderedDict[str, Solid] = OrderedDict()
        self._batches: OrderedDict[str, dict[str, GraspBatch]] = OrderedDict()
        self._armed: OrderedDict[str, GraspBatch | None] = OrderedDict()
        self.no_robot = ""
        """Why the arms cannot be shown, where there should be some."""

    @cached_property
    def object_ids(self) -> tuple[str, ...]:
        """Objects, sorted."""
        return self.source.object_ids

    @cached_property
    def _categories(self) -> tuple[str, ...]:
        return self.source.categories()

    @cached_property
    def category_names(self) -> tuple[str, ...]:
        """Categories that some object has, sorted."""
        return tuple(sorted({c for c in self._categories if c}))

    @cached_property
    def reasons(self) -> tuple[Status, ...]:
        """Failures that may be filtered by."""
        index = self.source.index()
        return (*SYNTH_FAILURES, *TEST_FAILURES) if index is None else index.reasons

    @cached_property
    def hands(self) -> tuple[Hand, ...]:
        """In the order of the H axis; none for a library."""
        with self._lock:
            return self.source.hands()

    @cached_property
    def robot(self) -> Robot | None:
        """The rig with the hands; None where nothing has arm solutions, or it cannot be had here."""
        with self._lock:
            try:
                return self.source.robot()
            except BidexError as err:
                self.no_robot = str(err)
                return None

    def armed(self, object_id: str, batch: GraspBatch) -> GraspBatch | None:
        """Rows of an object with the columns of arms; None where there are none of it."""
        if not self.source.rig:
            return None
        solved = self._cached(self._armed, object_id, self.source.arms)
        return None if solved is None or not len(solved) else join_arms(batch, solved)

    def preload(self) -> None:
        """Load hands, arms, the first object and the first rows before a page asks for them."""
        for hand in self.hands:
            body_meshes(hand)
        _ = self.robot
        found = self.find(RowFilter(test=self.source.test))
        first = (*found.object_ids, *self.object_ids)[0]
        self.solid(first)

    def solid(self, object_id: str) -> Solid:
        """Read an object, or take it from the cache."""
        return self._cached(self._solids, object_id, self.source.load_solid)

    def find(self, wanted: RowFilter) -> Found:
        """Find objects and rows that match."""
        with self._lock:
            index = self.source.index()
            if index is None:
                matches = objects_matching(self.object_ids, self._categories, wanted)
                ids = tuple(self.object_ids[k] for k in np.flatnonzero(matches))
                return Found(ids, None, lambda name: matching_rows(self._grasps(name), wanted))
            found = index.find(wanted)
            ids = tuple(self.object_ids[k] for k in np.flatnonzero(found.counts))
            return Found(ids, found.total, lambda name: index.rows(found, name))

    def sizes_mm(self, object_id: str) -> tuple[int, ...]:
        """Sizes to choose from [mm]: of all scenes, or of the object where only that is read."""
        index = self.source.index()
        if index is not None:
            return index.sizes_mm
        batch = next(iter(self._grasps(object_id).values()), None)
        return () if batch is None else tuple(sorted(set(batch["size_mm"].tolist())))

    def grasp(self, object_id: str, row: int) -> dict[str, GraspBatch]:
        """Read one row that was found, with the verdicts of each test; see `rows_by_test`."""
        with self._lock:
            index = self.source.index()
            if index is not None:
                return {test: index.read(row, test) for test in self.source.tests or ("f",)}
            one = slice(row, row + 1)
            return {t: rows.select(one) for t, rows in self._grasps(object_id).items()}

    def _grasps(self, object_id: str) -> dict[str, GraspBatch]:
        return self._cached(self._batches, object_id, lambda name: rows_by_test(self.source, name))

    def _cached(self, cache: OrderedDict[str, T], key: str, read: Callable[[str], T]) -> T:
        with self._lock:
            if key not in cache:
                cache[key] = read(key)
                while len(cache) > _CACHED_OBJECTS:
                    cache.popitem(last=False)
            cache.move_to_end(key)
            return cache[key]


def matching_rows(tested: Mapping[str, GraspBatch], wanted: RowFilter) -> list[int]:
    """Rows of one object that match, ordered by size, then as stored.

    Rows without a pose are left out but where their reason is asked for.

    Args:
        tested: The same rows with the verdicts of each test; none gives no rows.
        wanted: The filter; what it says of objects is not looked at.
    """
    if not tested:
        return []
    batch = tested[wanted.test if wanted.test in tested else next(iter(tested))]
    synth = batch["synth_status"] if "synth_status" in batch else np.zeros(len(batch), np.int8)
    if wanted.reason in NO_POSE:
        mask = synth == wanted.reason
    else:
        mask = np.array([has_pose(batch, row) for row in range(len(batch))], bool)
    if wanted.reason in SYNTH_FAILURES:
        mask &= synth == wanted.reason
    elif wanted.reason is not None and "verdict_status" in batch:
        mask &= (synth == Status.OK) & (batch["verdict_status"] == wanted.reason)
    elif wanted.reason is not None:
        mask[:] = False
    if wanted.size_mm is not None:
        mask &= batch["size_mm"] == wanted.size_mm
    if wanted.outcome != "all":
        mask &= verdicts_of(batch) == {"passed": 1, "failed": 0, "not tested": -1}[wanted.outcome]
    if wanted.kept != "all" and wanted.kept in batch:
        mask &= batch[wanted.kept]
    rows = np.flatnonzero(mask)
    return [int(r) for r in rows[np.argsort(batch["size_mm"][rows], kind="stable")]]
